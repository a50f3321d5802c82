#pragma once

#include <cstddef>
#include <optional>
#include <string>

namespace dfr::runtime {

/// Non-blocking, line-by-line keyboard input of an operator. One object belongs to one thread.
class Keyboard {
 public:
  /// @param file  a terminal or a pipe to read from, borrowed.
  explicit Keyboard(int file = 0) : file_(file) {}

  /// Discards earlier input, which must not answer a later question. Treats the input as ended
  /// after a mebibyte of discarded text, for example from the program `yes`.
  void Discard() noexcept;
  /// Returns the next complete line without its line end, waiting at most `timeout_s`. Returns
  /// std::nullopt if there is none, or the input has ended. Lines longer than 4096 characters are
  /// truncated.
  [[nodiscard]] std::optional<std::string> Line(double timeout_s = 0.0);
  /// True once the input has ended.
  [[nodiscard]] bool ended() const noexcept { return ended_; }

 private:
  void Read(double timeout_s);
  [[nodiscard]] std::size_t LineBegin() const noexcept;
  std::optional<std::string> Cut();

  int file_;
  bool ended_ = false;
  std::string text_;
};

}  // namespace dfr::runtime
