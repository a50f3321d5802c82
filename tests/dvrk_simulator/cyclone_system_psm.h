#pragma once

#include <dds/dds.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "ros2_types.h"
#include "tests/dds/cyclone.h"

namespace dfr::test {

/// Calls use(sample) for each available sample.
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

inline double Seconds(const builtin_interfaces_msg_dds__Time_& stamp) {
  return stamp.sec_ + 1e-9 * stamp.nanosec_;
}

inline double Now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Name that Fail() prints, with the exit code.
inline std::string step_name;
inline int step_number = 1;

inline void Step(const char* name) {
  step_name = name;
  ++step_number;
}

[[noreturn]] inline void Fail() {
  std::fprintf(stderr, "cyclone_system_script: %s\n", step_name.c_str());
  std::exit(step_number);
}

inline void Require(bool good) {
  if (!good) Fail();
}

using Joints = std::array<double, 6>;

/// A PSM with the interface of dvrk_python's classes arm and psm.
class Psm {
 public:
  Psm() {
    // Topics that each object of dvrk.arm and dvrk.psm publishes.
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
    // Topics to which each of these objects subscribes.
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
    // Topics that other simulators of this robot also publish.
    Subscribe(crtk_msgs_msg_dds__StringStamped__desc, "state", true);
    Subscribe(crtk_msgs_msg_dds__StringStamped__desc, "info", true);
    Subscribe(std_msgs_msg_dds__String__desc, "tool_type", true);
    Subscribe(std_msgs_msg_dds__String__desc, "warning", false);
    Subscribe(std_msgs_msg_dds__String__desc, "error", false);
  }

  // Same as ral.check_connections(5.0): waits until all endpoints have found a counterpart.
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

  // Sends a joint goal. Returns the time of sending, the argument of Wait().
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
  // Same as wait_move_handle.wait(): waits until the arm has been busy after `start` and is idle
  // again.
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
    step_name = "no peer is connected to " + name;
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

}  // namespace dfr::test
