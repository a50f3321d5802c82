#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <limits>
#include <optional>

#include "dfr/dds/messages.h"
#include "dfr/dds/watchdog.h"
#include "dfr/hardware/psm_motion.h"
#include "dfr/hardware/psm_statements.h"
#include "dfr/hardware/psm_status.h"
#include "dfr/kinematics/psm.h"

namespace dfr::hardware {

/// Options for PsmClient.
struct PsmClientOptions {
  PsmLimits limits = {};
  PsmRestOptions rest = {};
  /// Maximum lag of the arm behind its set-point, rad (insertion: m), > 0.
  kinematics::PsmJoints max_lag =
      (kinematics::PsmJoints() << 0.09, 0.09, 0.01, 0.15, 0.15, 0.15).finished();
  /// Maximum distance of the console's set-point from the range of the recently sent set-points,
  /// rad (insertion: m), > 0. Covers errors of inverse kinematics and rounding. The console's speed
  /// limits allow other clients 0.008 rad (insertion: 1 mm) in a step of 5 ms.
  kinematics::PsmJoints max_setpoint_error =
      (kinematics::PsmJoints() << 0.003, 0.003, 0.0003, 0.01, 0.01, 0.01).finished();
  double max_jaw_setpoint_error = 0.05;  ///< Same as max_setpoint_error, for the jaw, rad, > 0.
  /// Maximum speed between two samples, rad/s (insertion: m/s), > 0: the console's limits with a
  /// margin for noise.
  kinematics::PsmJoints jump_speed =
      (kinematics::PsmJoints() << 2.4, 2.4, 0.3, 2.4, 2.4, 2.4).finished();
  /// Additional allowance for noise, rad (insertion: m), >= 0.
  kinematics::PsmJoints jump_noise =
      (kinematics::PsmJoints() << 0.01, 0.01, 0.002, 0.02, 0.02, 0.02).finished();
  double jump_distance_m = 0.005;  ///< Allowance for noise of measured_cp, > 0.
  /// Limits for measured_js, measured_cp, local/measured_cp, setpoint_js and, for a jaw that this
  /// client has moved, jaw/setpoint_js. Only max_silence_s applies to pairs of measured_cp and
  /// local/measured_cp of the same moment.
  dds::WatchdogOptions watchdog = {};
  /// Maximum progress of a move in one step, s, > 0. After a late step the move takes longer
  /// instead of catching up in one jump.
  double longest_step_s = 0.005;
  double max_tick_gap_s = 0.1;   ///< Maximum time between two steps while armed, > 0.
  double reach_timeout_s = 2.0;  ///< Maximum time from the end of a move to rest, > 0.
  /// When arming, > 0: maximum distance of local/measured_cp (of measured_cp if there is no such
  /// topic) from the wrist position computed from measured_js. While armed: maximum motion of the
  /// frame of measured_cp.
  double max_frame_distance_m = 0.002;
  double max_frame_angle = 0.05;  ///< Same as max_frame_distance_m, for the rotation, rad.
  double enable_timeout_s = 10.0;
  double home_timeout_s = 90.0;
  /// Minimum time from the discovery of the last participant to arming or homing, >= 0: the client
  /// waits until discovery is complete.
  double discovery_s = 0.5;
  double repeat_request_s = 2.0;  ///< A state command without effect is repeated after this time.
  PsmProfile profile = PsmProfile::kSmooth;
  /// Holds if another participant publishes on the arm's command topics, tells the arm to hold or
  /// be free, joins the network while the arm is armed, changes the arm's control at the console,
  /// or moves the arm's set-point.
  bool sole_commander = true;

