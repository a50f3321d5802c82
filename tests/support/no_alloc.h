#pragma once

#include <cstddef>

namespace dfr::test {

/// Counts every heap allocation of this thread (operator new, malloc and similar functions) during
/// its lifetime. The destructor fails the test after any allocation.
class NoAlloc {
 public:
  NoAlloc() noexcept;
  ~NoAlloc();
  NoAlloc(const NoAlloc&) = delete;
  NoAlloc& operator=(const NoAlloc&) = delete;

  /// Number of allocations so far.
  [[nodiscard]] std::size_t count() const noexcept;

 private:
  std::size_t at_start_;
};

}  // namespace dfr::test
