#include "dfr/sim/dvrk/psm_console_server.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/text/numbers.h"
#include "dfr/dds/channel.h"
#include "psm_messages.h"

namespace dfr::sim {
namespace {

using internal::ByRows;
using internal::Jacobians;
using internal::Jaw;
using internal::JawGoal;
using internal::JointGoal;
using internal::Joints;
using internal::Pose;
using internal::Snapshot;
using internal::Transform;
using kinematics::Psm;
using kinematics::PsmJoints;

}  // namespace

struct PsmConsoleServer::Impl {
  Impl(dds::Participant& participant, PsmConsole& served, const PsmConsoleServerOptions& chosen)
      : console(served), options(chosen), random(chosen.seed), p(participant) {
    tool_type.Write({served.tool()});
  }

  [[nodiscard]] std::string Topic(const char* name) const {
    return "/" + console.options().arm + "/" + name;
  }

  // Counts a received motion command. Returns false if drop_commands discards it.
  bool Counts() {
    ++commands_taken;
    return random.Uniform() >= faults.drop_commands;
  }

  void TakeCommands() {
    dds::StringStamped command;
    while (state_command.Take(command)) console.StateCommand(command.text);
    dds::Signal signal;
    while (hold.Take(signal)) console.Hold();
    while (free.Take(signal)) console.Free();
    dds::PoseStamped pose;
    while (move_cp.Take(pose)) {
      if (Counts()) console.MoveCp(Transform(pose));
    }
    while (servo_cp.Take(pose)) {
      if (Counts()) console.ServoCp(Transform(pose));
    }
    while (servo_cr.Take(pose)) {
      if (Counts()) console.ServoCr(Transform(pose));
    }
    dds::JointState joints;
    while (move_jp.Take(joints)) {
      if (Counts()) console.MoveJp(JointGoal(joints));
    }
    while (move_jr.Take(joints)) {
      if (Counts()) console.MoveJr(JointGoal(joints));
    }
    while (servo_jp.Take(joints)) {
      if (Counts()) console.ServoJp(JointGoal(joints));
    }
    while (servo_jr.Take(joints)) {
      if (Counts()) console.ServoJr(JointGoal(joints));
    }
    while (servo_jf.Take(joints)) {
      if (Counts()) console.ServoEffort("servo_jf");
    }
    while (jaw_servo_jf.Take(joints)) {
      if (Counts()) console.ServoEffort("jaw/servo_jf");
    }
    dds::WrenchStamped wrench;
    while (body_servo_cf.Take(wrench)) {
      if (Counts()) console.ServoEffort("body/servo_cf");
    }
    while (spatial_servo_cf.Take(wrench)) {
      if (Counts()) console.ServoEffort("spatial/servo_cf");
    }
    dds::CartesianState state;
    while (servo_cs.Take(state)) {
      if (Counts() && state.pose_valid) console.ServoCp(Transform(state));
    }
    while (jaw_move_jp.Take(joints)) {
      if (Counts()) console.MoveJaw(JawGoal(joints));
    }
    while (jaw_servo_jp.Take(joints)) {
      if (Counts()) console.ServoJaw(JawGoal(joints));
    }
    dds::Number wanted;
    while (set_ratio.Take(wanted)) console.SetTrajectoryRatio(wanted.value);
    // Commands without effect: the arm has no weight, force sensors or exchangeable instrument.
    dds::Flag flag;
    for (auto* ignored : {&use_gravity_compensation, &orientation_absolute, &tool_present}) {
      while (ignored->Take(flag)) {
      }
    }
    AnswerQueries();
    // Reports a move that starts and ends in the same step: clients wait for both events.
    if (console.moves_begun() != moves_begun) PublishEvents();
  }

