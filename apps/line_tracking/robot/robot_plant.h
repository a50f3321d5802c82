#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

#include "dfr/core/plant.h"
#include "dfr/hardware/bring_up.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/recording/recorder.h"
#include "dfr/robot/control_loop.h"
#include "dfr/runtime/periodic_timer.h"
#include "dfr/vision/calibration_frame.h"
#include "robot/image_worker.h"
#include "robot/robot_config.h"

namespace dfr::apps::line_tracking {

/// Observers of a run. The functions may be empty. The loop calls them, so they must not wait.
struct RunOperator {
  std::function<void(const runtime::Transition&)> on_transition;
  std::function<void(const hardware::ConsoleMessage&)> on_message;
  /// Flag that a signal handler sets to stop the run; nullptr, or it must outlive the run.
  const std::atomic<bool>* interrupted = nullptr;
};

/// Pose of the arm's base in the world frame: the configuration's, or the simulation's by default.
[[nodiscard]] Eigen::Isometry3d Base(const RobotConfig& config);

/// Line tracking on an arm behind a console on the network, with the states and controls of
/// sim::LineTrackingPlant. A robot::ControlLoop carries out the controls. dvrk_simulator sets up
/// episodes and returns the truth. On a robot the operator sets up each episode, and camera and
/// encoders determine its outcome.
///
/// Apply() does not allocate, except in a simulator's request for the truth. One object belongs to
/// the thread that created it.
class RobotPlant final : public core::Plant {
 public:
  /// Joins the network and waits for the devices.
  /// @param recorder  receives transitions and pictures; may be nullptr, otherwise must outlive
  /// this object.
  /// @throws std::runtime_error naming the missing device and the remedy.
  RobotPlant(const RobotConfig& config, const line_task::LineCalibration& calibration,
             recording::Recorder* recorder, const RunOperator& run_operator = {});
  ~RobotPlant() override;

  /// Same as hardware::BringUp(). In lock-step the simulator homes its arm.
  void BringUp(const hardware::Say& say, const hardware::Confirms& confirms = {});
  /// Asks whether the operator accepts the participants that can hold or free the arm or change its
  /// state. Lists those that are not accepted yet.
  [[nodiscard]] bool AcceptsOthers(const hardware::Say& say, const hardware::Confirms& confirms);
  /// Returns true if no participant has joined since AcceptsOthers().
  [[nodiscard]] bool KnowsOthers() const;
  /// The control loop, with its reasons to hold.
  [[nodiscard]] robot::ControlLoop& loop() noexcept;
  [[nodiscard]] const robot::ControlLoop& loop() const noexcept;
  /// Same as loop().Clear(). In lock-step, repeats the request to a simulator that did not answer.
  [[nodiscard]] bool Clear() noexcept;

  [[nodiscard]] const core::StateLayout& layout() const noexcept override;
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  /// With a simulator: begins the next episode, which starts as soon as there is no reason to hold.
  /// On a robot the operator has placed the tip, and the episode starts at once. The platform's
  /// wave begins with the episode, and ends as soon as the robot holds for any reason.
  /// @throws std::runtime_error with the reason to hold: at once on a robot or if a fault was not
  ///   cleared, after 3 s with a simulator, and after simulator_answer_s in lock-step.
  void Reset(std::uint64_t seed) override;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override;
  /// Holds the arm: loop().state() is then idle after a completed task, otherwise holding. From
  /// then on, the loop runs only during calls such as loop().Idle().
  void Halt() noexcept override;

  /// Measures the state while the robot is not started; the arm may be teleoperated, moved by its
  /// clutch, or at rest. Returns false, with a NaN state, if the next picture misses line or tip.
  /// @throws std::runtime_error with the error of arm, measurements, pictures or emergency stop. An
  ///   arm that is not ready, such as a disabled one, is no error if its measurements are valid.
  [[nodiscard]] bool ObserveIdle(std::span<double> state);
  /// Returns joints, marks and tip for a calibration. Otherwise like ObserveIdle().
  /// @throws std::runtime_error as ObserveIdle(), and if the arm is moving, or marks or tip are not
  /// found.
  [[nodiscard]] vision::CalibrationFrame CaptureCalibrationFrame();

  /// Picture of the last Observe(), and the features in it.
  [[nodiscard]] const ImageAnswer& last_image() const noexcept;
  [[nodiscard]] double progress_m() const noexcept;
  /// Timing of the loop; nullptr in lock-step.
  [[nodiscard]] const runtime::PeriodicTimer* timer() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::apps::line_tracking
