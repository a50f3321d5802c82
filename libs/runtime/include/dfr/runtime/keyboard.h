#pragma once

#include <optional>
#include <string>

namespace dfr::runtime {

/// What an operator types, line by line, without ever waiting for more. One object belongs to one
/// thread.
class Keyboard {
 public:
  /// @param file  a terminal or a pipe to read from: borrowed.
  explicit Keyboard(int file = 0) : file_(file) {}

  /// Throws away all that was typed before, so that no answer is older than its question.
  void Discard() noexcept;
  /// The next whole line, without its end; nothing if there is none, or no more will come. Waits
  /// for it for `timeout_s` at most. A line of more than 4096 characters is cut.
  [[nodiscard]] std::optional<std::string> Line(double timeout_s = 0.0);
  /// Nobody types there any more.
  [[nodiscard]] bool ended() const noexcept { return ended_; }

 private:
  void Read(double timeout_s);
  std::optional<std::string> Cut();

  int file_;
  bool ended_ = false;
  std::string text_;
};

}  // namespace dfr::runtime
