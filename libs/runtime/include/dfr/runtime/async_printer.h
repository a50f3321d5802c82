#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <thread>

#include "dfr/runtime/queue.h"

namespace dfr::runtime {

/// Output for the operator of a run, printed by a separate thread: a stopped terminal (Ctrl-S)
/// blocks neither the robot's loop nor the program's end.
class AsyncPrinter {
 public:
  /// @param file  borrowed.
  /// @param patience_ms  maximum time that the destructor waits for a stopped terminal.
  explicit AsyncPrinter(int file = 1, int patience_ms = 1000);
  /// Prints the remaining lines, but waits at most `patience_ms` for a stopped terminal.
  ~AsyncPrinter();
  AsyncPrinter(const AsyncPrinter&) = delete;
  AsyncPrinter& operator=(const AsyncPrinter&) = delete;

  /// Prints like std::printf(), up to 511 characters, and replaces bytes that control terminals
  /// (core::MakePrintable()). Neither waits nor allocates. If 256 texts are waiting, further texts
  /// are lost and their number is printed. Call it from one thread.
  void Say(const char* format, ...) noexcept __attribute__((format(printf, 2, 3)));
  /// Returns the number of calls of Say().
  [[nodiscard]] std::int64_t said() const noexcept { return said_; }

 private:
  using Text = std::array<char, 512>;
  void Run() noexcept;
  // Returns false if the output was not printed in time.
  bool Print(const char* text) noexcept;

  int file_;
  int patience_ms_;
  Queue<Text, 256> queue_;
  std::int64_t said_ = 0;
  std::atomic<std::int64_t> lost_ = 0;
  std::atomic<bool> end_ = false;
  std::thread thread_;
};

}  // namespace dfr::runtime