  /// @throws std::invalid_argument naming the option that is out of range.
  void Check() const;
};

/// State of a client.
enum class PsmPhase {
  kIdle,       ///< Listens and sends nothing.
  kRequested,  ///< A state command (enable, home, ...) is in progress.
  kArmed,      ///< Sends set-points.
  kHolding,    ///< Sends no set-points; status() is the cause. Ends with Arm() or a request.
};

[[nodiscard]] const char* Name(PsmPhase phase) noexcept;

/// State commands of CRTK.
enum class PsmRequest { kNone, kEnable, kDisable, kHome };

/// Returns the console's name for the request: "enable", ...; empty for kNone.
[[nodiscard]] const char* Name(PsmRequest request) noexcept;

/// CRTK states, named as in operating_state.
enum class PsmConsoleState { kUnknown, kDisabled, kEnabled, kPaused, kFault };

[[nodiscard]] const char* Name(PsmConsoleState state) noexcept;

/// Sample of measured_js or setpoint_js.
struct PsmJointSample {
  dds::Stamp stamp;
  bool well_formed = false;   ///< True if there are six positions.
  bool has_velocity = false;  ///< True if there are six velocities.
  kinematics::PsmJoints position = kinematics::PsmJoints::Zero();
  kinematics::PsmJoints velocity = kinematics::PsmJoints::Zero();
};

/// Sample of measured_cp or local/measured_cp.
struct PsmPoseSample {
  dds::Stamp stamp;
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

/// Sample of jaw/measured_js or jaw/setpoint_js.
struct PsmJawSample {
  dds::Stamp stamp;
  double angle = 0.0;
};

/// Sample of operating_state.
struct PsmOperatingState {
  PsmConsoleState state = PsmConsoleState::kUnknown;
  bool homed = false;
  bool busy = false;
  /// Number of samples whose Readiness() is not kOk, and the last such result. Also counts samples
  /// that newer samples replaced before the client read them.
  std::uint32_t lapses = 0;
  PsmStatus last_lapse = PsmStatus::kOk;
};

/// Returns kOk if the arm is ENABLED, homed and not busy; otherwise the reason why it is not ready.
[[nodiscard]] PsmStatus Readiness(const PsmOperatingState& state) noexcept;

/// The instrument on the arm, as the console names it on tool_type.
enum class PsmInstrument {
  kNotNamed,  ///< The console has named no instrument yet.
  kOther,     ///< An instrument whose kinematics are unknown.
  kSuitable,  ///< A Large Needle Driver for this generation of the arm.
};

/// Input received since the last step.
struct PsmInput {
  std::optional<PsmJointSample> measured_js;
  std::optional<PsmJointSample> setpoint_js;
  std::optional<PsmPoseSample> measured_cp;
  std::optional<PsmPoseSample> local_measured_cp;
  std::optional<PsmJawSample> jaw_measured;
  std::optional<PsmJawSample> jaw_setpoint;
  std::optional<PsmOperatingState> operating_state;
  int errors = 0;  ///< Number of messages on the console's topic error.
  /// Number of matched publishers of measured_js, or of another state that has several publishers.
  int state_publishers = 0;
  /// Number of publishers of measured_js refused because of their quality of service.
  int incompatible = 0;
  int other_publishers = 0;  ///< Number of publishers on the command topics other than this client.
  int foreign_messages = 0;  ///< Number of messages by others on hold, free and state_command.
  /// Number of the console's statements for which ControlStatedBy() returns kPoses, and number for
  /// which it returns kOther.
  int pose_controls = 0;
  int other_controls = 0;
  /// Number of participants, and of publishers of the arm's commands or settings, discovered since
  /// the last step. Their earlier messages are unknown.
  int newcomers = 0;
  /// Number of moves ended by the console; this client never starts such moves.
  int goals_reached = 0;
  bool teleoperated = false;  ///< True if teleoperation is enabled, or was since the last step.
  bool clutched = false;  ///< True if a clutch of the arm is pressed, or was since the last step.
  PsmInstrument instrument = PsmInstrument::kNotNamed;
  int tool_changes = 0;         ///< Number of changes of the instrument.
  int command_subscribers = 0;  ///< Number of subscribers to state_command.
  bool send_failed = false;     ///< True if output was dropped because a queue was full.
};

/// Output to send now.
struct PsmOutput {
  /// Pose of the wrist and its twist, m/s and rad/s, in the frame of measured_cp.
  Eigen::Isometry3d servo_cp = Eigen::Isometry3d::Identity();
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  double jaw = 0.0;
  PsmRequest request = PsmRequest::kNone;
  bool servo = false;
  bool servo_jaw = false;
  bool hold = false;
};

/// Logic of a client of one PSM behind a da Vinci Research Kit console (CRTK): processes received
/// messages and determines the messages to send. The caller provides network access and time.
///
/// Every error leads to kHolding: the client tells the console to hold, sends nothing more, and
/// keeps the first cause in status() until the next Arm(). The console keeps the last set-point
/// indefinitely, so silence also holds the arm.
///
/// On a cart with setup joints or an endoscope arm, measured_cp is relative to the camera. The
/// simultaneous local/measured_cp then gives the arm's base in that frame. The client records the
/// base when arming; the base must not move while armed.
///
/// Only the constructor allocates, locks or throws. One object belongs to one thread at a time.
class PsmClient {
 public:
  /// @throws std::invalid_argument as PsmClientOptions::Check().
  explicit PsmClient(const PsmClientOptions& options);

