#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/kinematics/psm.h"

namespace dfr::sim {

/// The states of an arm as CRTK names them.
enum class ArmState { kDisabled, kEnabled, kPaused, kFault };

/// "DISABLED", "ENABLED", "PAUSED", "FAULT": what operating_state says.
[[nodiscard]] const char* Name(ArmState state) noexcept;

/// Something that the console says: on its topic error, warning or status.
struct ConsoleMessage {
  enum class Severity { kError, kWarning, kStatus };
  Severity severity = Severity::kStatus;
  std::string text;
};

/// Options for PsmConsole.
struct PsmConsoleOptions {
  std::string arm = "PSM1";
  double homing_s = 2.0;  ///< How long homing takes, >= 0.
  double lag_s = 0.02;    ///< Time constant of the joints behind their set-points, > 0.
  /// What the encoders do not show: the tip is where this puts it.
  kinematics::PsmCorrection joint_error = {};
  /// The arm's base in the frame that poses are relative to, the camera's on a cart with setup
  /// joints and an endoscope arm, and that frame's name; empty: the arm's own base.
  Eigen::Isometry3d base_frame = Eigen::Isometry3d::Identity();
  std::string base_frame_name = {};
  /// Whose limits goals are clipped at, and whose Large Needle Driver tool_type names.
  kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic;
};

/// A patient-side manipulator behind a da Vinci Research Kit console, as its clients see it: the
/// operating state and what it accepts when, the motion, and the words that the console finds.
/// Without a network and without a clock: Step() is its time, so that it runs in lock-step as well.
///
/// State commands: "enable", "disable", "pause", "resume", "home", "unhome". Homing enables, takes
/// homing_s and ends with the instrument inserted by 0.12 m, all other joints zero. In FAULT only
/// disable and unhome are taken. Motion commands are dropped with a warning unless the arm is
/// ENABLED, homed and done with homing. Goals beyond a joint's limits are clipped at them, as a
/// console does, which the first of several says with a warning; so the arm does not go where it
/// was sent. Goals that are not finite, and poses without joint values, are dropped with an error.
///
/// servo_* sets the set-point, which the joints approach no faster than 90 degrees/s and 0.2 m/s.
/// move_* interpolates in joint space, so that the tip's way is not straight, at that speed times
/// the trajectory's ratio, and reports the goal.
/// *_jr and *_cr are relative to the last goal of the same kind, or where there is none to the
/// set-point. The last goal is held for ever: there is no timeout for commands, as on a real
/// console. The simulated arm has no dynamics: free leaves it where it is, servo_jf is dropped with
/// an error.
///
/// Until the arm is homed nothing it measures is valid. One object belongs to one thread at a time.
class PsmConsole {
 public:
  /// @throws std::invalid_argument naming the option that is out of range.
  explicit PsmConsole(const PsmConsoleOptions& options);

  void StateCommand(std::string_view command);
  /// Poses are in the frame of options().base_frame_name.
  void ServoCp(const Eigen::Isometry3d& goal);
  void ServoJp(const kinematics::PsmJoints& goal);
  /// The translation is added, the rotation goes before the present one. (The real console's own
  /// servo_cr is marked as not working.)
  void ServoCr(const Eigen::Isometry3d& difference);
  void ServoJr(const kinematics::PsmJoints& difference);
  /// An effort of any kind, by its name.
  void ServoEffort(const char* command);
  /// The share of the speed limits that moves use, in ]0, 1]; others are ignored with a warning.
  void SetTrajectoryRatio(double ratio);
  void MoveCp(const Eigen::Isometry3d& goal);
  void MoveJp(const kinematics::PsmJoints& goal);
  void MoveJr(const kinematics::PsmJoints& difference);
  /// The jaw's angle, rad, clipped to [-40, 80] degrees, on an Si arm to [-20, 80].
  void ServoJaw(double angle);
  void MoveJaw(double angle);
  /// Stops where the set-point is.
  void Hold();
  /// Gives up the goal: the set-point becomes what is measured.
  void Free();
  /// The arm fails: FAULT, at rest, `reason` on the topic error.
  void Fail(const std::string& reason);

