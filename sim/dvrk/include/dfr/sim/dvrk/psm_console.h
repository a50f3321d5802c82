#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/kinematics/psm.h"

namespace dfr::sim {

/// Operating states of an arm, with CRTK's names.
enum class ArmState { kDisabled, kEnabled, kPaused, kFault };

/// Returns "DISABLED", "ENABLED", "PAUSED" or "FAULT", the values of operating_state.
[[nodiscard]] const char* Name(ArmState state) noexcept;

/// A message on the console's topic error, warning or status.
struct ConsoleMessage {
  enum class Severity { kError, kWarning, kStatus };
  Severity severity = Severity::kStatus;
  std::string text;
};

/// Options for PsmConsole.
struct PsmConsoleOptions {
  std::string arm = "PSM1";
  double homing_s = 2.0;  ///< Duration of homing, >= 0.
  double lag_s = 0.02;    ///< Time constant of the joints relative to their set-points, > 0.
  /// Pose of the arm's base in the frame of all poses, and the name of this frame, for example the
  /// camera's. Empty name: the arm's own base frame.
  Eigen::Isometry3d base_frame = Eigen::Isometry3d::Identity();
  std::string base_frame_name = {};
  /// Determines the joint limits, and the Large Needle Driver that tool_type names.
  kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic;
};

/// Model of a patient-side manipulator behind a da Vinci Research Kit console, as its clients see
/// it: operating state, accepted commands, motion, and messages. Uses no network and no clock:
/// Step() advances the time, which allows lock-step.
///
/// State commands: "enable", "disable", "pause", "resume", "home", "unhome". Homing enables the
/// arm, takes homing_s and ends with the instrument inserted by 0.12 m and all other joints at
/// zero. FAULT accepts only disable and unhome. The console drops motion commands with a warning
/// unless the arm is ENABLED, homed and not homing. As on a console, goals beyond a joint's limits
/// are clipped, so the arm does not reach them. Only the first of several consecutive clipped goals
/// gives a warning. Goals that are not finite, and poses without an inverse kinematics solution,
/// are dropped with an error.
///
/// servo_* sets the goal. The set-point approaches it at up to 90 degrees/s and 0.2 m/s. move_*
/// interpolates in joint space at up to these speeds times the trajectory's ratio, and reports the
/// goal; the tip's path is not straight. *_jr and *_cr are relative to the last goal of the same
/// kind or, if there is none, to the set-point. The arm holds the last goal forever: commands have
/// no timeout, as on a real console. The simulated arm has no dynamics: free does not move it, and
/// effort commands are dropped with an error.
///
/// Measurements are invalid until the arm is homed. Each object belongs to one thread at a time.
class PsmConsole {
 public:
  /// @throws std::invalid_argument naming the option out of range.
  explicit PsmConsole(const PsmConsoleOptions& options);

  void StateCommand(std::string_view command);
  /// Poses are in the frame options().base_frame_name.
  void ServoCp(const Eigen::Isometry3d& goal);
  void ServoJp(const kinematics::PsmJoints& goal);
  /// Adds the translation, and multiplies the rotation from the left. (The real console's servo_cr
  /// is marked as not working.)
  void ServoCr(const Eigen::Isometry3d& difference);
  void ServoJr(const kinematics::PsmJoints& difference);
  /// Handles an effort command of any kind, given its name. The command takes control of the arm,
  /// but moves nothing.
  void ServoEffort(const char* command);
  /// Sets the fraction of the speed limits for moves, in (0, 1]. Ignores other values with a
  /// warning.
  void SetTrajectoryRatio(double ratio);
  void MoveCp(const Eigen::Isometry3d& goal);
  void MoveJp(const kinematics::PsmJoints& goal);
  void MoveJr(const kinematics::PsmJoints& difference);
  /// Sets the jaw's angle, rad, clipped to [-40, 80] degrees ([-20, 80] degrees on an Si arm).
  void ServoJaw(double angle);
  void MoveJaw(double angle);
  /// Stops at the set-point.
  void Hold();
  /// Abandons the goal: the set-point becomes the measured position.
  void Free();
  /// Puts the arm into FAULT, at rest, and reports `reason` on the topic error.
  void Fail(const std::string& reason);

