// The actions of dvrk_python 2.4's test scripts on a PSM (its arm and psm classes, crtk's utils,
// the scripts for an arm and for a PSM), as an independent client written with CycloneDDS. It knows
// only names, types and ROS 2's quality of service:
//   cyclone_system_script DOMAIN
// Exit code: 0 done, 1 DDS failed, else the number of the step that failed, whose name it prints.
#include <dds/dds.h>

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "ros2_types.h"
#include "tests/dds/cyclone.h"

namespace {

using Clock = std::chrono::steady_clock;

using dfr::test::Check;
using dfr::test::MakeReader;
using dfr::test::MakeWriter;
using dfr::test::participant;
using dfr::test::Take;

// Calls use(sample) for each sample that there is.
template <typename T, typename Use>
bool TakeAll(dds_entity_t reader, Use use) {
  bool any = false;
  dds_sample_info_t info;
  for (void* sample = nullptr; Check(dds_take(reader, &sample, &info, 1, 1)) > 0;
       sample = nullptr) {
    if (info.valid_data) {
      use(*static_cast<const T*>(sample));
      any = true;
    }
    dds_return_loan(reader, &sample, 1);
  }
  return any;
}

double Seconds(const builtin_interfaces_msg_dds__Time_& stamp) {
  return stamp.sec_ + 1e-9 * stamp.nanosec_;
}

double Now() { return std::chrono::duration<double>(Clock::now().time_since_epoch()).count(); }

std::string step_name;
int step_number = 1;

void Step(const char* name) {
  step_name = name;
  ++step_number;
}

[[noreturn]] void Fail() {
  std::fprintf(stderr, "cyclone_system_script: %s\n", step_name.c_str());
  std::exit(step_number);
}

void Require(bool good) {
  if (!good) Fail();
}

constexpr double kDegree = 0.017453292519943295;
using Joints = std::array<double, 6>;

class Psm {
 public:
  Psm() {
    // dvrk.arm and dvrk.psm: the topics that each of their objects publishes ...
    for (const char* name : {"servo_jp", "servo_jr", "servo_jf", "move_jp", "move_jr",
                             "jaw/servo_jp", "jaw/move_jp", "jaw/servo_jf"}) {
      Publish(sensor_msgs_msg_dds__JointState__desc, name, false);
    }
    for (const char* name : {"servo_cp", "move_cp"}) {
      Publish(geometry_msgs_msg_dds__PoseStamped__desc, name, false);
    }
    for (const char* name : {"spatial/servo_cf", "body/servo_cf"}) {
      Publish(geometry_msgs_msg_dds__WrenchStamped__desc, name, false);
    }
    for (const char* name : {"hold", "free"}) Publish(std_msgs_msg_dds__Empty__desc, name, false);
    Publish(crtk_msgs_msg_dds__StringStamped__desc, "state_command", true);
    for (const char* name :
         {"body/set_cf_orientation_absolute", "use_gravity_compensation", "emulate_tool_present"}) {
      Publish(std_msgs_msg_dds__Bool__desc, name, true);
    }
    Publish(std_msgs_msg_dds__Float64__desc, "trajectory_j/set_ratio", true);
    // ... and those to which it subscribes.
    for (const char* name : {"setpoint_js", "measured_js", "jaw/measured_js", "jaw/setpoint_js"}) {
      Subscribe(sensor_msgs_msg_dds__JointState__desc, name, false);
    }
    for (const char* name :
         {"setpoint_cp", "measured_cp", "local/measured_cp", "local/setpoint_cp"}) {
      Subscribe(geometry_msgs_msg_dds__PoseStamped__desc, name, false);
    }
    for (const char* name : {"spatial/measured_cf", "body/measured_cf"}) {
      Subscribe(geometry_msgs_msg_dds__WrenchStamped__desc, name, false);
    }
    for (const char* name : {"spatial/jacobian", "body/jacobian"}) {
      Subscribe(std_msgs_msg_dds__Float64MultiArray__desc, name, false);
    }
    Subscribe(geometry_msgs_msg_dds__TwistStamped__desc, "measured_cv", false);
    Subscribe(crtk_msgs_msg_dds__OperatingState__desc, "operating_state", false);
    Subscribe(std_msgs_msg_dds__Float64__desc, "trajectory_j/ratio", false);
    // The contract that simulators of this robot share.
    Subscribe(crtk_msgs_msg_dds__StringStamped__desc, "state", true);
    Subscribe(crtk_msgs_msg_dds__StringStamped__desc, "info", true);
    Subscribe(std_msgs_msg_dds__String__desc, "tool_type", true);
    Subscribe(std_msgs_msg_dds__String__desc, "warning", false);
    Subscribe(std_msgs_msg_dds__String__desc, "error", false);
  }

