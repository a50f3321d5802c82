// Code that was compiled for an executable cannot access the C library's stderr and stdout from a
// shared object. With --wrap, the linker replaces them by these variables.

#include <cstdio>

extern "C" {
extern FILE* __real_stderr;  // NOLINT(bugprone-reserved-identifier): the linker's names
extern FILE* __real_stdout;  // NOLINT(bugprone-reserved-identifier)
[[gnu::visibility("hidden")]] FILE* __wrap_stderr;  // NOLINT(bugprone-reserved-identifier)
[[gnu::visibility("hidden")]] FILE* __wrap_stdout;  // NOLINT(bugprone-reserved-identifier)
}

namespace {

// Runs before any other code of the module, which may print.
[[gnu::constructor(101)]] void SetStandardStreams() {
  __wrap_stderr = __real_stderr;
  __wrap_stdout = __real_stdout;
}

}  // namespace
