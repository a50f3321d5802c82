#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>

#include "dfr/dds/messages.h"
#include "dfr/dds/watchdog.h"
#include "dfr/hardware/psm_motion.h"
#include "dfr/hardware/psm_status.h"
#include "dfr/kinematics/psm.h"

namespace dfr::hardware {

/// Options for PsmClient.
struct PsmClientOptions {
  PsmLimits limits = {};
  PsmRestOptions rest = {};
  /// How far the arm may lag behind its set-point, rad (insertion: m), > 0.
  kinematics::PsmJoints max_lag =
      (kinematics::PsmJoints() << 0.09, 0.09, 0.01, 0.15, 0.15, 0.15).finished();
  /// How far the console's set-point may be from all that were sent in the last while, rad
  /// (insertion: m), > 0: what inverse kinematics and rounding make of them. Another client's
  /// set-points between these move it by 0.008 rad (insertion: 1 mm) within one step at most.
  kinematics::PsmJoints max_setpoint_error =
      (kinematics::PsmJoints() << 0.003, 0.003, 0.0003, 0.01, 0.01, 0.01).finished();
  double max_jaw_setpoint_error = 0.05;  ///< The same of the jaw, rad, > 0.
  /// Faster than this no sample follows another, rad/s (insertion: m/s), > 0: the console's own
  /// limits with a margin for noise.
  kinematics::PsmJoints jump_speed =
      (kinematics::PsmJoints() << 2.4, 2.4, 0.3, 2.4, 2.4, 2.4).finished();
  /// Beyond that, what noise may do, rad (insertion: m), >= 0.
  kinematics::PsmJoints jump_noise =
      (kinematics::PsmJoints() << 0.01, 0.01, 0.002, 0.02, 0.02, 0.02).finished();
  double jump_distance_m = 0.005;  ///< The same for measured_cp, which may move at 1 m/s, > 0.
  /// Watches measured_js, measured_cp and local/measured_cp, and setpoint_js for its silence.
  dds::WatchdogOptions watchdog = {};
  /// By how much a move goes on in one step at most, s, > 0: after a late one it takes longer
  /// instead of catching up in one leap.
  double longest_step_s = 0.005;
  double max_tick_gap_s = 0.1;   ///< From one step to the next while armed, > 0.
  double reach_timeout_s = 2.0;  ///< From a move's end to rest, > 0.
  /// How far local/measured_cp, or measured_cp where there is none, may be from where measured_js
  /// puts the wrist when arming, and how far the frame of measured_cp may move while armed, > 0.
  double max_frame_distance_m = 0.002;
  double max_frame_angle = 0.05;  ///< rad
  double enable_timeout_s = 10.0;
  double home_timeout_s = 90.0;
  /// Neither armed nor homed before everybody on the network has been found: so long after the last
  /// one that was, >= 0.
  double discovery_s = 0.5;
  double repeat_request_s = 2.0;  ///< A state command without any effect is sent again after that.
  PsmProfile profile = PsmProfile::kSmooth;
  /// Whether it is a reason to hold that others publish on the arm's command topics, tell it to
  /// hold or to be free, join the network while it is armed, or move its set-point.
  bool sole_commander = true;