  void AnswerQueries() {
    const auto forward = [](const Eigen::Isometry3d& base) {
      return [base](const dds::ForwardKinematicsQuery& query) {
        dds::ForwardKinematicsAnswer answer;
        if (query.joints.size() != 6) {
          answer.message = "incorrect number of joints";
          return answer;
        }
        const Eigen::Isometry3d pose =
            base * Psm::Forward(Eigen::Map<const PsmJoints>(query.joints.data()));
        answer.position_m = pose.translation();
        answer.orientation = Eigen::Quaterniond(pose.linear());
        answer.good = pose.matrix().allFinite();
        if (!answer.good) answer.message = "not finite";
        return answer;
      };
    };
    forward_kinematics.Serve(forward(console.options().base_frame));
    local_forward_kinematics.Serve(forward(Eigen::Isometry3d::Identity()));
    // Queries are in the arm's own base frame, as on a console.
    inverse_kinematics.Serve([this](const dds::InverseKinematicsQuery& query) {
      dds::InverseKinematicsAnswer answer;
      if (query.joints.size() != 6) {
        answer.message = "incorrect number of joints";
        return answer;
      }
      PsmJoints joints;
      const kinematics::PsmReach reach =
          Psm::Inverse(Transform(query), joints, console.options().generation);
      answer.good =
          reach == kinematics::PsmReach::kOk || reach == kinematics::PsmReach::kJointLimit;
      if (answer.good) {
        answer.joints.assign(joints.data(), joints.data() + joints.size());
      } else {
        answer.message = "inverse kinematics failed";
      }
      return answer;
    });
  }

  [[nodiscard]] dds::Stamp Now() const {
    const std::int64_t jump_ns = std::llround(1e9 * faults.clock_jump_s);
    const dds::Stamp now = options.clock();
    return jump_ns == 0 ? now : dds::Stamp::FromNanoseconds(now.nanoseconds() + jump_ns);
  }

  [[nodiscard]] Snapshot Measure() const {
    const dds::Stamp stamp = console.valid() && !faults.invalid ? Now() : dds::Stamp{};
    const std::string base = console.options().arm + "_base";
    const std::string& given = console.options().base_frame_name;
    const std::string& frame = given.empty() ? base : given;
    Snapshot now;
    now.measured_js = Joints(stamp, console.measured_joints());
    const PsmJoints& velocity = console.joint_velocity();
    now.measured_js.velocity.assign(velocity.data(), velocity.data() + velocity.size());
    now.setpoint_js = Joints(stamp, console.setpoint_joints());
    now.measured_cp = Pose(stamp, frame, console.measured_pose());
    now.setpoint_cp = Pose(stamp, frame, console.setpoint_pose());
    const Eigen::Matrix<double, 6, 1> twist = console.measured_twist();
    now.measured_cv.stamp = stamp;
    now.measured_cv.frame_id = frame;
    now.measured_cv.linear_m_s = twist.head<3>();
    now.measured_cv.angular_rad_s = twist.tail<3>();
    now.local_measured_cp = Pose(stamp, base, Psm::Forward(console.measured_joints()));
    now.local_setpoint_cp = Pose(stamp, base, Psm::Forward(console.setpoint_joints()));
    now.measured_cf.stamp = stamp;
    now.measured_cf.frame_id = frame;
    Eigen::Matrix<double, 6, 6> body;
    Eigen::Matrix<double, 6, 6> spatial;
    Jacobians(console.measured_joints(), body, spatial);
    now.body_jacobian = ByRows(body);
    now.spatial_jacobian = ByRows(spatial);
    now.jaw_measured_js = Jaw(stamp, console.measured_jaw());
    now.jaw_setpoint_js = Jaw(stamp, console.setpoint_jaw());
    if (faults.corrupt) {
      constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
      now.measured_js.position.assign(6, kNan);
      now.measured_js.velocity.assign(6, kNan);
      now.measured_cp.position_m.setConstant(kNan);
      now.local_measured_cp.position_m.setConstant(kNan);
      now.measured_cv.linear_m_s.setConstant(kNan);
    }
    return now;
  }

  // Sends a state to the clients, with the configured delay.
  void SendState() {
    Snapshot shown = faults.freeze && measured_any ? last_measured : Measure();
    last_measured = shown;
    measured_any = true;
    if (faults.silent) return;
    shown.due_s = time_s + faults.delay_s + random.Uniform(0.0, faults.jitter_s);
    if (!on_its_way.empty()) shown.due_s = std::max(shown.due_s, on_its_way.back().due_s);
    on_its_way.push_back(std::move(shown));
  }

