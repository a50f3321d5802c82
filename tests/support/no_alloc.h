#pragma once

#include <cstddef>

namespace dfr::test {

/// While one is alive on this thread, every heap allocation of the thread (operator new, malloc and
/// kin) is counted; its destructor fails the test if there was any.
class NoAlloc {
 public:
  NoAlloc() noexcept;
  ~NoAlloc();
  NoAlloc(const NoAlloc&) = delete;
  NoAlloc& operator=(const NoAlloc&) = delete;

  /// Allocations so far.
  [[nodiscard]] std::size_t count() const noexcept;

 private:
  std::size_t at_start_;
};

}  // namespace dfr::test