  /// For simulations: places the arm at `joints`, homed, ENABLED and at rest, from any state.
  /// @throws std::invalid_argument if a joint is beyond its limits.
  void Place(const kinematics::PsmJoints& joints);
  /// For simulations: completes all commands at once and brings the arm to rest.
  void Settle();

  /// Advances the time. @pre dt_s >= 0, at most 0.1
  void Step(double dt_s);

  [[nodiscard]] const PsmConsoleOptions& options() const noexcept { return options_; }
  /// Returns the value of tool_type.
  [[nodiscard]] const char* tool() const noexcept;
  [[nodiscard]] ArmState state() const noexcept { return state_; }
  [[nodiscard]] bool homed() const noexcept { return homed_; }
  /// Returns true while homing or a move is in progress.
  [[nodiscard]] bool busy() const noexcept {
    return homing_left_s_ > 0.0 || moving_ || jaw_moving_;
  }
  /// Returns true if the following measurements are valid.
  [[nodiscard]] bool valid() const noexcept { return homed_; }
  [[nodiscard]] const kinematics::PsmJoints& measured_joints() const noexcept { return measured_; }
  [[nodiscard]] const kinematics::PsmJoints& joint_velocity() const noexcept { return velocity_; }
  [[nodiscard]] const kinematics::PsmJoints& setpoint_joints() const noexcept { return setpoint_; }
  [[nodiscard]] double measured_jaw() const noexcept { return jaw_; }
  [[nodiscard]] double setpoint_jaw() const noexcept { return jaw_setpoint_; }
  /// Poses of the wrist in the frame options().base_frame_name, from the encoders and as commanded.
  [[nodiscard]] Eigen::Isometry3d measured_pose() const noexcept;
  [[nodiscard]] Eigen::Isometry3d setpoint_pose() const noexcept;
  /// Twist of the wrist in the same frame, from the encoders: m/s, then rad/s.
  [[nodiscard]] Eigen::Matrix<double, 6, 1> measured_twist() const noexcept;
  [[nodiscard]] double trajectory_ratio() const noexcept { return trajectory_ratio_; }
  /// Number of moves since the start, including the jaw's.
  [[nodiscard]] int moves_begun() const noexcept { return moves_begun_; }

  /// Returns the console's messages since the last call.
  [[nodiscard]] std::vector<ConsoleMessage> TakeMessages();
  /// Returns the results of the moves that ended since the last call: true if the move reached its
  /// goal.
  [[nodiscard]] std::vector<bool> TakeGoals();

 private:
  [[nodiscard]] bool Ready(const char* command);
  [[nodiscard]] bool Reach(const char* command, const Eigen::Isometry3d& goal,
                           kinematics::PsmJoints& joints);
  [[nodiscard]] bool Clip(const char* command, kinematics::PsmJoints& goal);
  [[nodiscard]] bool ClipJaw(const char* command, double& angle);
  void Say(ConsoleMessage::Severity severity, const std::string& text);
  void Enter(ArmState state);
  void Control(std::string_view control);
  void ControlJaw(std::string_view in_pose_space, std::string_view in_joint_space);
  void StartMove(const kinematics::PsmJoints& goal);
  void StartServo(const kinematics::PsmJoints& goal);
  void ServoJoints(const char* command, kinematics::PsmJoints joints);
  void ServoPose(const char* command, const Eigen::Isometry3d& goal);
  void MoveJoints(const char* command, kinematics::PsmJoints joints);
  void StopMoves();

  PsmConsoleOptions options_;
  ArmState state_ = ArmState::kDisabled;
  std::string_view control_ = "UNDEFINED_SPACE/UNDEFINED_MODE";
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