  template <typename T>
  void Send(dds::Publisher<T>& publisher, const T& message) {
    if (random.Uniform() >= faults.drop) publisher.Write(message);
  }

  void DeliverStates() {
    for (; !on_its_way.empty() && on_its_way.front().due_s <= time_s; on_its_way.pop_front()) {
      const Snapshot& shown = on_its_way.front();
      Send(measured_js, shown.measured_js);
      Send(setpoint_js, shown.setpoint_js);
      Send(measured_cp, shown.measured_cp);
      Send(setpoint_cp, shown.setpoint_cp);
      Send(local_measured_cp, shown.local_measured_cp);
      Send(local_setpoint_cp, shown.local_setpoint_cp);
      Send(measured_cv, shown.measured_cv);
      Send(jaw_measured_js, shown.jaw_measured_js);
      Send(jaw_setpoint_js, shown.jaw_setpoint_js);
      Send(body_measured_cf, shown.measured_cf);
      Send(spatial_measured_cf, shown.measured_cf);
      Send(body_jacobian, shown.body_jacobian);
      Send(spatial_jacobian, shown.spatial_jacobian);
      ++states_published;
    }
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
          info.Write({.stamp = Now(), .frame_id = "", .text = message.text});
          break;
      }
    }
    if (console.trajectory_ratio() != last_ratio) {
      last_ratio = console.trajectory_ratio();
      ratio.Write({last_ratio});
    }
    for (const bool reached : console.TakeGoals()) goal_reached.Write({reached});
    dds::OperatingState state;
    state.state = Name(console.state());
    state.is_homed = console.homed();
    state.is_busy = console.busy();
    const bool changed = state.state != last_state.state || state.is_homed != last_state.is_homed ||
                         state.is_busy != last_state.is_busy ||
                         console.moves_begun() != moves_begun;
    moves_begun = console.moves_begun();
    if (!changed && time_s < next_state_s) return;
    next_state_s = time_s + 1.0;
    state.stamp = faults.invalid ? dds::Stamp{} : Now();
    operating_state.Write(state);
    if (state.state != last_state.state) {
      state_name.Write({.stamp = state.stamp, .frame_id = "", .text = state.state});
    }
    last_state = state;
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
  int moves_begun = 0;
  double last_ratio = 0.0;
  Snapshot last_measured;
  bool measured_any = false;
  std::deque<Snapshot> on_its_way;
  std::uint64_t commands_taken = 0;
  std::uint64_t states_published = 0;

