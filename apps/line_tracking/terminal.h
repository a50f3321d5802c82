#pragma once

#include <atomic>
#include <memory>

#include "dfr/recording/recorder.h"
#include "operator_desk.h"
#include "robot_plant.h"
#include "screen.h"

namespace dfr::apps::line_tracking {

/// The terminal of a program that drives a robot: what it says, what is typed, and Ctrl-C. There is
/// one in a process.
class Terminal {
 public:
  /// From now on SIGINT and SIGTERM end what goes on in order.
  Terminal();

  [[nodiscard]] Screen& screen() noexcept { return screen_; }
  [[nodiscard]] OperatorDesk& desk() noexcept { return desk_; }
  [[nodiscard]] static const std::atomic<bool>& interrupted() noexcept;

 private:
  Screen screen_;
  runtime::Keyboard keyboard_;
  OperatorDesk desk_;
};

/// The robot of the configuration, brought up as its operator at the terminal says: see
/// RobotPlant::BringUp(). Both that and the recorder, which may be nullptr, outlive it.
/// @throws std::runtime_error with what is wrong.
[[nodiscard]] std::unique_ptr<RobotPlant> BringUpRobot(
    const RobotConfig& config, const line_task::LineCalibration& calibration,
    recording::Recorder* recorder, Terminal& terminal);

}  // namespace dfr::apps::line_tracking