  // ral.check_connections(5.0): everybody has found a counterpart.
  void CheckConnections() {
    const bool all = Until(5.0, [this] {
      for (const auto& [name, writer] : writers_) {
        dds_publication_matched_status_t status;
        Check(dds_get_publication_matched_status(writer, &status));
        if (status.current_count == 0) return Missing(name);
      }
      for (const auto& [name, reader] : readers_) {
        dds_subscription_matched_status_t status;
        Check(dds_get_subscription_matched_status(reader, &status));
        if (status.current_count == 0) return Missing(name);
      }
      return true;
    });
    Require(all);
  }

  bool Until(double timeout_s, const std::function<bool()>& condition) {
    for (const double end = Now() + timeout_s;;) {
      Take();
      if (condition()) return true;
      if (Now() > end) return false;
      dds_sleepfor(DDS_MSECS(2));
    }
  }

  void Command(const char* word) {
    crtk_msgs_msg_dds__StringStamped_ message{};
    std::string text = word;
    std::string frame;
    message.header_.frame_id_ = frame.data();
    message.string_ = text.data();
    Check(dds_write(writers_.at("state_command"), &message));
  }
  bool Enable() {
    Command("enable");
    return Until(10.0, [this] { return state == "ENABLED"; });
  }
  bool Home() {
    Command("home");
    return Until(10.0, [this] { return homed && !busy; });
  }

  // Sends joints and returns the time: the handle to wait for.
  double SendJoints(const char* topic, std::vector<double> goal) {
    const double start = Now();
    sensor_msgs_msg_dds__JointState_ message{};
    std::string frame;
    message.header_.frame_id_ = frame.data();
    message.position_._maximum = message.position_._length =
        static_cast<std::uint32_t>(goal.size());
    message.position_._buffer = goal.data();
    Check(dds_write(writers_.at(topic), &message));
    return start;
  }
  double SendPose(const char* topic, const geometry_msgs_msg_dds__Pose_& pose) {
    const double start = Now();
    geometry_msgs_msg_dds__PoseStamped_ message{};
    std::string frame;
    message.header_.frame_id_ = frame.data();
    message.pose_ = pose;
    Check(dds_write(writers_.at(topic), &message));
    return start;
  }
  double Move(const Joints& goal) { return SendJoints("move_jp", {goal.begin(), goal.end()}); }
  // As wait_move_handle.wait(): waits until the arm was busy after `start` and is busy no more.
  void Wait(double start) {
    Require(Until(30.0, [&] { return last_busy > start && !busy; }));
  }
  void WaitBusy(double start) {
    Require(Until(30.0, [&] { return last_busy > start; }));
  }
  void SetRatio(double share) {
    std_msgs_msg_dds__Float64_ message{share};
    Check(dds_write(writers_.at("trajectory_j/set_ratio"), &message));
  }
  dds_entity_t reader(const char* name) const { return readers_.at(name); }
  dds_entity_t writer(const char* name) const { return writers_.at(name); }

  std::string state;
  bool homed = false;
  bool busy = false;
  double last_busy = 0.0;
  std::vector<double> setpoint;
  double setpoint_s = 0.0;
  double measured_s = 0.0;
  std::vector<double> jaw;
  geometry_msgs_msg_dds__Pose_ setpoint_cp{};
  double setpoint_cp_s = 0.0;
  double ratio = 0.0;
  std::string tool;
  std::string state_word;
  std::vector<std::string> words;
  std::map<std::string, std::vector<double>> jacobians;
  bool jacobians_are_6_by_6 = true;

 private:
  void Publish(const dds_topic_descriptor_t& type, const std::string& name, bool latched) {
    writers_[name] = MakeWriter(type, "rt/PSM1/" + name, 10, latched);
  }
  void Subscribe(const dds_topic_descriptor_t& type, const std::string& name, bool latched) {
    readers_[name] = MakeReader(type, "rt/PSM1/" + name, 10, latched);
  }
  static bool Missing(const std::string& name) {
    step_name = "nobody is connected to " + name;
    return false;
  }

