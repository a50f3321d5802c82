#include "dfr/sim/dvrk/psm_console.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::sim {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

constexpr double kDegree = 0.017453292519943295;
constexpr double kJawSpeed = 90.0 * kDegree;
constexpr double kJawUpper = 80.0 * kDegree;

// Control spaces and modes, as named by sawIntuitiveResearchKit.
constexpr std::string_view kNoControl = "UNDEFINED_SPACE/UNDEFINED_MODE";
constexpr std::string_view kJointPosition = "JOINT_SPACE/POSITION_MODE";
constexpr std::string_view kJointTrajectory = "JOINT_SPACE/TRAJECTORY_MODE";
constexpr std::string_view kJointEffort = "JOINT_SPACE/EFFORT_MODE";
constexpr std::string_view kPoseEffort = "CARTESIAN_SPACE/EFFORT_MODE";
constexpr std::string_view kPosePosition = "CARTESIAN_SPACE/POSITION_MODE";
constexpr std::string_view kPoseTrajectory = "CARTESIAN_SPACE/TRAJECTORY_MODE";

constexpr std::array<const char*, 6> kJointNames = {"yaw",  "pitch",       "insertion",
                                                    "roll", "wrist pitch", "wrist yaw"};

PsmJoints Home() { return 0.12 * PsmJoints::Unit(2); }

// Returns the joints' speed limits, rad/s (insertion: m/s).
PsmJoints SpeedLimits() {
  PsmJoints limits = PsmJoints::Constant(90.0 * kDegree);
  limits[2] = 0.2;
  return limits;
}

// Rises from 0 to 1 with zero slope at both ends and a largest slope of 1.5.
double Smooth(double share) { return share * share * (3.0 - 2.0 * share); }

}  // namespace

const char* Name(ArmState state) noexcept {
  switch (state) {
    case ArmState::kDisabled:
      return "DISABLED";
    case ArmState::kEnabled:
      return "ENABLED";
    case ArmState::kPaused:
      return "PAUSED";
    case ArmState::kFault:
      return "FAULT";
  }
  return "UNKNOWN";
}

PsmConsole::PsmConsole(const PsmConsoleOptions& options)
    : options_(options),
      move_from_(PsmJoints::Zero()),
      goal_(PsmJoints::Zero()),
      setpoint_(PsmJoints::Zero()),
      measured_(PsmJoints::Zero()),
      velocity_(PsmJoints::Zero()) {
  DFR_THROW_UNLESS(!options.arm.empty(), "arm must have a name");
  DFR_THROW_UNLESS(options.homing_s >= 0.0 && options.homing_s < 1e3,
                   "homing_s must lie in [0, 1000)");
  DFR_THROW_UNLESS(options.lag_s > 0.0 && options.lag_s < 1e3, "lag_s must lie in (0, 1000)");
  const Eigen::Matrix3d& turn = options.base_frame.linear();
  DFR_THROW_UNLESS(
      options.base_frame.matrix().allFinite() && turn.isUnitary(1e-9) && turn.determinant() > 0.0,
      "base_frame must be a rotation and a translation");
}

void PsmConsole::Say(ConsoleMessage::Severity severity, const std::string& text) {
  messages_.push_back({severity, options_.arm + ": " + text});
}

void PsmConsole::Enter(ArmState state) {
  if (state == state_) return;
  state_ = state;
  Say(ConsoleMessage::Severity::kStatus, std::string("now ") + Name(state));
}

void PsmConsole::Control(std::string_view control) {
  if (control == control_) return;
  control_ = control;
  Say(ConsoleMessage::Severity::kStatus, "control " + std::string(control));
}

void PsmConsole::StopMoves() {
  if (moving_) goals_.push_back(false);
  if (jaw_moving_) goals_.push_back(false);
  moving_ = jaw_moving_ = false;
  goal_ = setpoint_;
  jaw_goal_ = jaw_setpoint_;
}

void PsmConsole::Fail(const std::string& reason) {
  homing_left_s_ = 0.0;
  StopMoves();
  Control(kNoControl);
  Say(ConsoleMessage::Severity::kError, reason);
  Enter(ArmState::kFault);
}

