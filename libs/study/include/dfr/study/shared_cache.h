#pragma once

#include <exception>
#include <future>
#include <map>
#include <memory>
#include <mutex>

namespace dfr::study {

/// Computes each value once, on the first thread that requests it. Other threads wait. An exception
/// thrown by the computation reaches all of them.
template <typename Key, typename Value>
class SharedCache {
 public:
  template <typename Make>
  std::shared_ptr<const Value> Get(const Key& key, const Make& make) {
    std::promise<std::shared_ptr<const Value>> promise;
    std::shared_future<std::shared_ptr<const Value>> future;
    bool first = false;
    {
      const std::lock_guard lock(mutex_);
      auto& entry = entries_[key];
      first = !entry.valid();
      if (first) entry = promise.get_future().share();
      future = entry;
    }
    if (first) {
      try {
        // The value need not be movable.
        promise.set_value(std::shared_ptr<const Value>(new Value(make())));
      } catch (...) {
        promise.set_exception(std::current_exception());
      }
    }
    return future.get();
  }

 private:
  std::mutex mutex_;
  std::map<Key, std::shared_future<std::shared_ptr<const Value>>> entries_;
};

}  // namespace dfr::study
