#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/plant.h"
#include "dfr/robot/devices.h"
#include "dfr/runtime/fail_safe.h"

namespace dfr::robot {

/// Options for ControlLoop.
struct ControlLoopOptions {
  double period_s = 0.005;       ///< > 0
  double max_period_s = 0.05;    ///< Maximum period, in (0, 10]; a longer period causes kOverrun.
  double settle_time_s = 0.2;    ///< Time without a reason to hold before Start(), in [0, 60].
  double image_latency_s = 0.0;  ///< Maximum delay of a stamp after the exposure, >= 0.
  double image_timeout_s = 2.0;  ///< Maximum wait for the camera; longer waits cause kImageSilent.
  int max_images = 3;            ///< Maximum number of pictures tried until one shows the state.
  /// Maximum time since the last check by the camera's thread; a longer time causes kImageSilent.
  double max_camera_check_s = 0.25;
  /// Maximum time since the last check by the emergency stop's thread; a longer time causes
  /// kEmergencyStopSilent.
  double max_stop_check_s = 0.1;
  /// Maximum distance between the state after a motion and the state that the motion should reach,
  /// in units of the state. A larger distance causes kStateJump.
  double max_state_jump = 3.0;
  /// Maximum difference between the change of the state and the sum of the motions since a past
  /// state: the smaller of max_drift and drift_noise + drift_share * (length of that sum). Detects
  /// pictures that do not show the motions (frozen, late, of another time) even if their stamps are
  /// valid. In units of the state; drift_share is dimensionless.
  double max_drift = 2.5;
  double drift_noise = 0.3;
  double drift_share = 0.5;
  double drift_stretch = 10.0;  ///< Maximum length of the compared sums of motions, > 0.
  /// Maximum change, during one motion, of a state entry that Motion::change does not predict, in
  /// addition to the motion's length. A larger change means that the target moves faster than a
  /// controller can follow.
  double max_target_jump = 1.5;
};

/// Devices used by the loop. Must outlive the loop; optional ones may be nullptr.
struct Devices {
  Clock* clock = nullptr;
  Manipulator* arm = nullptr;
  Camera* camera = nullptr;
  Task* task = nullptr;
  EmergencyStop* emergency_stop = nullptr;  ///< nullptr: no emergency stop.
  Recorder* recorder = nullptr;             ///< nullptr: no recording.
  Platform* platform = nullptr;             ///< nullptr: the target is stationary.
  /// True once the operator requests a stop. nullptr: never.
  const std::atomic<bool>* interrupted = nullptr;
};

/// Control loop of a robot: executes controls one by one with an arm and observes each resulting
/// state with a camera. The loop runs while Apply(), Look() and Idle() wait, and checks every
/// reason to hold in every period. runtime::FailSafe decides: any reason to hold stops the arm in
/// the same period, and Apply() returns kFault until the next Start().
///
/// No member allocates, locks or throws, except the constructor, AwaitReady(), AwaitHomeable() and
/// members that return a std::string. One object belongs to one thread.
class ControlLoop {
 public:
  /// @throws std::invalid_argument naming the option that is out of range or the missing device.
  ControlLoop(const ControlLoopOptions& options, const Devices& devices);

  /// Runs one period. In lock-step the period is `dt_s` long; see Clock::Wait(). Returns true if
  /// the robot may move.
  bool Tick(double dt_s) noexcept;
  bool Tick() noexcept { return Tick(options_.period_s); }
  /// Runs the loop for `seconds`.
  void Idle(double seconds) noexcept;
  /// Runs the loop until nothing blocks a start. Returns false after `timeout_s`, or at once if
  /// interrupted, if the emergency stop is pressed, or if it is heard again after a silence.
  /// @param say  called once, after one second, with the reason for waiting; may be empty.
  [[nodiscard]] bool AwaitReady(double timeout_s, const std::function<void(std::string_view)>& say);
  /// Same as AwaitReady(), but waits until nothing blocks Home().
  [[nodiscard]] bool AwaitHomeable(double timeout_s,
                                   const std::function<void(std::string_view)>& say);

  /// Operator command: powers up and homes the arm if required. The loop checks everything except
  /// the camera and the conditions that homing clears. Any other reason to hold aborts homing in
  /// the same period. Homing does not start while the emergency stop is silent, or before Clear()
  /// after it was pressed. Returns kNone, or the reason, which blocking_words() describes. Returns
  /// kOperator while the arm is armed.
  [[nodiscard]] runtime::HoldReason Home() noexcept;
  /// Operator command: moves the platform home in `duration_s`. Any reason to hold ends the wait
  /// and calls Platform::Rest(), which may not stop the platform before home. Returns kNone, or
  /// that reason.
  [[nodiscard]] runtime::HoldReason HomePlatform(double duration_s) noexcept;
  /// Starts the platform's motion, which lasts until the robot may no longer move. No effect unless
  /// the robot may move now.
  void MovePlatform() noexcept;
  /// Operator command: arms and starts the robot. Returns kNone, or the reason that prevents it.
  /// Retries for `patience_s` unless a fault must be cleared first.
  [[nodiscard]] runtime::HoldReason Start(double patience_s = 0.0) noexcept;
  /// Operator command: confirms that a fault is repaired, or that an emergency stop that was
  /// pressed or silent while idle has been noticed. Returns false if a reason to hold remains.
  [[nodiscard]] bool Clear() noexcept;
  /// Reports a reason to hold found by the caller. The arm holds in the next period.
  void Hold(runtime::HoldReason reason, std::string_view detail = {}) noexcept;
  /// Reports that the task is completed; the state becomes idle.
  void Complete() noexcept;
  /// Reports the controller's decision before Apply(): the driving mode, or the cause of a halt.
  void Decided(const control::Step& step) noexcept;

