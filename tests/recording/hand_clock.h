#pragma once

#include <atomic>
#include <cstdint>

#include "dfr/recording/recorder.h"
#include "tests/support/eventually.h"

namespace dfr::test {

/// A clock that the test advances. The recorder writes only after an advance, and at its end.
class RecorderHandClock final : public recording::RecorderClock {
 public:
  [[nodiscard]] std::int64_t SteadyNs() override { return now_ns_; }
  void Wait(std::int64_t /*ns*/, const std::atomic<bool>& stopping) override {
    const int turn = ++begun_;
    Eventually([&] { return granted_ >= turn || stopping; });
  }

  /// Advances the time, and returns once the recorder has written all due records.
  void Pass(std::int64_t ms) {
    Eventually([&] { return begun_ > granted_; });
    now_ns_ += ms * 1'000'000;
    ++granted_;
    Eventually([&] { return begun_ > granted_; });
  }

 private:
  std::atomic<std::int64_t> now_ns_{0};
  std::atomic<int> begun_{0};
  std::atomic<int> granted_{0};
};

}  // namespace dfr::test
