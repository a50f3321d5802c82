#pragma once

#include <pybind11/pybind11.h>
#include <unistd.h>

#include <exception>
#include <utility>

namespace dfr::python {

/// Runs `call`, which takes the interpreter's lock. In a daemon thread, while the interpreter ends,
/// Python before 3.14 unwinds the stack from this call, and the first noexcept function ends the
/// whole program. Here the thread instead waits for the end of the program, as in Python 3.14.
/// `call` should own no Python objects at that time, because unwinding destroys them without the
/// lock.
template <typename Call>
auto OrWaitForTheEnd(Call&& call) {
  try {
    return std::forward<Call>(call)();
  } catch (const std::exception&) {
    throw;
  } catch (...) {
    while (true) ::pause();
  }
}

/// Releases the interpreter's lock in a scope.
class Unlocked {
 public:
  Unlocked() : thread_(PyEval_SaveThread()) {}
  ~Unlocked() {
    OrWaitForTheEnd([this] { PyEval_RestoreThread(thread_); });
  }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  PyThreadState* thread_;
};

/// Returns `call()`, which may use Python, from any thread that does not hold the interpreter's
/// lock.
template <typename Call>
auto WithLock(Call&& call) {
  return OrWaitForTheEnd([&] {
    const pybind11::gil_scoped_acquire lock;
    // A call may also lose the lock; its scope must not release it then.
    return OrWaitForTheEnd(std::forward<Call>(call));
  });
}

}  // namespace dfr::python