  dds::Subscriber<dds::StringStamped> state_command{p, Topic("state_command"), dds::Role::kRequest};
  dds::Subscriber<dds::PoseStamped> servo_cp{p, Topic("servo_cp"), dds::Role::kCommand};
  dds::Subscriber<dds::PoseStamped> servo_cr{p, Topic("servo_cr"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> servo_jp{p, Topic("servo_jp"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> servo_jr{p, Topic("servo_jr"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> servo_jf{p, Topic("servo_jf"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> jaw_servo_jf{p, Topic("jaw/servo_jf"), dds::Role::kCommand};
  dds::Subscriber<dds::WrenchStamped> body_servo_cf{p, Topic("body/servo_cf"), dds::Role::kCommand};
  dds::Subscriber<dds::WrenchStamped> spatial_servo_cf{p, Topic("spatial/servo_cf"),
                                                       dds::Role::kCommand};
  dds::Subscriber<dds::CartesianState> servo_cs{p, Topic("servo_cs"), dds::Role::kCommand};
  dds::Subscriber<dds::Number> set_ratio{p, Topic("trajectory_j/set_ratio"), dds::Role::kRequest};
  dds::Subscriber<dds::Flag> use_gravity_compensation{p, Topic("use_gravity_compensation"),
                                                      dds::Role::kRequest};
  dds::Subscriber<dds::Flag> orientation_absolute{p, Topic("body/set_cf_orientation_absolute"),
                                                  dds::Role::kRequest};
  dds::Subscriber<dds::Flag> tool_present{p, Topic("emulate_tool_present"), dds::Role::kRequest};
  dds::Service<dds::ForwardKinematicsQuery, dds::ForwardKinematicsAnswer> forward_kinematics{
      p, Topic("forward_kinematics")};
  dds::Service<dds::ForwardKinematicsQuery, dds::ForwardKinematicsAnswer> local_forward_kinematics{
      p, Topic("local/forward_kinematics")};
  dds::Service<dds::InverseKinematicsQuery, dds::InverseKinematicsAnswer> inverse_kinematics{
      p, Topic("inverse_kinematics")};
  dds::Subscriber<dds::PoseStamped> move_cp{p, Topic("move_cp"), dds::Role::kRequest};
  dds::Subscriber<dds::JointState> move_jp{p, Topic("move_jp"), dds::Role::kRequest};
  dds::Subscriber<dds::JointState> move_jr{p, Topic("move_jr"), dds::Role::kRequest};
  dds::Subscriber<dds::Signal> free{p, Topic("free"), dds::Role::kRequest};
  dds::Subscriber<dds::Signal> hold{p, Topic("hold"), dds::Role::kRequest};
  dds::Subscriber<dds::JointState> jaw_servo_jp{p, Topic("jaw/servo_jp"), dds::Role::kCommand};
  dds::Subscriber<dds::JointState> jaw_move_jp{p, Topic("jaw/move_jp"), dds::Role::kRequest};

  dds::Publisher<dds::JointState> measured_js{p, Topic("measured_js"), dds::Role::kState};
  dds::Publisher<dds::JointState> setpoint_js{p, Topic("setpoint_js"), dds::Role::kState};
  dds::Publisher<dds::PoseStamped> measured_cp{p, Topic("measured_cp"), dds::Role::kState};
  dds::Publisher<dds::PoseStamped> setpoint_cp{p, Topic("setpoint_cp"), dds::Role::kState};
  dds::Publisher<dds::PoseStamped> local_measured_cp{p, Topic("local/measured_cp"),
                                                     dds::Role::kState};
  dds::Publisher<dds::PoseStamped> local_setpoint_cp{p, Topic("local/setpoint_cp"),
                                                     dds::Role::kState};
  dds::Publisher<dds::TwistStamped> measured_cv{p, Topic("measured_cv"), dds::Role::kState};
  dds::Publisher<dds::JointState> jaw_measured_js{p, Topic("jaw/measured_js"), dds::Role::kState};
  dds::Publisher<dds::JointState> jaw_setpoint_js{p, Topic("jaw/setpoint_js"), dds::Role::kState};
  dds::Publisher<dds::WrenchStamped> body_measured_cf{p, Topic("body/measured_cf"),
                                                      dds::Role::kState};
  dds::Publisher<dds::WrenchStamped> spatial_measured_cf{p, Topic("spatial/measured_cf"),
                                                         dds::Role::kState};
  dds::Publisher<dds::Matrix> body_jacobian{p, Topic("body/jacobian"), dds::Role::kState};
  dds::Publisher<dds::Matrix> spatial_jacobian{p, Topic("spatial/jacobian"), dds::Role::kState};
  dds::Publisher<dds::Number> ratio{p, Topic("trajectory_j/ratio"), dds::Role::kEvent};
  dds::Publisher<dds::Text> tool_type{p, Topic("tool_type"), dds::Role::kEvent};
  dds::Publisher<dds::StringStamped> state_name{p, Topic("state"), dds::Role::kEvent};
  dds::Publisher<dds::StringStamped> info{p, Topic("info"), dds::Role::kEvent};
  dds::Publisher<dds::OperatingState> operating_state{p, Topic("operating_state"),
                                                      dds::Role::kEvent};
  dds::Publisher<dds::Flag> goal_reached{p, Topic("goal_reached"), dds::Role::kState};
  dds::Publisher<dds::Text> error{p, Topic("error"), dds::Role::kEvent};
  dds::Publisher<dds::Text> warning{p, Topic("warning"), dds::Role::kEvent};
  dds::Publisher<dds::Text> status{p, Topic("status"), dds::Role::kEvent};
};

PsmConsoleServer::PsmConsoleServer(dds::Participant& participant, PsmConsole& console,
                                   const PsmConsoleServerOptions& options) {
  DFR_THROW_UNLESS(options.state_period_s > 0.0,
                   "state_period_s must be positive, not " << options.state_period_s);
  impl_ = std::make_unique<Impl>(participant, console, options);
}

PsmConsoleServer::~PsmConsoleServer() = default;

void PsmConsoleServer::Tick(double dt_s) {
  TakeCommands();
  impl_->console.Step(dt_s);
  Publish(dt_s, false);
}

void PsmConsoleServer::TakeCommands() { impl_->TakeCommands(); }

void PsmConsoleServer::PublishEvents() { impl_->PublishEvents(); }

void PsmConsoleServer::Publish(double dt_s, bool now) {
  Impl& i = *impl_;
  i.time_s += dt_s;
  const bool due = i.time_s >= i.next_motion_s;
  if (due) {
    i.next_motion_s += i.options.state_period_s;
    // After a long pause, continues from here instead of catching up.
    if (i.next_motion_s < i.time_s) i.next_motion_s = i.time_s;
  }
  if (due || now) i.SendState();
  i.DeliverStates();
  i.PublishEvents();
}

std::uint64_t PsmConsoleServer::commands_taken() const noexcept { return impl_->commands_taken; }
std::uint64_t PsmConsoleServer::states_published() const noexcept {
  return impl_->states_published;
}
bool PsmConsoleServer::WaitUntilReceived(double timeout_s) noexcept {
  const bool texts = impl_->status.WaitUntilReceived(timeout_s) &&
                     impl_->warning.WaitUntilReceived(timeout_s) &&
                     impl_->error.WaitUntilReceived(timeout_s);
  return texts && impl_->operating_state.WaitUntilReceived(timeout_s);
}
int PsmConsoleServer::status_subscribers() const noexcept {
  return impl_->status.num_subscribers();
}
dds::Stamp PsmConsoleServer::now() const { return impl_->Now(); }

void PsmConsoleServer::SetFaults(const ConsoleFaults& faults) {
  DFR_THROW_UNLESS(faults.delay_s >= 0.0 && faults.delay_s <= 2.0, "delay must lie in [0, 2] s");
  DFR_THROW_UNLESS(faults.jitter_s >= 0.0 && faults.jitter_s <= 2.0, "jitter must lie in [0, 2] s");
  DFR_THROW_UNLESS(faults.drop >= 0.0 && faults.drop <= 1.0, "drop must lie in [0, 1]");
  DFR_THROW_UNLESS(faults.drop_commands >= 0.0 && faults.drop_commands <= 1.0,
                   "drop_commands must lie in [0, 1]");
  DFR_THROW_UNLESS(std::abs(faults.clock_jump_s) <= 1e6, "clock_jump must lie in [-1e6, 1e6] s");
  impl_->faults = faults;
  impl_->on_its_way.clear();
}

const ConsoleFaults& PsmConsoleServer::faults() const noexcept { return impl_->faults; }

bool SetFault(ConsoleFaults& faults, std::string_view name, std::string_view value) {
  const std::array<std::pair<std::string_view, double*>, 5> numbers = {{
      {"delay", &faults.delay_s},
      {"jitter", &faults.jitter_s},
      {"drop", &faults.drop},
      {"drop_commands", &faults.drop_commands},
      {"clock_jump", &faults.clock_jump_s},
  }};
  const std::array<std::pair<std::string_view, bool*>, 4> flags = {{
      {"freeze", &faults.freeze},
      {"silent", &faults.silent},
      {"invalid", &faults.invalid},
      {"corrupt", &faults.corrupt},
  }};
  for (const auto& [known, flag] : flags) {
    if (name != known) continue;
    DFR_THROW_UNLESS(value == "0" || value == "1",
                     name << " must be 0 or 1, not '" << value << "'");
    *flag = value == "1";
    return true;
  }
  for (const auto& [known, number] : numbers) {
    if (name != known) continue;
    const std::optional<double> parsed = core::ParseNumber(value);
    DFR_THROW_UNLESS(parsed, name << " takes a number, not '" << value << "'");
    *number = *parsed;
    return true;
  }
  return false;
}

}  // namespace dfr::sim
