#include "tests/support/no_alloc.h"

#include <gtest/gtest.h>

#include <cerrno>
#include <cstdlib>

// Sanitizers replace malloc. NoAlloc then counts nothing and never fails. Only builds without
// sanitizers check allocations.
#if defined(__has_feature)  // clang
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define DFR_COUNTS_ALLOCATIONS 0
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define DFR_COUNTS_ALLOCATIONS 0
#endif
#ifndef DFR_COUNTS_ALLOCATIONS
#define DFR_COUNTS_ALLOCATIONS 1
#endif

namespace {
thread_local std::size_t allocations = 0;
}

#if DFR_COUNTS_ALLOCATIONS
// glibc's own allocator under its internal names: replacing malloc catches operator new, Eigen's
// aligned allocations and C libraries.
// NOLINTBEGIN(bugprone-reserved-identifier): the names are glibc's.
extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);

void* malloc(std::size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t n, std::size_t size) {
  ++allocations;
  return __libc_calloc(n, size);
}
void* realloc(void* p, std::size_t size) {
  ++allocations;
  return __libc_realloc(p, size);
}
void* memalign(std::size_t alignment, std::size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** p, std::size_t alignment, std::size_t size) {
  ++allocations;
  *p = __libc_memalign(alignment, size);
  return *p == nullptr ? ENOMEM : 0;
}
}
// NOLINTEND(bugprone-reserved-identifier)
#endif

namespace dfr::test {

NoAlloc::NoAlloc() noexcept : at_start_(allocations) {}

NoAlloc::~NoAlloc() {
  if (count() > 0) ADD_FAILURE() << count() << " heap allocations where none is allowed";
}

std::size_t NoAlloc::count() const noexcept { return allocations - at_start_; }

}  // namespace dfr::test