  /// Processes the input, decides, and returns the output to send. Must be called at 200 Hz or
  /// more.
  /// @param steady_ns  time of a monotonic clock.
  /// @param wall_ns  time since the epoch, as in stamps.
  PsmOutput Step(const PsmInput& input, std::int64_t steady_ns, std::int64_t wall_ns) noexcept;

  /// Requests a state command in the next steps. An armed client holds first. Ends in kIdle, or in
  /// kHolding with kTimedOut, kNoConsole, kConsoleFault, or an error found during power-up or
  /// homing. In kHolding, a console that is powering up or homing is also told to disable. kDisable
  /// does not wait for an effect. In FAULT all other requests are refused with kConsoleFault.
  PsmStatus Request(PsmRequest request) noexcept;

  /// Starts sending set-points, beginning with the console's own, if the last step found no error.
  /// Otherwise returns the reason without any change. This is the only way to resume after a fault.
  /// The first set-point is sent when the console has answered the last hold, or 1 s after the
  /// hold. Moves wait for this set-point.
  PsmStatus Arm() noexcept;
  /// Returns what Arm() would return, without arming.
  [[nodiscard]] PsmStatus Armable() const noexcept;
  /// Starts a move as PsmMotion::Start() does. Replaces a move in progress.
  PsmStatus MoveTo(const kinematics::PsmJoints& goal, double duration_s) noexcept;
  /// Turns the jaw to `angle`, rad, at constant speed, not before 0.15 s after the first set-point.
  /// Refused if the jaw's own set-point, at which the first move begins, is silent (kStateSilent)
  /// or its stamp is not valid now.
  PsmStatus MoveJaw(double angle, double duration_s) noexcept;
  /// Stops at the next step, with status kHeld unless it already holds. Always succeeds. A console
  /// that is enabling or homing is told to hold and to disable, because `hold` alone ends neither.
  void Hold() noexcept { hold_wanted_ = true; }

  [[nodiscard]] PsmPhase phase() const noexcept { return phase_; }
  /// In kHolding: the cause. Otherwise: the reason that prevents arming.
  [[nodiscard]] PsmStatus status() const noexcept;
  /// Returns the reason to hold that the last step found, also while holding; kOk: none.
  [[nodiscard]] PsmStatus hold_reason() const noexcept { return hold_reason_; }
  /// Returns the reason why the last step's measurements are not valid, also of an arm that is not
  /// ready: hold_reason() is then the state of the arm. kOk: they are valid.
  [[nodiscard]] PsmStatus MeasurementHoldReason() const noexcept;
  /// True while the console has been asked to power up or home and has not finished.
  [[nodiscard]] bool homing() const noexcept;
  /// Returns the state command in progress.
  [[nodiscard]] PsmRequest request() const noexcept { return request_; }
  /// True while a move, including the jaw's, is in progress.
  [[nodiscard]] bool moving() const noexcept { return motion_.moving() || jaw_moving_; }
  /// True if no move is in progress and the measured arm rests at its set-point.
  [[nodiscard]] bool at_rest() const noexcept { return at_rest_; }

  [[nodiscard]] const kinematics::PsmJoints& setpoint() const noexcept {
    return motion_.setpoint();
  }
  [[nodiscard]] const PsmMotion& motion() const noexcept { return motion_; }
  /// Return the newest samples, unchecked: see MeasurementHoldReason() before relying on them.
  [[nodiscard]] const PsmJointSample& measured_js() const noexcept { return js_; }
  [[nodiscard]] const PsmJointSample& setpoint_js() const noexcept { return setpoint_js_; }
  [[nodiscard]] const PsmPoseSample& measured_cp() const noexcept { return cp_; }
  /// Returns the arm's base in the frame of measured_cp and servo_cp, from the newest samples.
  [[nodiscard]] const Eigen::Isometry3d& base_frame() const noexcept { return base_now_; }
  [[nodiscard]] const PsmJawSample& jaw() const noexcept { return jaw_measured_; }
  [[nodiscard]] const PsmOperatingState& operating_state() const noexcept { return operating_; }
  /// Returns the number of samples of measured_js.
  [[nodiscard]] std::uint64_t num_samples() const noexcept { return num_samples_; }
  /// Returns the age of the newest stamp of measured_js, s; NaN before the first sample.
  [[nodiscard]] double age_s() const noexcept { return age_s_; }
  [[nodiscard]] const PsmClientOptions& options() const noexcept { return options_; }