  void Take() {
    TakeAll<crtk_msgs_msg_dds__OperatingState_>(reader("operating_state"), [this](const auto& m) {
      if (m.is_busy_) last_busy = Now();
      const double stamp = Seconds(m.header_.stamp_);
      if (!(stamp > state_s_)) return;
      state_s_ = stamp;
      state = m.state_;
      homed = m.is_homed_;
      busy = m.is_busy_;
    });
    TakeAll<sensor_msgs_msg_dds__JointState_>(reader("setpoint_js"), [this](const auto& m) {
      setpoint.assign(m.position_._buffer, m.position_._buffer + m.position_._length);
      setpoint_s = Seconds(m.header_.stamp_);
    });
    TakeAll<sensor_msgs_msg_dds__JointState_>(reader("jaw/setpoint_js"), [this](const auto& m) {
      jaw.assign(m.position_._buffer, m.position_._buffer + m.position_._length);
    });
    TakeAll<sensor_msgs_msg_dds__JointState_>(
        reader("measured_js"), [this](const auto& m) { measured_s = Seconds(m.header_.stamp_); });
    TakeAll<geometry_msgs_msg_dds__PoseStamped_>(reader("setpoint_cp"), [this](const auto& m) {
      setpoint_cp = m.pose_;
      setpoint_cp_s = Seconds(m.header_.stamp_);
    });
    TakeAll<std_msgs_msg_dds__Float64_>(reader("trajectory_j/ratio"),
                                        [this](const auto& m) { ratio = m.data_; });
    TakeAll<std_msgs_msg_dds__String_>(reader("tool_type"),
                                       [this](const auto& m) { tool = m.data_; });
    TakeAll<crtk_msgs_msg_dds__StringStamped_>(reader("state"),
                                               [this](const auto& m) { state_word = m.string_; });
    TakeAll<crtk_msgs_msg_dds__StringStamped_>(
        reader("info"), [this](const auto& m) { words.emplace_back(m.string_); });
    for (const char* name : {"body/jacobian", "spatial/jacobian"}) {
      TakeAll<std_msgs_msg_dds__Float64MultiArray_>(reader(name), [this, name](const auto& m) {
        const auto& dim = m.layout_.dim_;
        jacobians_are_6_by_6 = jacobians_are_6_by_6 && dim._length == 2 &&
                               dim._buffer[0].size_ == 6 && dim._buffer[1].size_ == 6;
        jacobians[name].assign(m.data_._buffer, m.data_._buffer + m.data_._length);
      });
    }
  }

