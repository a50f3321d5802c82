#pragma once

#ifdef __linux__
#include <sys/mman.h>
#endif

#include <cstddef>
#include <memory>
#include <new>

namespace dfr::kernel::internal {

/// Uninitialised memory, in huge pages if the system supports them: obtaining small pages takes
/// longer than filling them with kernel values.
class LargeMemory {
 public:
  explicit LargeMemory(std::size_t size)
      : size_(size), data_(static_cast<unsigned char*>(::operator new(size, kAlignment))) {
#ifdef __linux__
    constexpr auto kPage = static_cast<std::size_t>(kAlignment);
    if (size >= kPage) (void)madvise(data_.get(), size / kPage * kPage, MADV_HUGEPAGE);
#endif
  }

  [[nodiscard]] unsigned char* data() const noexcept { return data_.get(); }
  [[nodiscard]] std::size_t size() const noexcept { return size_; }

 private:
  static constexpr std::align_val_t kAlignment{std::size_t{2} << 20};
  struct Delete {
    void operator()(unsigned char* data) const noexcept { ::operator delete(data, kAlignment); }
  };
  std::size_t size_;
  std::unique_ptr<unsigned char[], Delete> data_;
};

}  // namespace dfr::kernel::internal