void PsmConsole::StateCommand(std::string_view command) {
  const bool disables = command == "disable" || command == "unhome";
  if (state_ == ArmState::kFault && !disables) {
    Say(ConsoleMessage::Severity::kWarning,
        "state command \"" + std::string(command) + "\" ignored in FAULT; disable first");
    return;
  }
  if (disables) {
    homing_left_s_ = 0.0;
    StopMoves();
    Control(kNoControl);
    if (command == "unhome") homed_ = false;
    Enter(ArmState::kDisabled);
  } else if (command == "enable") {
    if (state_ == ArmState::kDisabled) {
      Enter(ArmState::kEnabled);
    } else if (state_ == ArmState::kPaused || !homed_) {
      Say(ConsoleMessage::Severity::kWarning, "cannot enable: PAUSED, not homed, or homing");
    }
  } else if (command == "home") {
    if (homing_left_s_ > 0.0) return;
    Enter(ArmState::kEnabled);
    if (homed_) return;
    Control(kJointTrajectory);
    homing_left_s_ = std::max(options_.homing_s, 1e-9);
  } else if (command == "pause") {
    if (state_ != ArmState::kEnabled || homing_left_s_ > 0.0) {
      Say(ConsoleMessage::Severity::kWarning, "cannot pause: not ENABLED, or homing");
      return;
    }
    StopMoves();
    Control(kNoControl);
    Enter(ArmState::kPaused);
  } else if (command == "resume") {
    if (state_ != ArmState::kPaused) {
      Say(ConsoleMessage::Severity::kWarning, "cannot resume: not PAUSED");
      return;
    }
    Enter(ArmState::kEnabled);
  } else {
    Say(ConsoleMessage::Severity::kWarning,
        "unknown state command \"" + std::string(command) +
            "\"; known: enable, disable, pause, resume, home, unhome");
  }
}

bool PsmConsole::Ready(const char* command) {
  const char* reason = nullptr;
  if (state_ != ArmState::kEnabled) {
    reason = Name(state_);
  } else if (homing_left_s_ > 0.0) {
    reason = "homing";
  } else if (!homed_) {
    reason = "not homed";
  }
  if (reason == nullptr) return true;
  Say(ConsoleMessage::Severity::kWarning,
      std::string(command) + " dropped, arm not ready: " + reason);
  return false;
}

bool PsmConsole::Clip(const char* command, PsmJoints& goal) {
  if (!goal.allFinite()) {
    Say(ConsoleMessage::Severity::kError,
        std::string(command) + " dropped, the goal is not six finite joint values");
    return false;
  }
  std::ostringstream text;
  text << command << " clipped at the limits of";
  bool clipped = false;
  const PsmJoints lower = Psm::lower_limits(options_.generation);
  const PsmJoints upper = Psm::upper_limits(options_.generation);
  for (int i = 0; i < 6; ++i) {
    const double within = std::clamp(goal[i], lower[i], upper[i]);
    if (within == goal[i]) continue;
    clipped = true;
    text << ' ' << kJointNames[static_cast<std::size_t>(i)] << " (" << goal[i] << ')';
    goal[i] = within;
  }
  if (clipped && !clipped_) Say(ConsoleMessage::Severity::kWarning, text.str());
  clipped_ = clipped;
  return true;
}

bool PsmConsole::Reach(const char* command, const Eigen::Isometry3d& goal, PsmJoints& joints) {
  const kinematics::PsmReach reach =
      Psm::Inverse(options_.base_frame.inverse() * goal, joints, options_.generation);
  if (reach == kinematics::PsmReach::kOk) {
    clipped_ = false;
    return true;
  }
  if (reach == kinematics::PsmReach::kJointLimit) return Clip(command, joints);
  Say(ConsoleMessage::Severity::kError,
      std::string(command) + " dropped, inverse kinematics failed: " + Name(reach));
  return false;
}

bool PsmConsole::ClipJaw(const char* command, double& angle) {
  if (!std::isfinite(angle)) {
    Say(ConsoleMessage::Severity::kError,
        std::string(command) + " dropped, the goal is not one finite angle");
    return false;
  }
  const double lower =
      (options_.generation == kinematics::PsmGeneration::kSi ? -20.0 : -40.0) * kDegree;
  const double within = std::clamp(angle, lower, kJawUpper);
  if (within != angle && !jaw_clipped_) {
    Say(ConsoleMessage::Severity::kWarning, std::string(command) + " clipped at the jaw's limits");
  }
  jaw_clipped_ = within != angle;
  angle = within;
  return true;
}

