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
  /// @param patience_ms  largest time that the end waits for a stopped terminal.
  explicit AsyncPrinter(int file = 1, int patience_ms = 1000);
  /// Prints the remaining lines, unless the terminal stays stopped for this time.
  ~AsyncPrinter();
  AsyncPrinter(const AsyncPrinter&) = delete;
  AsyncPrinter& operator=(const AsyncPrinter&) = delete;

  /// Prints as std::printf does, up to 511 characters. Neither waits nor allocates. Texts beyond
  /// 256 waiting ones are lost, and their number is printed. Call it from one thread.
  void Say(const char* format, ...) noexcept __attribute__((format(printf, 2, 3)));
  /// Number of these calls.
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
