#pragma once

#include <atomic>
#include <memory>

#include "dfr/recording/recorder.h"
#include "dfr/robot/operator_prompt.h"
#include "dfr/runtime/async_printer.h"
#include "robot/robot_plant.h"

namespace dfr::apps::line_tracking {

/// The operator's task before an episode, see robot::OperatorPrompt::AllowsEpisode().
inline constexpr const char* kPrepare = "Put the tip over the line's beginning";

/// Terminal of a program that controls a robot: output, input, and Ctrl-C. One per process.
class Terminal {
 public:
  /// Makes SIGINT and SIGTERM set interrupted() instead of ending the process.
  Terminal();

  [[nodiscard]] runtime::AsyncPrinter& printer() noexcept { return printer_; }
  [[nodiscard]] robot::OperatorPrompt& prompt() noexcept { return prompt_; }
  [[nodiscard]] static const std::atomic<bool>& interrupted() noexcept;

 private:
  runtime::AsyncPrinter printer_;
  runtime::Keyboard keyboard_;
  robot::OperatorPrompt prompt_;
};

/// Brings up the robot of the configuration with its operator at the terminal: see
/// RobotPlant::BringUp(). Terminal and recorder must outlive the plant; `recorder` may be nullptr.
/// @throws std::runtime_error naming the device and its fault.
[[nodiscard]] std::unique_ptr<RobotPlant> BringUpRobot(
    const RobotConfig& config, const line_task::LineCalibration& calibration,
    recording::Recorder* recorder, Terminal& terminal);

}  // namespace dfr::apps::line_tracking