  /// For a simulation: homed, ENABLED and at rest there, whatever was before.
  /// @throws std::invalid_argument if a joint is beyond its limits.
  void Place(const kinematics::PsmJoints& joints);
  /// For a simulation: everything that was asked for is done and at rest, as if there had been time
  /// for it.
  void Settle();

  /// Time goes on. @pre dt_s >= 0, at most 0.1
  void Step(double dt_s);

  [[nodiscard]] const PsmConsoleOptions& options() const noexcept { return options_; }
  /// What tool_type says.
  [[nodiscard]] const char* tool() const noexcept;
  [[nodiscard]] ArmState state() const noexcept { return state_; }
  [[nodiscard]] bool homed() const noexcept { return homed_; }
  /// Homing, or a move, is under way.
  [[nodiscard]] bool busy() const noexcept {
    return homing_left_s_ > 0.0 || moving_ || jaw_moving_;
  }
  /// Whether what follows means anything.
  [[nodiscard]] bool valid() const noexcept { return homed_; }
  [[nodiscard]] const kinematics::PsmJoints& measured_joints() const noexcept { return measured_; }
  [[nodiscard]] const kinematics::PsmJoints& joint_velocity() const noexcept { return velocity_; }
  [[nodiscard]] const kinematics::PsmJoints& setpoint_joints() const noexcept { return setpoint_; }
  [[nodiscard]] double measured_jaw() const noexcept { return jaw_; }
  [[nodiscard]] double setpoint_jaw() const noexcept { return jaw_setpoint_; }
  /// Pose of the wrist in the frame of options().base_frame_name, by the encoders and as commanded.
  [[nodiscard]] Eigen::Isometry3d measured_pose() const noexcept;
  [[nodiscard]] Eigen::Isometry3d setpoint_pose() const noexcept;
  /// Twist of the wrist in the same frame, by the encoders: m/s, then rad/s.
  [[nodiscard]] Eigen::Matrix<double, 6, 1> measured_twist() const noexcept;
  [[nodiscard]] double trajectory_ratio() const noexcept { return trajectory_ratio_; }
  /// Moves begun since the start, the jaw's included.
  [[nodiscard]] int moves_begun() const noexcept { return moves_begun_; }
  /// Where the joints really are.
  [[nodiscard]] kinematics::PsmJoints true_joints() const noexcept;

  /// What the console has said since the last call.
  [[nodiscard]] std::vector<ConsoleMessage> TakeMessages();
  /// How the moves that ended since the last call ended: true at their goals, false on the way.
  [[nodiscard]] std::vector<bool> TakeGoals();

 private:
  [[nodiscard]] bool Ready(const char* command);
  [[nodiscard]] bool Reach(const char* command, const Eigen::Isometry3d& goal,
                           kinematics::PsmJoints& joints);
  [[nodiscard]] bool Clip(const char* command, kinematics::PsmJoints& goal);
  [[nodiscard]] bool ClipJaw(const char* command, double& angle);
  void Say(ConsoleMessage::Severity severity, const std::string& text);
  void Enter(ArmState state);
  void StartMove(const kinematics::PsmJoints& goal);
  void StartServo(const kinematics::PsmJoints& goal);
  void StopMoves();

  PsmConsoleOptions options_;
  ArmState state_ = ArmState::kDisabled;
  bool homed_ = false;
  double homing_left_s_ = 0.0;
  bool moving_ = false;
  bool jaw_moving_ = false;
  bool clipped_ = false;
  bool jaw_clipped_ = false;
  int moves_begun_ = 0;
  double trajectory_ratio_ = 1.0;
  double move_s_ = 0.0;
  double move_duration_s_ = 0.0;
  kinematics::PsmJoints move_from_;
  kinematics::PsmJoints goal_;
  kinematics::PsmJoints setpoint_;
  kinematics::PsmJoints measured_;
  kinematics::PsmJoints velocity_;
  double jaw_goal_ = 0.0;
  double jaw_setpoint_ = 0.0;
  double jaw_ = 0.0;
  std::vector<ConsoleMessage> messages_;
  std::vector<bool> goals_;
};

}  // namespace dfr::sim
