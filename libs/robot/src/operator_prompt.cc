#include "dfr/robot/operator_prompt.h"

#include <algorithm>

namespace dfr::robot {

std::optional<std::string> OperatorPrompt::Answer(ControlLoop& loop, std::string_view question,
                                                  std::span<const std::string_view> words) {
  constexpr int kAgain = 50;  // keyboard checks before the question is repeated: one second
  keyboard_->Discard();
  std::int64_t asked = -1;  // printer_->said() after the question
  for (int looks = 0; !*interrupted_ && !keyboard_->ended(); ++looks) {
    // Repeats the question if other output has scrolled it away.
    if (looks % kAgain == 0 && printer_->said() != asked) {
      printer_->Say("%.*s; q ends\n", static_cast<int>(question.size()), question.data());
      asked = printer_->said();
    }
    loop.Idle(0.02);
    std::optional<std::string> line = keyboard_->Line();
    if (!line) continue;
    if (std::ranges::find(words, std::string_view(*line)) != words.end()) return line;
    if (*line == "q") break;
    printer_->Say("'%.40s' is not the requested word; q ends\n", line->c_str());
  }
  return std::nullopt;
}

bool OperatorPrompt::Confirms(ControlLoop& loop, std::string_view question, std::string_view word) {
  return Answer(loop, question, {&word, 1}).has_value();
}

bool OperatorPrompt::AllowsEpisode(ControlLoop& loop, const std::string& task) {
  using runtime::HoldReason;
  using runtime::RunState;
  std::string cleared;  // what the operator has cleared
  while (true) {
    const bool faulted = loop.state() == RunState::kFaulted;
    // The emergency stop was pressed, or is silent, while the robot is idle.
    const bool pressed = loop.stop_pressed();
    const bool silent = loop.stop_silence_s() > 0.0;
    const bool stopped =
        pressed || silent ||
        (loop.state() == RunState::kIdle && loop.blocking() == HoldReason::kEmergencyStopSilent);
    if (faulted || stopped) {
      std::string what = faulted ? loop.cause() : loop.blocking_words();
      const std::string press =
          std::string(runtime::Name(HoldReason::kEmergencyStop)) + ": pressed";
      if (pressed && what != press) what += "; " + press;
      const std::string silence = loop.silence_words();
      if (silent && what != silence) what += "; " + silence;
      const std::string question =
          (faulted ? "faulted: " : "") + what + ". Correct it, then type clear";
      if (!Confirms(loop, question, "clear")) return false;
      // The operator does not know of a press or a silence during the question.
      if ((loop.stop_pressed() && !pressed) || (loop.stop_silence_s() > 0.0 && !silent)) continue;
      if (!loop.Clear()) printer_->Say("the reason remains: %s\n", loop.blocking_words().c_str());
      cleared = what;
      continue;
    }
    const bool regular = cleared.empty() && loop.ended_regularly();
    const std::string held = cleared.empty() ? loop.cause() : cleared;
    if (!(regular ? Confirms(loop, task + "; Enter starts", "")
                  : Confirms(loop, "held: " + held + ". " + task + ", then type start", "start"))) {
      return false;
    }
    // A press, a silence or a fault during the question voids the answer.
    if (loop.state() != RunState::kFaulted && !loop.stop_pressed() &&
        loop.stop_silence_s() == 0.0) {
      return true;
    }
  }
}

}  // namespace dfr::robot
