#pragma once

#include <atomic>
#include <memory>

#include "dfr/recording/recorder.h"
#include "dfr/robot/operator_desk.h"
#include "dfr/runtime/screen.h"
#include "robot_plant.h"

namespace dfr::apps::line_tracking {

/// What the operator does before an episode, see robot::OperatorDesk::AllowsEpisode().
inline constexpr const char* kPrepare = "Put the tip over the line's beginning";

/// Terminal of a program that controls a robot: output, input, and Ctrl-C. One per process.
class Terminal {
 public:
  /// Makes SIGINT and SIGTERM end the program in order.
  Terminal();

  [[nodiscard]] runtime::Screen& screen() noexcept { return screen_; }
  [[nodiscard]] robot::OperatorDesk& desk() noexcept { return desk_; }
  [[nodiscard]] static const std::atomic<bool>& interrupted() noexcept;

 private:
  runtime::Screen screen_;
  runtime::Keyboard keyboard_;
  robot::OperatorDesk desk_;
};

/// Brings up the robot of the configuration with its operator at the terminal: see
/// RobotPlant::BringUp(). Terminal and recorder, which may be nullptr, must outlive it.
/// @throws std::runtime_error with what is wrong.
[[nodiscard]] std::unique_ptr<RobotPlant> BringUpRobot(
    const RobotConfig& config, const line_task::LineCalibration& calibration,
    recording::Recorder* recorder, Terminal& terminal);

}  // namespace dfr::apps::line_tracking
