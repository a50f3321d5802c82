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
  double max_period_s = 0.05;    ///< A longer period is kOverrun, in (0, 10].
  double calm_s = 0.2;           ///< Without a reason to hold before it can be started, in [0, 60].
  double image_latency_s = 0.0;  ///< By how much a stamp may be later than the light it shows.
  double image_timeout_s = 2.0;  ///< From a question to its answer; longer is kImageSilent.
  int max_images = 3;            ///< Looked at, one after another, until one shows the state.
  double max_camera_check_s = 0.25;  ///< Since the camera's thread last looked, else kImageSilent.
  /// Since the emergency stop's thread last looked; longer is kEmergencyStopSilent.
  double max_stop_check_s = 0.1;
  /// Distance of the state after a motion from where the motion should have taken it, in the
  /// units of the state; more is kStateJump.
  double max_state_jump = 3.0;
  /// How far the way between two states may be from that of the motions between them: max_drift,
  /// and drift_noise with drift_share of its length. Pictures that do not show the motions (frozen,
  /// late, of another time) are found so, whatever their stamps say. In the units of the state, the
  /// share without one.
  double max_drift = 2.5;
  double drift_noise = 0.3;
  double drift_share = 0.5;
  double drift_stretch = 10.0;  ///< States farther apart are not compared, > 0.
  /// By how much any other entry of the state may change while a motion is carried out, beyond the
  /// motion's own length: the target moves faster than a controller can follow.
  double max_target_jump = 1.5;
};

/// What a loop works with. All outlive it; nullptr where it says so.
struct Devices {
  Clock* clock = nullptr;
  Manipulator* arm = nullptr;
  Camera* camera = nullptr;
  Task* task = nullptr;
  EmergencyStop* emergency_stop = nullptr;         ///< nullptr: none.
  Recorder* recorder = nullptr;                    ///< nullptr: none.
  Platform* platform = nullptr;                    ///< nullptr: nothing moves the target.
  const std::atomic<bool>* interrupted = nullptr;  ///< The operator wants a stop. nullptr: never.
};

/// The control loop of a robot: carries out one control after another with an arm and sees where it
/// led with a camera. It runs while Apply(), Look() and Idle() wait; in every period it examines
/// all that can be a reason to hold. runtime::FailSafe decides: for any reason the arm holds in the
/// same period, and Apply() returns kFault from then on until Start().
///
/// Nothing here allocates, locks or throws but the constructor, AwaitReady(), AwaitHomeable() and
/// what returns a std::string. One object belongs to one thread.
class ControlLoop {
 public:
  /// @throws std::invalid_argument naming the option that is out of range or the device missing.
  ControlLoop(const ControlLoopOptions& options, const Devices& devices);

  /// Runs one period, `dt_s` long where the loop decides how time passes (see Clock::Wait()).
  /// True if the robot may move.
  bool Tick(double dt_s) noexcept;
  bool Tick() noexcept { return Tick(options_.period_s); }
  /// Runs the loop for `seconds`.
  void Idle(double seconds) noexcept;
  /// Runs it until nothing keeps it from being started. False after `timeout_s`, or as soon as it
  /// is interrupted.
  /// @param say  told what it waits for, once, after a second; may be empty.
  [[nodiscard]] bool AwaitReady(double timeout_s, const std::function<void(std::string_view)>& say);
  /// The same until nothing keeps it from being homed: see Home().
  [[nodiscard]] bool AwaitHomeable(double timeout_s,
                                   const std::function<void(std::string_view)>& say);