  std::map<std::string, dds_entity_t> writers_;
  std::map<std::string, dds_entity_t> readers_;
  double state_s_ = 0.0;
};

bool Near(const std::vector<double>& values, const Joints& expected) {
  if (values.size() != expected.size()) return false;
  for (std::size_t i = 0; i < 6; ++i) {
    if (std::abs(values[i] - expected[i]) > 1e-6) return false;
  }
  return true;
}

Joints Current(const Psm& psm) {
  Require(psm.setpoint.size() == 6);
  Joints joints{};
  std::copy(psm.setpoint.begin(), psm.setpoint.end(), joints.begin());
  return joints;
}

// A query, and its answer; false if none comes.
template <typename Answer>
bool Ask(Psm& psm, const std::string& name, const dds_topic_descriptor_t& query_type,
         const void* query, const dds_topic_descriptor_t& answer_type,
         const std::function<void(const Answer&)>& use) {
  const dds_entity_t writer = MakeWriter(query_type, "rq/PSM1/" + name + "Request", 10);
  const dds_entity_t reader = MakeReader(answer_type, "rr/PSM1/" + name + "Reply", 10);
  const bool found = psm.Until(5.0, [&] {
    dds_publication_matched_status_t published;
    dds_subscription_matched_status_t subscribed;
    Check(dds_get_publication_matched_status(writer, &published));
    Check(dds_get_subscription_matched_status(reader, &subscribed));
    return published.current_count > 0 && subscribed.current_count > 0;
  });
  if (!found) return false;
  // Discovery is not symmetric: the server may not have found this process yet, and its reply could
  // be lost.
  dds_sleepfor(DDS_MSECS(500));
  Check(dds_write(writer, query));
  return psm.Until(5.0, [&] { return TakeAll<Answer>(reader, use); });
}

void JawMoves(Psm& psm) {
  const auto close = [&] { return psm.SendJoints("jaw/move_jp", {-20.0 * kDegree}); };
  const auto open = [&] { return psm.SendJoints("jaw/move_jp", {60.0 * kDegree}); };
  const auto insert = [&](double depth) {
    Joints goal = Current(psm);
    goal[2] = depth;
    return psm.Move(goal);
  };
  Step("close and open without other move command");
  psm.Wait(close());
  Require(psm.Until(5.0, [&] { return std::abs(psm.jaw.at(0) + 20.0 * kDegree) < 1e-9; }));
  psm.Wait(open());
  Step("close and open with joint move command");
  psm.WaitBusy(close());
  psm.Wait(insert(0.1));
  psm.WaitBusy(open());
  psm.Wait(insert(0.15));
  Step("close and open with cartesian move command");
  psm.Wait(psm.Move({0.0, 0.0, 0.12, 0.0, 0.0, 0.0}));
  Require(psm.Until(1.0, [&] { return psm.setpoint_cp.position_.z_ < -0.113; }));
  geometry_msgs_msg_dds__Pose_ goal = psm.setpoint_cp;
  goal.position_.x_ -= 0.05;
  psm.WaitBusy(psm.SendPose("move_cp", goal));
  psm.Wait(close());
  goal.position_.x_ += 0.05;
  psm.Wait(psm.SendPose("move_cp", goal));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 1;
  participant = Check(dds_create_participant(
      static_cast<dds_domainid_t>(std::strtoul(argv[1], nullptr, 10)), nullptr, nullptr));
  Psm psm;

  Step("check_connections");
  psm.CheckConnections();
  // Both sides have discovered each other: samples arrive from here on.
  dds_sleepfor(DDS_MSECS(500));
  Step("enable");
  Require(psm.Enable());
  Step("home");
  Require(psm.Home());
  Step("valid data after homing");
  Require(psm.Until(5.0, [&] { return psm.setpoint_s > 0.0 && psm.measured_s > 0.0; }));
  Step("move to where it is, and wait for it");
  psm.Wait(psm.Move({0.0, 0.0, 0.12, 0.0, 0.0, 0.0}));
  psm.Wait(psm.Move(Current(psm)));

  Step("servo_jp, two joints, 10 degrees and back, as fast as in the script");
  const Joints home = Current(psm);
  for (int i = 0; i < 200; ++i) {
    const double wave = 5.0 * kDegree * (1.0 - std::cos(i * 360.0 * kDegree / 200));
    Joints goal = home;
    goal[0] += wave;
    goal[1] += wave;
    psm.SendJoints("servo_jp", {goal.begin(), goal.end()});
    psm.Until(0.01, [] { return false; });
    Require(psm.measured_s > 0.0 && psm.setpoint_s > 0.0);
    if (i == 100) Require(psm.Until(5.0, [&] { return psm.setpoint.at(0) > 0.13; }));
  }
  Step("move_jp, and back");
  Joints goal = home;
  goal[0] += 10.0 * kDegree;
  goal[1] -= 10.0 * kDegree;
  psm.Wait(psm.Move(goal));
  Require(psm.Until(5.0, [&] { return Near(psm.setpoint, goal); }));
  psm.Wait(psm.Move(home));

  Step("servo_cp, 4 cm and back");
  Require(psm.Until(5.0, [&] { return Near(psm.setpoint, home) && psm.setpoint_cp_s > 0.0; }));
  psm.Until(0.1, [] { return false; });
  const geometry_msgs_msg_dds__Pose_ initial = psm.setpoint_cp;
  for (int i = 0; i < 200; ++i) {
    const double wave = 0.02 * (1.0 - std::cos(i * 360.0 * kDegree / 200));
    geometry_msgs_msg_dds__Pose_ pose = initial;
    pose.position_.x_ += wave;
    pose.position_.y_ += wave;
    psm.SendPose("servo_cp", pose);
    psm.Until(0.01, [] { return false; });
    if (i == 100) {
      Require(psm.Until(5.0, [&] {
        return std::abs(psm.setpoint_cp.position_.x_ - initial.position_.x_ - 0.04) < 2e-3;
      }));
    }
  }
  Step("move_cp, 5 cm to each side");
  for (const auto& [dx, dy] : {std::pair{-0.05, 0.0}, std::pair{0.05, 0.0}, std::pair{0.0, -0.05},
                               std::pair{0.0, 0.05}, std::pair{0.0, 0.0}}) {
    geometry_msgs_msg_dds__Pose_ pose = initial;
    pose.position_.x_ += dx;
    pose.position_.y_ += dy;
    psm.Wait(psm.SendPose("move_cp", pose));
    Require(psm.Until(5.0, [&] {
      return std::hypot(psm.setpoint_cp.position_.x_ - pose.position_.x_,
                        psm.setpoint_cp.position_.y_ - pose.position_.y_) < 1e-6;
    }));
  }

  JawMoves(psm);
  Step("jaw/servo_jp");
  for (int i = 0; i < 100; ++i) {
    psm.SendJoints("jaw/servo_jp", {kDegree * (50.0 + 30.0 * std::sin(0.01 * i))});
    psm.Until(0.01, [] { return false; });
  }
  Require(psm.Until(5.0, [&] {
    return std::abs(psm.jaw.at(0) - kDegree * (50.0 + 30.0 * std::sin(0.99))) < 1e-6;
  }));

  Step("trajectory_j/ratio");
  psm.SetRatio(0.5);
  Require(psm.Until(5.0, [&] { return psm.ratio == 0.5; }));

  Step("body/ and spatial/jacobian: a turn about the remote centre's y, upside down");
  psm.Wait(psm.Move({0.0, 0.0, 0.12, 0.0, 0.0, 0.0}));
  psm.Until(0.5, [] { return false; });
  Require(psm.jacobians_are_6_by_6 && psm.jacobians["body/jacobian"].size() == 36);
  const std::vector<double>& spatial = psm.jacobians["spatial/jacobian"];
  Require(spatial.size() == 36);
  // Column 0 by rows: the origin does not move, which turns about -y; insertion goes along -z.
  const std::array<double, 6> yaw = {0.0, 0.0, 0.0, 0.0, -1.0, 0.0};
  const std::array<double, 6> insertion = {0.0, 0.0, -1.0, 0.0, 0.0, 0.0};
  for (std::size_t row = 0; row < 6; ++row) {
    Require(std::abs(spatial[6 * row] - yaw[row]) < 1e-6);
    Require(std::abs(spatial[6 * row + 2] - insertion[row]) < 1e-6);
  }

  Step("forward_kinematics");
  std::array<double, 6> jp = {0.0, 0.0, 0.12, 0.0, 0.0, 0.0};
  crtk_msgs_srv_dds__QueryForwardKinematics_Request_ where{};
  where.jp_._maximum = where.jp_._length = 6;
  where.jp_._buffer = jp.data();
  geometry_msgs_msg_dds__Pose_ there{};
  bool good = false;
  using Forward = crtk_msgs_srv_dds__QueryForwardKinematics_Response_;
  for (const char* name : {"forward_kinematics", "local/forward_kinematics"}) {
    Require(Ask<Forward>(psm, name, crtk_msgs_srv_dds__QueryForwardKinematics_Request__desc, &where,
                         crtk_msgs_srv_dds__QueryForwardKinematics_Response__desc,
                         [&](const Forward& answer) {
                           good = answer.result_;
                           there = answer.cp_;
                         }));
    Require(good && std::abs(there.position_.z_ + 0.1135) < 1e-9);
  }
  Step("inverse_kinematics");
  crtk_msgs_srv_dds__QueryInverseKinematics_Request_ pose{};
  pose.jp_ = where.jp_;
  pose.cp_ = there;
  using Inverse = crtk_msgs_srv_dds__QueryInverseKinematics_Response_;
  Joints found{};
  Require(Ask<Inverse>(
      psm, "inverse_kinematics", crtk_msgs_srv_dds__QueryInverseKinematics_Request__desc, &pose,
      crtk_msgs_srv_dds__QueryInverseKinematics_Response__desc, [&](const Inverse& answer) {
        good = answer.result_ && answer.jp_._length == 6;
        if (good) std::copy_n(answer.jp_._buffer, 6, found.begin());
      }));
  Require(good && Near({found.begin(), found.end()}, jp));

  Step("tool_type, state, info");
  Require(psm.Until(5.0, [&] {
    return psm.tool == "LARGE_NEEDLE_DRIVER:400006" && psm.state_word == "ENABLED" &&
           !psm.words.empty();
  }));
  Step("hold and disable");
  std_msgs_msg_dds__Empty_ nothing{};
  Check(dds_write(psm.writer("hold"), &nothing));
  psm.Command("disable");
  Require(psm.Until(5.0, [&] { return psm.state == "DISABLED" && psm.state_word == "DISABLED"; }));
  return 0;
}
