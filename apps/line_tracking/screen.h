#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <thread>

#include "dfr/runtime/queue.h"

namespace dfr::apps::line_tracking {

/// What a run tells its operator, printed by a thread of its own: a terminal that stands still
/// (Ctrl-S) does not stop the robot's loop, nor the program's end.
class Screen {
 public:
  /// @param file  borrowed.
  /// @param patience_ms  how long the end waits for a terminal that takes nothing.
  explicit Screen(int file = 1, int patience_ms = 1000);
  /// Prints what is left, unless the terminal takes nothing for so long.
  ~Screen();
  Screen(const Screen&) = delete;
  Screen& operator=(const Screen&) = delete;

  /// Prints as std::printf does, up to 511 characters. Neither waits nor allocates. What does not
  /// fit beside the 256 texts that wait is lost, and their number is shown.
  /// To be called by one thread.
  void Say(const char* format, ...) noexcept __attribute__((format(printf, 2, 3)));
  /// How often that was called.
  [[nodiscard]] std::int64_t said() const noexcept { return said_; }

 private:
  using Text = std::array<char, 512>;
  void Run() noexcept;
  // False if it was not printed in time.
  bool Print(const char* text) noexcept;

  int file_;
  int patience_ms_;
  runtime::Queue<Text, 256> queue_;
  std::int64_t said_ = 0;
  std::atomic<std::int64_t> lost_ = 0;
  std::atomic<bool> end_ = false;
  std::thread thread_;
};

}  // namespace dfr::apps::line_tracking