void PsmConsole::StartMove(const PsmJoints& goal) {
  if (moving_) goals_.push_back(false);
  moving_ = true;
  ++moves_begun_;
  move_s_ = 0.0;
  move_from_ = setpoint_;
  goal_ = goal;
  move_duration_s_ = 1.5 / trajectory_ratio_ *
                     (goal - setpoint_).cwiseAbs().cwiseQuotient(SpeedLimits()).maxCoeff();
}

void PsmConsole::StartServo(const PsmJoints& goal) {
  if (moving_) goals_.push_back(false);
  moving_ = false;
  goal_ = goal;
}

void PsmConsole::ServoJoints(const char* command, PsmJoints joints) {
  if (!Ready(command)) return;
  Control(kJointPosition);
  if (Clip(command, joints)) StartServo(joints);
}

void PsmConsole::ServoPose(const char* command, const Eigen::Isometry3d& goal) {
  if (!Ready(command)) return;
  Control(kPosePosition);
  PsmJoints joints;
  if (Reach(command, goal, joints)) StartServo(joints);
}

void PsmConsole::ServoJp(const PsmJoints& goal) { ServoJoints("servo_jp", goal); }

void PsmConsole::ServoCp(const Eigen::Isometry3d& goal) { ServoPose("servo_cp", goal); }

void PsmConsole::ServoJr(const PsmJoints& difference) {
  ServoJoints("servo_jr", (moving_ ? setpoint_ : goal_) + difference);
}

void PsmConsole::ServoCr(const Eigen::Isometry3d& difference) {
  Eigen::Isometry3d goal = options_.base_frame * Psm::Forward(moving_ ? setpoint_ : goal_);
  goal.translation() += difference.translation();
  goal.linear() = difference.linear() * goal.linear();
  ServoPose("servo_cr", goal);
}

void PsmConsole::ServoEffort(const char* command) {
  if (!Ready(command)) return;
  Control(std::string_view(command) == "servo_jf" ? kJointEffort : kPoseEffort);
  StopMoves();
  Say(ConsoleMessage::Severity::kError,
      std::string(command) +
          " dropped, the simulated arm has no dynamics that an effort could move");
}

void PsmConsole::SetTrajectoryRatio(double ratio) {
  if (ratio > 0.0 && ratio <= 1.0) {
    trajectory_ratio_ = ratio;
    return;
  }
  std::ostringstream text;
  text << "trajectory_j/set_ratio is ignored: the ratio must lie in (0, 1], not " << ratio;
  Say(ConsoleMessage::Severity::kWarning, text.str());
}

void PsmConsole::MoveJoints(const char* command, PsmJoints joints) {
  if (!Ready(command)) return;
  Control(kJointTrajectory);
  if (Clip(command, joints)) StartMove(joints);
}

void PsmConsole::MoveJr(const PsmJoints& difference) {
  MoveJoints("move_jr", (moving_ ? goal_ : setpoint_) + difference);
}

void PsmConsole::MoveJp(const PsmJoints& goal) { MoveJoints("move_jp", goal); }

void PsmConsole::MoveCp(const Eigen::Isometry3d& goal) {
  if (!Ready("move_cp")) return;
  Control(kPoseTrajectory);
  PsmJoints joints;
  if (Reach("move_cp", goal, joints)) {
    StartMove(joints);
  } else {
    goals_.push_back(false);
  }
}

// The jaw does not change the arm's control space.
void PsmConsole::ControlJaw(std::string_view in_pose_space, std::string_view in_joint_space) {
  Control(control_ == kPosePosition || control_ == kPoseTrajectory ? in_pose_space
                                                                   : in_joint_space);
}

void PsmConsole::ServoJaw(double angle) {
  if (!Ready("jaw/servo_jp") || !ClipJaw("jaw/servo_jp", angle)) return;
  ControlJaw(kPosePosition, kJointPosition);
  if (jaw_moving_) goals_.push_back(false);
  jaw_moving_ = false;
  jaw_goal_ = angle;
}

void PsmConsole::MoveJaw(double angle) {
  if (!Ready("jaw/move_jp") || !ClipJaw("jaw/move_jp", angle)) return;
  ControlJaw(kPoseTrajectory, kJointTrajectory);
  if (jaw_moving_) goals_.push_back(false);
  jaw_moving_ = true;
  ++moves_begun_;
  jaw_goal_ = angle;
}

