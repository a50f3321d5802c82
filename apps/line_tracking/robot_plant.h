#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

#include "bring_up.h"
#include "dfr/core/plant.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/recording/recorder.h"
#include "dfr/robot/control_loop.h"
#include "dfr/runtime/periodic_timer.h"
#include "dfr/vision/calibration_frame.h"
#include "image_worker.h"
#include "robot_config.h"

namespace dfr::apps::line_tracking {

/// Who watches a run. The functions may be empty; the loop calls them, so that they may not wait.
struct RunOperator {
  std::function<void(const runtime::Transition&)> on_transition;
  std::function<void(const hardware::ConsoleWord&)> on_word;
  /// Asks a question, and goes on with the loop until exactly `word` is typed; false if the
  /// operator does not want it. Where there is no such function, nobody wants anything.
  std::function<bool(std::string_view question, std::string_view word)> confirms;
  /// Where a signal handler says that the operator wants a stop; may be nullptr, else outlives the
  /// run.
  const std::atomic<bool>* interrupted = nullptr;
};

/// The arm's base in the world frame: the configuration's, else the simulation's.
[[nodiscard]] Eigen::Isometry3d Base(const RobotConfig& config);

/// Line tracking on an arm behind a console: the same states and controls as
/// sim::LineTrackingPlant, over the network, carried out by a robot::ControlLoop. A console of
/// dvrk_simulator's is told of episodes and asked for the truth; on a robot the operator sets up
/// each episode, and camera and encoders alone say how it went.
///
/// Apply() allocates nothing of its own; with a simulator it asks for the truth, which does. One
/// object belongs to the thread that made it.
class RobotPlant final : public core::Plant {
 public:
  /// Joins the network and waits for the devices.
  /// @param recorder  gets transitions and pictures; may be nullptr, else outlives this.
  /// @throws std::runtime_error naming the device that is not there, and what to do.
  RobotPlant(const RobotConfig& config, const line_task::LineCalibration& calibration,
             recording::Recorder* recorder, const RunOperator& run_operator = {});
  ~RobotPlant() override;

  /// As line_tracking::BringUp(). In lock-step the simulator homes its arm itself.
  void BringUp(const Say& say, const Confirms& confirms = {});
  /// Whether the operator accepts who else can tell the arm to hold, to be free or to change its
  /// state; those who have not been accepted yet are listed and asked about.
  [[nodiscard]] bool AcceptsOthers(const Say& say, const Confirms& confirms);
  /// Whether nobody has come since.
  [[nodiscard]] bool KnowsOthers() const;
  /// What moves the robot, and why it does not.
  [[nodiscard]] robot::ControlLoop& loop() noexcept;
  [[nodiscard]] const robot::ControlLoop& loop() const noexcept;
  /// As loop().Clear(); a simulator in lock-step that did not answer is asked again.
  [[nodiscard]] bool Clear() noexcept;

  [[nodiscard]] const core::StateLayout& layout() const noexcept override;
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  /// With a simulator: the next episode, which starts as soon as there is no reason to hold. On a
  /// robot the tip is where the operator put it, and the episode starts at once.
  /// The platform's wave begins with it, and ends as soon as the robot holds for whatever reason.
  /// @throws std::runtime_error with the reason to hold: at once on a robot and if a fault was not
  ///   cleared, with a simulator after 3 s, in lock-step after its time for an answer.
  void Reset(std::uint64_t seed) override;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override;
  /// The arm holds: the machine is idle where the task is completed, else holding. The loop goes on
  /// with loop().Idle() only.
  void Halt() noexcept override;

  /// Looks while the robot is not started, whoever moves the arm: by teleoperation, by its clutch,
  /// not at all. False, and the state is NaN, where the next picture does not show it.
  /// @throws std::runtime_error with what is wrong with arm, pictures or emergency stop.
  [[nodiscard]] bool Watch(std::span<double> state);
  /// The same for a calibration: what the arm reports, and where marks and tip are in the next
  /// picture.
  /// @throws std::runtime_error as Watch(), and if the arm moves, or marks or tip are not found.
  [[nodiscard]] vision::CalibrationFrame Sight();

  /// The picture that Observe() was taken from, and what it shows.
  [[nodiscard]] const ImageAnswer& last_image() const noexcept;
  [[nodiscard]] double progress_m() const noexcept;
  /// How the loop kept its time; nullptr in lock-step.
  [[nodiscard]] const runtime::PeriodicTimer* timer() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::apps::line_tracking
