#pragma once

#include <atomic>
#include <memory>

#include "dfr/recording/recorder.h"
#include "dfr/robot/operator_prompt.h"
#include "dfr/runtime/async_printer.h"
#include "robot/robot_plant.h"

namespace dfr::apps::line_tracking {

/// Terminal of a program that controls a robot: output, input, and Ctrl-C. One per process.
class Terminal {
 public:
  /// Makes SIGINT, SIGTERM and SIGHUP (a closed terminal) set interrupted() instead of ending the
  /// process. A closed pipe at the output (SIGPIPE) does not end it either.
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

/// On a robot, an episode begins after the operator's confirmation, which also covers participants
/// that joined the network. In simulation it begins after a regular end of the previous episode.
/// Returns false if no further episode may begin.
[[nodiscard]] bool MayBegin(RobotPlant& plant, bool simulated, Terminal& terminal);

}  // namespace dfr::apps::line_tracking
