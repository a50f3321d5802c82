#pragma once

#include <cstdint>

#include "dfr/sim/dvrk/psm_console.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim {

/// Options for DvrkScene.
struct DvrkSceneOptions {
  PsmConsoleOptions arm;  ///< Its joint_error is not used: the plant's arm has one of its own.
  /// The rest of the world. Its observations are not used: only clients look.
  LineTrackingOptions world;
  std::uint64_t seed = 0;  ///< Seeds the first episode: line, light, disturbance.
  /// Seconds after the set-point's last change for which the arm still counts as moving, >= 0. The
  /// disturbance acts while the arm moves, and a client's set-points come with pauses. Zero for
  /// lock-step, where there are no pauses.
  double linger_s = 0.05;
};

/// The arm of a PsmConsole at work in the world of a LineTrackingPlant: where the console's
/// encoders say the joints are, the arm believes to be; its tip goes where its cables put it, over
/// the gauze on the platform, below the camera. Without a network and without a clock, as both of
/// them.
///
/// Until the arm is homed it stays at the line's beginning, where the plant's Reset() put it;
/// homing moves it to its home, over the gauze's middle.
///
/// The disturbance's time goes on while the arm moves if it acts during controls, and, if linger_s
/// is not zero, while it does not if it acts between them; in lock-step Rest() is between.
///
/// Everything the state depends on is seeded, so the same calls give the same world, to the bit.
/// One object belongs to the thread that made it.
class DvrkScene {
 public:
  /// @param calibration  what the operator knows who puts the tip over the line's beginning; as
  ///   with LineTrackingPlant.
  /// @throws as PsmConsole and LineTrackingPlant; std::invalid_argument if linger_s is negative.
  explicit DvrkScene(const DvrkSceneOptions& options = {},
                     const line_task::LineCalibration* calibration = nullptr);

  /// The next episode: as LineTrackingPlant::Reset(), and the arm ENABLED, homed and at rest there.
  void Reset(std::uint64_t seed);
  /// The console and the world go on by `dt_s`. @pre 0 <= dt_s <= 0.1
  void Step(double dt_s);
  /// The world alone follows the console, which was stepped by `dt_s`.
  void Follow(double dt_s) noexcept;
  /// Everything that was asked for is done and at rest, as after a control of LineTrackingPlant.
  void Rest();
  /// Puts the platform's rest pose there, on top of the disturbance.
  /// @throws std::invalid_argument if it is beyond the platform's reach.
  void MovePlatform(const kinematics::PlatformPose& pose) { plant_.MovePlatform(pose); }
  /// Until another is set, also over Reset().
  void SetCameraFault(CameraFault fault) noexcept;
  [[nodiscard]] CameraFault camera_fault() const noexcept { return camera_fault_; }

  [[nodiscard]] PsmConsole& console() noexcept { return console_; }
  [[nodiscard]] const PsmConsole& console() const noexcept { return console_; }
  [[nodiscard]] const LineTrackingPlant& plant() const noexcept { return plant_; }
  [[nodiscard]] const DvrkSceneOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::uint64_t seed() const noexcept { return seed_; }

 private:
  DvrkSceneOptions options_;
  PsmConsole console_;
  LineTrackingPlant plant_;
  std::uint64_t seed_;
  kinematics::PsmJoints last_setpoint_;
  double still_s_;
  CameraFault camera_fault_ = CameraFault::kNone;
};

}  // namespace dfr::sim
