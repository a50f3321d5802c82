#pragma once

#include <atomic>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "dfr/robot/control_loop.h"
#include "dfr/runtime/async_printer.h"
#include "dfr/runtime/keyboard.h"

namespace dfr::robot {

/// Asks the operator of a robot questions at the terminal while the control loop continues. Ignores
/// text typed before a question. The constructor's arguments must outlive the prompt.
class OperatorPrompt {
 public:
  /// @param interrupted  set by Ctrl-C: every answer is then no.
  OperatorPrompt(runtime::Keyboard& keyboard, runtime::AsyncPrinter& printer,
                 const std::atomic<bool>& interrupted)
      : keyboard_(&keyboard), printer_(&printer), interrupted_(&interrupted) {}

  /// Returns the entry of `words` that the operator types; std::nullopt after q, at the end of
  /// input, and if interrupted.
  [[nodiscard]] std::optional<std::string> Answer(ControlLoop& loop, std::string_view question,
                                                  std::span<const std::string_view> words);
  /// Returns true once the operator types exactly `word`; false after q, at the end of input, and
  /// if interrupted.
  [[nodiscard]] bool Confirms(ControlLoop& loop, std::string_view question, std::string_view word);
  /// Asks the operator to do `task`, for example "Put the tip over the line's beginning", and
  /// returns true if the next episode may begin. After a regular end, Enter suffices. After any
  /// other reason to hold, the operator must type `start`. A fault, or a stop that was pressed or
  /// is silent, first requires `clear`. The question names each press that `clear` confirms.
  [[nodiscard]] bool AllowsEpisode(ControlLoop& loop, const std::string& task);

 private:
  runtime::Keyboard* keyboard_;
  runtime::AsyncPrinter* printer_;
  const std::atomic<bool>* interrupted_;
};

}  // namespace dfr::robot