void PsmConsole::Hold() {
  if (!Ready("hold")) return;
  Control(kJointPosition);
  StopMoves();
}

void PsmConsole::Free() {
  if (!Ready("free")) return;
  Control(kJointEffort);
  StopMoves();
  goal_ = setpoint_ = measured_;
  jaw_goal_ = jaw_setpoint_ = jaw_;
}

void PsmConsole::Place(const PsmJoints& joints) {
  DFR_THROW_UNLESS(Psm::WithinLimits(joints, options_.generation),
                   "joints must lie within the arm's limits");
  homing_left_s_ = 0.0;
  StopMoves();
  goal_ = setpoint_ = joints;
  homed_ = true;
  Settle();
  Enter(ArmState::kEnabled);
}

void PsmConsole::Settle() {
  if (moving_) goals_.push_back(true);
  if (jaw_moving_) goals_.push_back(true);
  moving_ = jaw_moving_ = false;
  measured_ = setpoint_ = goal_;
  jaw_ = jaw_setpoint_ = jaw_goal_;
  velocity_.setZero();
}

void PsmConsole::Step(double dt_s) {
  if (homing_left_s_ > 0.0) {
    homing_left_s_ -= dt_s;
    if (homing_left_s_ > 0.0) return;
    homing_left_s_ = 0.0;
    homed_ = true;
    goal_ = setpoint_ = measured_ = Home();
    jaw_goal_ = jaw_setpoint_ = jaw_ = 0.0;
    velocity_.setZero();
    Control(kNoControl);
    Say(ConsoleMessage::Severity::kStatus, "homed");
    return;
  }
  if (!homed_) return;
  // Maximum motion of each joint's set-point towards its goal in this step.
  const PsmJoints largest = dt_s * SpeedLimits();
  if (moving_) {
    move_s_ += dt_s;
    const bool done = move_s_ >= move_duration_s_;
    setpoint_ =
        done ? goal_
             : PsmJoints(move_from_ + Smooth(move_s_ / move_duration_s_) * (goal_ - move_from_));
    if (done) {
      moving_ = false;
      goals_.push_back(true);
    }
  } else {
    for (int i = 0; i < 6; ++i) {
      const double left = goal_[i] - setpoint_[i];
      // Sets the final value exactly; adding the difference may round.
      setpoint_[i] = std::abs(left) <= largest[i]
                         ? goal_[i]
                         : setpoint_[i] + std::clamp(left, -largest[i], largest[i]);
    }
  }
  const double jaw_largest = dt_s * kJawSpeed;
  jaw_setpoint_ += std::clamp(jaw_goal_ - jaw_setpoint_, -jaw_largest, jaw_largest);
  if (jaw_moving_ && jaw_setpoint_ == jaw_goal_) {
    jaw_moving_ = false;
    goals_.push_back(true);
  }
  const double share = 1.0 - std::exp(-dt_s / options_.lag_s);
  const PsmJoints before = measured_;
  measured_ += share * (setpoint_ - measured_);
  jaw_ += share * (jaw_setpoint_ - jaw_);
  if (dt_s > 0.0) velocity_ = (measured_ - before) / dt_s;
}

const char* PsmConsole::tool() const noexcept {
  return options_.generation == kinematics::PsmGeneration::kSi ? "LARGE_NEEDLE_DRIVER:420006[1]"
                                                               : "LARGE_NEEDLE_DRIVER:400006";
}

Eigen::Isometry3d PsmConsole::measured_pose() const noexcept {
  return options_.base_frame * Psm::Forward(measured_);
}
Eigen::Isometry3d PsmConsole::setpoint_pose() const noexcept {
  return options_.base_frame * Psm::Forward(setpoint_);
}
Eigen::Matrix<double, 6, 1> PsmConsole::measured_twist() const noexcept {
  Eigen::Matrix<double, 6, 1> twist = Psm::Twist(measured_, velocity_);
  for (const Eigen::Index part : {0, 3}) {
    twist.segment<3>(part) = options_.base_frame.linear() * twist.segment<3>(part);
  }
  return twist;
}

std::vector<ConsoleMessage> PsmConsole::TakeMessages() { return std::exchange(messages_, {}); }
std::vector<bool> PsmConsole::TakeGoals() { return std::exchange(goals_, {}); }

}  // namespace dfr::sim
