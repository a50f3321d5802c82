#pragma once

#include <cstdint>

#include "dfr/sim/dvrk/psm_console.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim {

/// Options for DvrkScene.
struct DvrkSceneOptions {
  PsmConsoleOptions arm;
  /// The rest of the world. `observation` is ignored: only clients observe.
  LineTrackingOptions world;
  std::uint64_t seed = 0;  ///< Seed of the first episode: line, light, disturbance.
  /// Time in seconds after the last change of the set-point during which the arm still counts as
  /// moving, >= 0. The disturbance acts while the arm moves, and a client's set-points have pauses
  /// between them. Zero for lock-step, which has no pauses.
  double linger_s = 0.05;
};

/// The arm of a PsmConsole in the world of a LineTrackingPlant: above the gauze on the platform,
/// below the camera. The console's encoders give the arm's assumed joint positions; cable errors
/// determine the tip's true position. Uses no network and no clock, like its two parts.
///
/// Until it is homed, the arm stays at the start of the line, where the plant's Reset() placed it.
/// Homing moves it to its home, above the middle of the gauze.
///
/// A disturbance that acts during controls advances while the arm moves. A disturbance that acts
/// between controls advances while the arm does not move, unless linger_s is zero. In lock-step,
/// Rest() stands for the time between controls.
///
/// Everything that affects the state is seeded: the same calls give a bit-identical world. Each
/// object belongs to the thread that made it.
class DvrkScene {
 public:
  /// @param calibration  used to place the tip at the start of the line; see LineTrackingPlant.
  /// @throws as PsmConsole and LineTrackingPlant; std::invalid_argument if linger_s is negative.
  explicit DvrkScene(const DvrkSceneOptions& options = {},
                     const line_task::LineCalibration* calibration = nullptr);

  /// Starts the next episode as LineTrackingPlant::Reset() does, with the arm ENABLED, homed and at
  /// rest.
  void Reset(std::uint64_t seed);
  /// Advances the console and the world by `dt_s`. @pre 0 <= dt_s <= 0.1
  void Step(double dt_s);
  /// Advances only the world by `dt_s`. Call it after stepping the console by the same time.
  void Follow(double dt_s) noexcept;
  /// Completes all commands and brings everything to rest, as after a control of LineTrackingPlant.
  void Rest();
  /// Sets the platform's rest pose, to which the disturbance is added.
  /// @throws std::invalid_argument if it is beyond the platform's reach.
  void MovePlatform(const kinematics::PlatformPose& pose) { plant_.MovePlatform(pose); }
  /// Sets a fault, which lasts until the next call; Reset() does not clear it.
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