 private:
  void Take(const PsmInput& input) noexcept;
  [[nodiscard]] PsmStatus FindHoldReason(const PsmInput& input) const noexcept;
  [[nodiscard]] PsmStatus CommandHoldReason(const PsmInput& input) const noexcept;
  [[nodiscard]] PsmStatus FollowHoldReason() const noexcept;
  [[nodiscard]] bool JawIsOurs() const noexcept;
  [[nodiscard]] PsmStatus JawHoldReason() const noexcept;
  [[nodiscard]] PsmStatus StampHoldReason(const dds::Watchdog& watchdog, const dds::Stamp& stamp,
                                          std::int64_t arrival_ns) const noexcept;
  [[nodiscard]] bool Discovering() const noexcept;
  [[nodiscard]] bool FrameAgrees() const noexcept;
  [[nodiscard]] bool BaseMoved() const noexcept;
  void Pair() noexcept;
  void HoldBecause(PsmStatus cause, PsmOutput& output) noexcept;
  [[nodiscard]] PsmStatus HomingHoldReason(const PsmInput& input, double dt) const noexcept;
  void Pursue(const PsmInput& input, double dt, PsmOutput& output) noexcept;

  PsmClientOptions options_;
  PsmMotion motion_;
  PsmRest rest_;
  PsmRecentSetpoints recent_;
  PsmRecentSetpoints recent_jaw_;  // the jaw's angle is the first entry
  PsmStatements statements_;
  dds::Watchdog js_watchdog_;
  dds::Watchdog cp_watchdog_;
  dds::Watchdog local_watchdog_;
  dds::Watchdog setpoint_watchdog_;
  dds::Watchdog jaw_watchdog_;

  PsmJointSample js_;
  PsmJointSample setpoint_js_;
  PsmPoseSample cp_;
  PsmPoseSample local_cp_;
  Eigen::Isometry3d base_now_ = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d base_ = Eigen::Isometry3d::Identity();  // base at the time of arming
  PsmJawSample jaw_measured_;
  PsmJawSample jaw_setpoint_;
  PsmOperatingState operating_;
  // The console's last set-point that agreed with our set-points.
  kinematics::PsmJoints agreed_ = kinematics::PsmJoints::Zero();
  std::int64_t js_arrival_ns_ = 0;
  std::int64_t cp_arrival_ns_ = 0;
  std::int64_t local_arrival_ns_ = 0;
  // Time of the poses that gave base_now_; at first long ago.
  std::int64_t paired_ns_ = std::numeric_limits<std::int64_t>::min() / 2;
  std::int64_t setpoint_arrival_ns_ = 0;
  std::int64_t jaw_arrival_ns_ = 0;
  std::uint64_t num_samples_ = 0;
  double age_s_;

  std::int64_t now_ns_ = 0;
  std::int64_t wall_ns_ = 0;
  std::int64_t restless_ns_ = 0;  // last time when the joints were at rest or in a move
  std::int64_t newcomer_ns_ = 0;
  std::int64_t since_ns_ = 0;  // time of the first set-point since arming
  std::int64_t request_start_ns_ = 0;
  std::int64_t request_sent_ns_ = 0;
  double jaw_ = 0.0;
  double jaw_goal_ = 0.0;
  double jaw_speed_ = 0.0;

  PsmPhase phase_ = PsmPhase::kIdle;
  PsmStatus cause_ = PsmStatus::kOk;
  PsmStatus hold_reason_ = PsmStatus::kNoConsole;
  PsmStatus lapse_ = PsmStatus::kOk;
  PsmRequest request_ = PsmRequest::kNone;
  bool stepped_ = false;
  bool any_js_ = false;
  bool any_cp_ = false;
  bool any_local_ = false;
  bool any_setpoint_ = false;
  bool any_jaw_setpoint_ = false;
  bool any_operating_ = false;
  bool any_newcomer_ = false;
  bool had_publisher_ = false;
  bool jumped_ = false;
  bool erred_ = false;
  bool switched_off_ = false;  // true if the last step found that the arm became DISABLED
  bool at_rest_ = false;
  bool hold_wanted_ = false;
  bool hold_first_ = false;
  bool request_sent_ = false;
  bool others_control_ = false;
  bool sends_ = false;  // true if set-points have been sent since arming
  bool jaw_ours_ = false;
  bool jaw_known_ = false;  // true if the jaw position at the time of arming is known
  bool jaw_moving_ = false;
};

}  // namespace dfr::hardware