  /// Moves the arm as the task plans `control`, waits for rest, and observes the state. Returns
  /// kRefused for a control that is invalid or out of reach, and kFault if the robot must not move
  /// at the beginning, during or after the motion.
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept;
  /// Moves the arm to `joints` in `duration_s` and waits for rest.
  [[nodiscard]] core::PlantStatus Move(std::span<const double> joints, double duration_s) noexcept;
  /// Processes pictures taken from now on until one shows the state, at most max_images. Returns
  /// false if a picture does not arrive or the robot must not move. Restarts the comparison of
  /// motions with states.
  bool Look() noexcept;
  /// Makes the arm hold in any state.
  void Halt() noexcept;

  /// Returns the last observed state; NaN if the last picture does not show it.
  [[nodiscard]] std::span<const double> observation() const noexcept { return observation_; }
  [[nodiscard]] runtime::RunState state() const noexcept { return machine_.state(); }
  [[nodiscard]] bool may_move() const noexcept { return machine_.may_move(); }
  /// Returns false if faulted, or if the last episode ended for a reason other than completion, a
  /// halt of the controller or an image without the state.
  [[nodiscard]] bool ended_regularly() const noexcept;
  /// Describes the reason for the last hold.
  [[nodiscard]] std::string cause() const;
  /// Returns the reason that blocks a start, or kNone. blocking_words() describes it.
  [[nodiscard]] runtime::HoldReason blocking() const noexcept { return machine_.blocking(); }
  [[nodiscard]] std::string blocking_words() const;
  /// Returns true from a press of the emergency stop to Clear(), even if another reason to hold
  /// hides the press. Inform the operator of the press before Clear().
  [[nodiscard]] bool stop_pressed() const noexcept { return stop_pressed_; }
  /// Returns the total time, s, for which a connected emergency stop was silent since the last
  /// Clear(). A start and homing are blocked while it is positive: nobody could stop the robot, and
  /// an operator must know of it before Clear().
  [[nodiscard]] double stop_silence_s() const noexcept {
    return 1e-9 * static_cast<double>(stop_silence_ns_);
  }
  /// Describes stop_silence_s().
  [[nodiscard]] std::string silence_words() const;

 private:
  [[nodiscard]] bool Await(double timeout_s, const std::function<void(std::string_view)>& say);
  [[nodiscard]] runtime::HoldReason TryToHome() noexcept;
  [[nodiscard]] runtime::HoldReason TryToStart() noexcept;
  void CheckThreads() noexcept;
  void NoteSilence(runtime::HoldReason found) noexcept;
  Finding CheckThread(const ThreadHealth& found, std::int64_t max_check_ns,
                      const Finding& hangs) noexcept;
  void Report() noexcept;
  void RestPlatform() noexcept;
  [[nodiscard]] core::PlantStatus Refuse(const Finding& why) noexcept;
  bool Observe() noexcept;
  [[nodiscard]] bool Jumped(std::span<const double> change) const noexcept;
  [[nodiscard]] bool TargetJumped(std::span<const double> change) const noexcept;
  [[nodiscard]] bool Drifted(std::span<const double> change) noexcept;

  // A past state, and the sum of the motions from the start of the comparison to this state.
  struct Waypoint {
    std::vector<double> state;
    std::vector<double> moved;
  };
  static constexpr std::size_t kWaypoints = 64;  // past states compared with each new state
  void Remember() noexcept;

  ControlLoopOptions options_;
  Devices devices_;
  runtime::FailSafe machine_;
  std::vector<double> observation_;
  std::vector<double> before_;
  std::vector<Waypoint> way_;  // ring buffer of the latest waypoints
  std::size_t way_size_ = 0;
  std::size_t way_next_ = 0;
  double since_waypoint_ = 0.0;
  std::vector<double> moved_;
  bool homing_ = false;
  bool homing_platform_ = false;
  bool stop_pressed_ = false;
  bool stop_heard_ = false;  // true if the emergency stop was connected at some time
  bool stop_silent_ = false;
  std::int64_t stop_silence_ns_ = 0;
  std::int64_t stop_checked_ns_ = 0;
  std::array<char, 96> silence_detail_{};
  runtime::HoldReason last_reason_ = runtime::HoldReason::kNone;
  std::array<char, 96> last_detail_{};
};

}  // namespace dfr::robot