  /// The operator's word: powers the arm up and homes it, if it needs that. Everything is watched
  /// but the camera and what homing mends; whatever is found ends it in the same period, and
  /// nothing begins while the emergency stop is pressed or not heard of. Returns kNone, or what was
  /// found: blocking_words(). Refused with kOperator while the arm is armed.
  [[nodiscard]] runtime::HoldReason Home() noexcept;
  /// The operator's word: sends the platform home, which takes `duration_s`. Whatever is found
  /// meanwhile makes it rest at once. Returns kNone, or what was found.
  [[nodiscard]] runtime::HoldReason HomePlatform(double duration_s) noexcept;
  /// From now on the platform moves, until the robot may not. Without effect where it may not now.
  void MovePlatform() noexcept;
  /// The operator's word: arms and starts. Returns kNone, or what prevents it. Tries again for
  /// `patience_s` unless a fault has to be cleared first.
  [[nodiscard]] runtime::HoldReason Start(double patience_s = 0.0) noexcept;
  /// The operator's word: a fault is mended, or an emergency stop that was pressed while idle is
  /// known. False if something is still wrong.
  [[nodiscard]] bool Clear() noexcept;
  /// A reason to hold that the caller found. The arm holds with the next period.
  void Hold(runtime::HoldReason reason, std::string_view detail = {}) noexcept;
  /// The task is completed: idle.
  void Complete() noexcept;
  /// What the controller has decided, before Apply(): who drives, or why it halts.
  void Decided(const control::Step& step) noexcept;

  /// Moves the arm as the task plans `control`, waits for rest and looks.
  /// Returns kRefused for a control that is invalid or out of reach, kFault if the robot may not
  /// move or may no longer.
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept;
  /// Moves the arm to `joints` in `duration_s`, and waits for rest.
  [[nodiscard]] core::PlantStatus Move(std::span<const double> joints, double duration_s) noexcept;
  /// Looks at pictures taken from now on until one shows the state. False if there was none: then
  /// the loop holds. From here on motions and states are compared.
  bool Look() noexcept;
  /// The arm holds, whatever the state.
  void Halt() noexcept;

  /// What Look() saw, NaN where the last picture did not show it.
  [[nodiscard]] std::span<const double> observation() const noexcept { return observation_; }
  [[nodiscard]] runtime::RunState state() const noexcept { return machine_.state(); }
  [[nodiscard]] bool may_move() const noexcept { return machine_.may_move(); }
  /// It holds for a reason that an episode may end with: completed, halted by the controller, or
  /// the state was not seen.
  [[nodiscard]] bool ended_regularly() const noexcept;
  /// Why it last held, in words.
  [[nodiscard]] std::string cause() const;
  /// What now keeps it from being started: kNone, or the reason, and that in words.
  [[nodiscard]] runtime::HoldReason blocking() const noexcept { return machine_.blocking(); }
  [[nodiscard]] std::string blocking_words() const;

 private:
  [[nodiscard]] bool Await(double timeout_s, const std::function<void(std::string_view)>& say);
  [[nodiscard]] runtime::HoldReason TryToHome() noexcept;
  [[nodiscard]] runtime::HoldReason TryToStart() noexcept;
  void Watch() noexcept;
  Finding WatchThread(const ThreadFinding& found, std::int64_t max_check_ns,
                      const Finding& hangs) noexcept;
  void Report() noexcept;
  void RestPlatform() noexcept;
  [[nodiscard]] core::PlantStatus Refuse(const Finding& why) noexcept;
  bool Observe() noexcept;
  [[nodiscard]] bool Jumped(std::span<const double> change) const noexcept;
  [[nodiscard]] bool TargetJumped(std::span<const double> change) const noexcept;
  [[nodiscard]] bool Drifted(std::span<const double> change) noexcept;

  // Where the state was once, and the sum of the motions since the loop began to compare.
  struct Waypoint {
    std::vector<double> state;
    std::vector<double> moved;
  };
  static constexpr std::size_t kWaypoints = 64;  // of a stretch
  void Remember() noexcept;

  ControlLoopOptions options_;
  Devices devices_;
  runtime::FailSafe machine_;
  std::vector<double> observation_;
  std::vector<double> before_;
  std::vector<Waypoint> way_;  // the last ones, in a ring
  std::size_t way_size_ = 0;
  std::size_t way_next_ = 0;
  double since_waypoint_ = 0.0;
  std::vector<double> moved_;
  bool homing_ = false;
  bool homing_platform_ = false;
  runtime::HoldReason last_reason_ = runtime::HoldReason::kNone;
  std::array<char, 96> last_detail_{};
};

}  // namespace dfr::robot