  /// @throws std::invalid_argument naming the option that is out of range.
  void Check() const;
};

/// What a client does at the moment.
enum class PsmPhase {
  kIdle,       ///< Listens. Nothing is sent.
  kRequested,  ///< A state command (enable, home, ...) is under way.
  kArmed,      ///< Sends set-points.
  kHolding,    ///< Has stopped sending because of status(); only Arm() or a request goes on.
};

[[nodiscard]] const char* Name(PsmPhase phase) noexcept;

/// State commands of CRTK.
enum class PsmRequest { kNone, kEnable, kDisable, kPause, kResume, kHome, kUnhome };

/// As the console takes it: "enable", ...; empty for kNone.
[[nodiscard]] const char* Name(PsmRequest request) noexcept;

/// The states that CRTK has, by operating_state's words.
enum class PsmConsoleState { kUnknown, kDisabled, kEnabled, kPaused, kFault };

[[nodiscard]] const char* Name(PsmConsoleState state) noexcept;

/// measured_js or setpoint_js.
struct PsmJointSample {
  dds::Stamp stamp;
  bool well_formed = false;   ///< Six positions.
  bool has_velocity = false;  ///< Six velocities.
  kinematics::PsmJoints position = kinematics::PsmJoints::Zero();
  kinematics::PsmJoints velocity = kinematics::PsmJoints::Zero();
};

/// measured_cp or local/measured_cp.
struct PsmPoseSample {
  dds::Stamp stamp;
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

/// jaw/measured_js or jaw/setpoint_js.
struct PsmJawSample {
  dds::Stamp stamp;
  double angle = 0.0;
};

/// operating_state.
struct PsmOperatingState {
  PsmConsoleState state = PsmConsoleState::kUnknown;
  bool homed = false;
  bool busy = false;
  /// How many samples so far did not say ENABLED, homed and not busy, and what the last of these
  /// said: one that was replaced by another before the client looked is not overlooked.
  std::uint32_t lapses = 0;
  PsmStatus last_lapse = PsmStatus::kOk;
};

/// kOk if the arm is ENABLED, homed and not busy; else what it is.
[[nodiscard]] PsmStatus Readiness(const PsmOperatingState& state) noexcept;

/// What has come since the last step.
struct PsmInput {
  std::optional<PsmJointSample> measured_js;
  std::optional<PsmJointSample> setpoint_js;
  std::optional<PsmPoseSample> measured_cp;
  std::optional<PsmPoseSample> local_measured_cp;
  std::optional<PsmJawSample> jaw_measured;
  std::optional<PsmJawSample> jaw_setpoint;
  std::optional<PsmOperatingState> operating_state;
  int errors = 0;            ///< Texts on the console's topic error.
  int state_publishers = 0;  ///< Matched on measured_js.
  int incompatible = 0;      ///< Refused there because of their quality of service.
  int other_publishers = 0;  ///< On the command topics, besides us.
  int foreign_words = 0;     ///< What others said on hold, free and state_command.
  /// Participants that were found since the last step, and publishers on the topics of the two
  /// above: what they said before is not known.
  int newcomers = 0;
  int goals_reached = 0;        ///< The console ended moves, which are never ours.
  bool teleoperated = false;    ///< A teleoperation is enabled, or was since the last step.
  bool clutched = false;        ///< The same of the arm's clutch.
  bool wrong_tool = false;      ///< The console names an instrument that is not known here.
  int tool_changes = 0;         ///< The console named another instrument than before.
  int command_subscribers = 0;  ///< On state_command.
  bool send_failed = false;     ///< Something to send did not fit.
};

/// What is to be sent now.
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

/// A client of one PSM behind a da Vinci Research Kit console (CRTK), without the network: what it
/// makes of what the console says, and what it sends. Time is what the caller says it is.
///
/// Whatever is wrong ends in kHolding: the console is told to hold, nothing more is sent, and
/// status() keeps the first cause until Arm() is called anew. The console itself keeps the last
/// set-point for ever, so that silence holds as well.
///
/// On a cart with setup joints or an endoscope arm measured_cp is relative to the camera. What
/// local/measured_cp says at the same moment gives the arm's base in that frame; it is taken when
/// the arm is armed, and may not move until it holds.
///
/// After construction nothing here allocates, locks or throws. One object belongs to one thread at
/// a time.
class PsmClient {
 public:
  /// @throws std::invalid_argument as PsmClientOptions::Check().
  explicit PsmClient(const PsmClientOptions& options);

  /// Takes what has come, decides, and says what to send. To be called at 200 Hz or more.
  /// @param steady_ns  a clock that never goes back.
  /// @param wall_ns  since the epoch, as stamps are.
  PsmOutput Step(const PsmInput& input, std::int64_t steady_ns, std::int64_t wall_ns) noexcept;

  /// Asks for a state command with the next steps. An armed client holds first. Ends in kIdle, or
  /// in kHolding with kTimedOut, kConsoleFault, or what came between while the arm powered up or
  /// homed: then the console is told to disable, too. kPause, kDisable and kUnhome need no effect
  /// to wait for. In FAULT a console only takes kDisable and kUnhome: others are refused with
  /// kConsoleFault.
  PsmStatus Request(PsmRequest request) noexcept;

  /// Starts sending set-points, the console's own at first, if the last step found no reason
  /// against; else says the reason and changes nothing. After a fault this is the only way back.
  PsmStatus Arm() noexcept;
  /// What Arm() would return, without doing it.
  [[nodiscard]] PsmStatus Armable() const noexcept;
  /// See PsmMotion::Start(). Replaces a move under way, from the present set-point.
  PsmStatus MoveTo(const kinematics::PsmJoints& goal, double duration_s) noexcept;
  PsmStatus MoveTo(const Eigen::Isometry3d& goal, double duration_s) noexcept;
  /// Turns the jaw to `angle`, rad, at constant speed.
  PsmStatus MoveJaw(double angle, double duration_s) noexcept;
  /// Stops with the next step, with status kHeld unless it holds already. Always works: a console
  /// that was asked to enable or home is told to hold and to disable, for `hold` alone does not end
  /// either.
  void Hold() noexcept { hold_wanted_ = true; }

