#include "dfr/sim/dvrk/psm_console_server.h"

#include <deque>
#include <limits>
#include <string>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/dds/channel.h"

namespace dfr::sim {
namespace {

using kinematics::PsmJoints;

const std::vector<std::string>& JointNames() {
  static const std::vector<std::string> kNames = {"yaw",  "pitch",       "insertion",
                                                  "roll", "wrist_pitch", "wrist_yaw"};
  return kNames;
}

// All that is published about motion at one moment.
struct Snapshot {
  double time_s = 0.0;
  dds::JointState measured_js;
  dds::JointState setpoint_js;
  dds::PoseStamped measured_cp;
  dds::PoseStamped setpoint_cp;
  dds::JointState jaw_measured_js;
  dds::JointState jaw_setpoint_js;
};

dds::JointState Joints(const dds::Stamp& stamp, const PsmJoints& position) {
  dds::JointState message;
  message.stamp = stamp;
  message.name = JointNames();
  message.position.assign(position.data(), position.data() + position.size());
  return message;
}

dds::JointState Jaw(const dds::Stamp& stamp, double angle) {
  dds::JointState message;
  message.stamp = stamp;
  message.name = {"jaw"};
  message.position = {angle};
  return message;
}

dds::PoseStamped Pose(const dds::Stamp& stamp, const std::string& frame,
                      const Eigen::Isometry3d& pose) {
  dds::PoseStamped message;
  message.stamp = stamp;
  message.frame_id = frame;
  message.position_m = pose.translation();
  message.orientation = Eigen::Quaterniond(pose.linear());
  return message;
}

Eigen::Isometry3d Transform(const dds::PoseStamped& message) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = message.position_m;
  // A quaternion of zeros becomes NaN here, which the console refuses.
  pose.linear() = Eigen::Quaterniond(message.orientation.coeffs() / message.orientation.norm())
                      .toRotationMatrix();
  return pose;
}

// Joint values of another number are no goal.
PsmJoints JointGoal(const dds::JointState& message) {
  if (message.position.size() != 6) {
    return PsmJoints::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  return Eigen::Map<const PsmJoints>(message.position.data());
}

double JawGoal(const dds::JointState& message) {
  return message.position.size() == 1 ? message.position[0]
                                      : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

struct PsmConsoleServer::Impl {
  Impl(dds::Participant& participant, PsmConsole& served, const PsmConsoleServerOptions& chosen)
      : console(served), options(chosen), random(chosen.seed), p(participant) {}

  [[nodiscard]] std::string Topic(const char* name) const {
    return "/" + console.options().arm + "/" + name;
  }

  void TakeCommands() {
    dds::StringStamped command;
    while (state_command.Take(command)) console.StateCommand(command.text);
    dds::Signal signal;
    while (hold.Take(signal)) console.Hold();
    dds::PoseStamped pose;
    while (move_cp.Take(pose)) console.MoveCp(Transform(pose));
    while (servo_cp.Take(pose)) console.ServoCp(Transform(pose));
    dds::JointState joints;
    while (move_jp.Take(joints)) console.MoveJp(JointGoal(joints));
    while (servo_jp.Take(joints)) console.ServoJp(JointGoal(joints));
    while (jaw_move_jp.Take(joints)) console.MoveJaw(JawGoal(joints));
    while (jaw_servo_jp.Take(joints)) console.ServoJaw(JawGoal(joints));
  }

  void Remember() {
    const dds::Stamp stamp = console.valid() && !faults.invalid ? dds::Stamp::Now() : dds::Stamp{};
    const std::string frame = console.options().arm + "_base";
    Snapshot now;
    now.time_s = time_s;
    now.measured_js = Joints(stamp, console.measured_joints());
    const PsmJoints& velocity = console.joint_velocity();
    now.measured_js.velocity.assign(velocity.data(), velocity.data() + velocity.size());
    now.setpoint_js = Joints(stamp, console.setpoint_joints());
    now.measured_cp = Pose(stamp, frame, console.measured_pose());
    now.setpoint_cp = Pose(stamp, frame, console.setpoint_pose());
    now.jaw_measured_js = Jaw(stamp, console.measured_jaw());
    now.jaw_setpoint_js = Jaw(stamp, console.setpoint_jaw());
    if (faults.corrupt) {
      constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
      now.measured_js.position.assign(6, kNan);
      now.measured_cp.position_m.setConstant(kNan);
    }
    past.push_back(now);
    while (past.size() > 1 && past[1].time_s <= time_s - faults.delay_s) past.pop_front();
  }

  template <typename T>
  void Send(dds::Publisher<T>& publisher, const T& message) {
    if (random.Uniform() >= faults.drop) publisher.Write(message);
  }

  void PublishMotion() {
    if (!faults.freeze || past.empty()) Remember();
    if (faults.silent) return;
    const Snapshot& shown = past.front();
    Send(measured_js, shown.measured_js);
    Send(setpoint_js, shown.setpoint_js);
    Send(measured_cp, shown.measured_cp);
    Send(setpoint_cp, shown.setpoint_cp);
    Send(jaw_measured_js, shown.jaw_measured_js);
    Send(jaw_setpoint_js, shown.jaw_setpoint_js);
  }

  void PublishEvents() {
    for (const ConsoleMessage& message : console.TakeMessages()) {
      switch (message.severity) {
        case ConsoleMessage::Severity::kError:
          error.Write({message.text});
          break;
        case ConsoleMessage::Severity::kWarning:
          warning.Write({message.text});
          break;
        case ConsoleMessage::Severity::kStatus:
          status.Write({message.text});
          break;
      }
    }
    for (const bool reached : console.TakeGoals()) goal_reached.Write({reached});
    dds::OperatingState state;
    state.state = Name(console.state());
    state.is_homed = console.homed();
    state.is_busy = console.busy();
    const bool changed = state.state != last_state.state || state.is_homed != last_state.is_homed ||
                         state.is_busy != last_state.is_busy;
    if (!changed && time_s < next_state_s) return;
    next_state_s = time_s + 1.0;
    state.stamp = dds::Stamp::Now();
    last_state = state;
    operating_state.Write(state);
  }

  PsmConsole& console;
  PsmConsoleServerOptions options;
  ConsoleFaults faults;
  core::Random random;
  dds::Participant& p;
  double time_s = 0.0;
  double next_motion_s = 0.0;
  double next_state_s = 0.0;
  dds::OperatingState last_state;
  std::deque<Snapshot> past;

  dds::Subscriber<dds::StringStamped> state_command{p, Topic("state_command"), dds::Role::kRequest};
  dds::Subscriber<dds::PoseStamped> servo_cp{p, Topic("servo_cp"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> servo_jp{p, Topic("servo_jp"), dds::Role::kCommand};
  dds::Subscriber<dds::PoseStamped> move_cp{p, Topic("move_cp"), dds::Role::kRequest};
  dds::Subscriber<dds::JointState> move_jp{p, Topic("move_jp"), dds::Role::kRequest};
  dds::Subscriber<dds::Signal> hold{p, Topic("hold"), dds::Role::kRequest};
  dds::Subscriber<dds::JointState> jaw_servo_jp{p, Topic("jaw/servo_jp"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> jaw_move_jp{p, Topic("jaw/move_jp"), dds::Role::kRequest};

  dds::Publisher<dds::JointState> measured_js{p, Topic("measured_js"), dds::Role::kState};
  dds::Publisher<dds::JointState> setpoint_js{p, Topic("setpoint_js"), dds::Role::kState};
  dds::Publisher<dds::PoseStamped> measured_cp{p, Topic("measured_cp"), dds::Role::kState};
  dds::Publisher<dds::PoseStamped> setpoint_cp{p, Topic("setpoint_cp"), dds::Role::kState};
  dds::Publisher<dds::JointState> jaw_measured_js{p, Topic("jaw/measured_js"), dds::Role::kState};
  dds::Publisher<dds::JointState> jaw_setpoint_js{p, Topic("jaw/setpoint_js"), dds::Role::kState};
  dds::Publisher<dds::OperatingState> operating_state{p, Topic("operating_state"),
                                                      dds::Role::kEvent};
  dds::Publisher<dds::Flag> goal_reached{p, Topic("goal_reached"), dds::Role::kState};
  dds::Publisher<dds::Text> error{p, Topic("error"), dds::Role::kEvent};
  dds::Publisher<dds::Text> warning{p, Topic("warning"), dds::Role::kEvent};
  dds::Publisher<dds::Text> status{p, Topic("status"), dds::Role::kEvent};
};

PsmConsoleServer::PsmConsoleServer(dds::Participant& participant, PsmConsole& console,
                                   const PsmConsoleServerOptions& options) {
  DFR_THROW_UNLESS(options.state_period_s > 0.0, "state_period_s must be positive");
  impl_ = std::make_unique<Impl>(participant, console, options);
}

PsmConsoleServer::~PsmConsoleServer() = default;

void PsmConsoleServer::Tick(double dt_s) {
  impl_->TakeCommands();
  impl_->console.Step(dt_s);
  impl_->time_s += dt_s;
  if (impl_->time_s >= impl_->next_motion_s) {
    impl_->next_motion_s += impl_->options.state_period_s;
    // After a long pause, go on from here instead of catching up.
    if (impl_->next_motion_s < impl_->time_s) impl_->next_motion_s = impl_->time_s;
    impl_->PublishMotion();
  }
  impl_->PublishEvents();
}

void PsmConsoleServer::SetFaults(const ConsoleFaults& faults) {
  DFR_THROW_UNLESS(faults.delay_s >= 0.0 && faults.delay_s <= 2.0, "delay_s must lie in [0, 2]");
  DFR_THROW_UNLESS(faults.drop >= 0.0 && faults.drop <= 1.0, "drop must lie in [0, 1]");
  impl_->faults = faults;
}

const ConsoleFaults& PsmConsoleServer::faults() const noexcept { return impl_->faults; }

}  // namespace dfr::sim
