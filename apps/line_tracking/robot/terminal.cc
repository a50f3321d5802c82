#include "robot/terminal.h"

#include <csignal>
#include <iostream>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::line_tracking {
namespace {

std::atomic<bool> interrupted = false;
static_assert(std::atomic<bool>::is_always_lock_free);

constexpr const char* kWithoutStop =
    "WITHOUT AN EMERGENCY STOP: only the console and Ctrl-C here stop the arm";

// The operator's task before an episode, see robot::OperatorPrompt::AllowsEpisode().
constexpr const char* kPrepare = "Put the tip over the line's beginning";

void Interrupt(int /*signal*/) { interrupted = true; }

void Show(runtime::AsyncPrinter& printer, const runtime::Transition& t) noexcept {
  const bool reasoned = t.reason != runtime::HoldReason::kNone;
  const bool detailed = t.detail[0] != '\0';
  printer.Say("  %s -> %s%s%s%s%s%s\n", runtime::Name(t.from), runtime::Name(t.to),
              reasoned ? ": " : "", reasoned ? runtime::Name(t.reason) : "", detailed ? " (" : "",
              t.detail.data(), detailed ? ")" : "");
}

}  // namespace

Terminal::Terminal() : prompt_(keyboard_, printer_, line_tracking::interrupted) {
  std::signal(SIGINT, Interrupt);
  std::signal(SIGTERM, Interrupt);
  std::signal(SIGHUP, Interrupt);
  std::signal(SIGPIPE, SIG_IGN);
  std::cout << std::flush;
}

const std::atomic<bool>& Terminal::interrupted() noexcept { return line_tracking::interrupted; }

std::unique_ptr<RobotPlant> BringUpRobot(const RobotConfig& config,
                                         const line_task::LineCalibration& calibration,
                                         recording::Recorder* recorder, Terminal& terminal) {
  runtime::AsyncPrinter& printer = terminal.printer();
  const bool without_stop = !config.emergency_stop;
  if (without_stop) printer.Say("%s\n", kWithoutStop);
  if (config.priority > 0) {
    const std::string refused = runtime::AskForRealTime(config.priority);
    if (!refused.empty()) printer.Say("note: %s\n", refused.c_str());
  }
  RunOperator run_operator;
  run_operator.on_transition = [&printer, without_stop](const runtime::Transition& t) {
    if (without_stop && t.to == runtime::RunState::kArmed) printer.Say("  %s\n", kWithoutStop);
    Show(printer, t);
  };
  run_operator.on_message = [&printer](const hardware::ConsoleMessage& message) {
    printer.Say("  message from the console (%s): %s\n", hardware::Name(message.severity),
                message.text.data());
  };
  run_operator.interrupted = &interrupted;
  auto plant = std::make_unique<RobotPlant>(config, calibration, recorder, run_operator);
  // The thread of the loop gets a higher priority than the threads of the network.
  if (config.priority > 0) static_cast<void>(runtime::AskForRealTime(config.priority + 1));
  plant->BringUp(
      [&printer](std::string_view words) {
        printer.Say("  %.*s\n", static_cast<int>(words.size()), words.data());
      },
      [&](std::string_view question, std::string_view word) {
        return terminal.prompt().Confirms(plant->loop(), question, word);
      });
  return plant;
}

bool MayBegin(RobotPlant& plant, bool simulated, Terminal& terminal) {
  robot::OperatorPrompt& prompt = terminal.prompt();
  const auto say = [&](std::string_view words) {
    terminal.printer().Say("  %.*s\n", static_cast<int>(words.size()), words.data());
  };
  const auto confirms = [&](std::string_view question, std::string_view word) {
    return prompt.Confirms(plant.loop(), question, word);
  };
  do {
    if (!plant.AcceptsOthers(say, confirms)) return false;
    if (simulated) {
      // Without an operator, a silence of the emergency stop while idle is only reported.
      if (plant.loop().stop_silence_s() > 0.0 && !plant.loop().stop_pressed() &&
          plant.loop().state() == runtime::RunState::kIdle) {
        say(plant.loop().silence_words());
        static_cast<void>(plant.Clear());
      }
      return plant.loop().ended_regularly();
    }
    if (!prompt.AllowsEpisode(plant.loop(), kPrepare)) return false;
  } while (!plant.KnowsOthers());  // a participant joined during the question
  return true;
}

}  // namespace dfr::apps::line_tracking