  [[nodiscard]] PsmPhase phase() const noexcept { return phase_; }
  /// In kHolding: why. Otherwise: what now keeps the arm from being armed.
  [[nodiscard]] PsmStatus status() const noexcept;
  /// What the last step found, also while holding.
  [[nodiscard]] PsmStatus hold_reason() const noexcept { return hold_reason_; }
  /// The console has been asked to power up or to home, and has not done so yet.
  [[nodiscard]] bool homing() const noexcept;
  /// The state command under way.
  [[nodiscard]] PsmRequest request() const noexcept { return request_; }
  /// A move, the jaw's included, is under way.
  [[nodiscard]] bool moving() const noexcept { return motion_.moving() || jaw_moving_; }
  /// No move is under way, and the arm has come to rest at its set-point by what it measures.
  [[nodiscard]] bool at_rest() const noexcept { return at_rest_; }

  [[nodiscard]] const kinematics::PsmJoints& setpoint() const noexcept {
    return motion_.setpoint();
  }
  [[nodiscard]] const PsmMotion& motion() const noexcept { return motion_; }
  /// The newest samples, as they came: see status() before relying on them.
  [[nodiscard]] const PsmJointSample& measured_js() const noexcept { return js_; }
  [[nodiscard]] const PsmJointSample& setpoint_js() const noexcept { return setpoint_js_; }
  [[nodiscard]] const PsmPoseSample& measured_cp() const noexcept { return cp_; }
  /// The arm's base in the frame of measured_cp and servo_cp, of the newest samples.
  [[nodiscard]] const Eigen::Isometry3d& base_frame() const noexcept { return base_now_; }
  [[nodiscard]] const PsmJawSample& jaw() const noexcept { return jaw_measured_; }
  [[nodiscard]] const PsmOperatingState& operating_state() const noexcept { return operating_; }
  /// Samples of measured_js so far.
  [[nodiscard]] std::uint64_t num_samples() const noexcept { return num_samples_; }
  /// By how much the newest stamp of measured_js lags behind the clock, s; NaN before the first.
  [[nodiscard]] double age_s() const noexcept { return age_s_; }
  [[nodiscard]] const PsmClientOptions& options() const noexcept { return options_; }

 private:
  void Take(const PsmInput& input) noexcept;
  [[nodiscard]] PsmStatus FindHoldReason(const PsmInput& input) const noexcept;
  [[nodiscard]] PsmStatus MeasurementHoldReason() const noexcept;
  [[nodiscard]] PsmStatus CommandHoldReason(const PsmInput& input) const noexcept;
  [[nodiscard]] PsmStatus FollowHoldReason() const noexcept;
  [[nodiscard]] bool JawIsOurs() const noexcept;
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
  PsmRecentSetpoints recent_jaw_;  // in the first place
  dds::Watchdog js_watchdog_;
  dds::Watchdog cp_watchdog_;
  dds::Watchdog local_watchdog_;

  PsmJointSample js_;
  PsmJointSample setpoint_js_;
  PsmPoseSample cp_;
  PsmPoseSample local_cp_;
  Eigen::Isometry3d base_now_ = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d base_ = Eigen::Isometry3d::Identity();  // when armed
  PsmJawSample jaw_measured_;
  PsmJawSample jaw_setpoint_;
  PsmOperatingState operating_;
  std::int64_t js_arrival_ns_ = 0;
  std::int64_t cp_arrival_ns_ = 0;
  std::int64_t local_arrival_ns_ = 0;
  std::int64_t setpoint_arrival_ns_ = 0;
  std::uint64_t num_samples_ = 0;
  double age_s_;

  std::int64_t now_ns_ = 0;
  std::int64_t wall_ns_ = 0;
  std::int64_t restless_ns_ = 0;  // since then the arm has not been at rest
  std::int64_t newcomer_ns_ = 0;
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
  bool paired_ = false;
  bool any_setpoint_ = false;
  bool any_jaw_setpoint_ = false;
  bool any_operating_ = false;
  bool any_newcomer_ = false;
  bool had_publisher_ = false;
  bool jumped_ = false;
  bool erred_ = false;
  bool at_rest_ = false;
  bool hold_wanted_ = false;
  bool hold_first_ = false;
  bool request_sent_ = false;
  bool jaw_ours_ = false;
  bool jaw_known_ = false;  // where it was when armed
  bool jaw_moving_ = false;
};

}  // namespace dfr::hardware
