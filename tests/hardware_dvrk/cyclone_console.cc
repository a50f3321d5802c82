// A console written with CycloneDDS, which shares with our console only the names and types of the
// topics and the arm's dimensions. PSM1 homes in 0.3 s and follows servo_cp at once, until the
// program is killed:
//   cyclone_console DOMAIN
// Its time is the newest std_msgs/Float64 on /test/time, s since the epoch. Each message there
// triggers a measurement. Like a real console, it stamps measurements zero until it is homed, drops
// servo_cp with a warning when it is not ready, keeps events for late joiners, and holds the last
// goal indefinitely.
#include <dds/dds.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "dfr/kinematics/psm.h"
#include "ros2_types.h"
#include "tests/dds/cyclone.h"

namespace {

using dfr::kinematics::Psm;
using dfr::kinematics::PsmJoints;
using dfr::test::Check;
using dfr::test::MakeReader;
using dfr::test::MakeWriter;
using dfr::test::participant;
using dfr::test::Take;

dds_entity_t Reader(const dds_topic_descriptor_t& type, const char* full, dds_entity_t waitset) {
  const dds_entity_t reader = MakeReader(type, full, 1);
  Check(dds_waitset_attach(waitset, Check(dds_create_readcondition(reader, DDS_ANY_STATE)), 0));
  return reader;
}

dds_entity_t Writer(const dds_topic_descriptor_t& type, const char* name, bool latched) {
  return MakeWriter(type, std::string("rt/PSM1/") + name, 100, latched);
}

class Console {
 public:
  void Command(const std::string& text) {
    if (text == "disable") {
      state_ = "DISABLED";
    } else if (text == "home") {
      state_ = "ENABLED";
      if (!homed_) homing_left_s_ = 0.3;
    }
    PublishState();
  }

  void Servo(const geometry_msgs_msg_dds__Pose_& pose) {
    if (state_ != "ENABLED" || !homed_) {
      Say(warning_, "PSM1: servo_cp dropped, not ready");
      return;
    }
    Eigen::Isometry3d goal = Eigen::Isometry3d::Identity();
    goal.translation() << pose.position_.x_, pose.position_.y_, pose.position_.z_;
    goal.linear() = Eigen::Quaterniond(pose.orientation_.w_, pose.orientation_.x_,
                                       pose.orientation_.y_, pose.orientation_.z_)
                        .toRotationMatrix();
    PsmJoints joints;
    if (Psm::Inverse(goal, joints) != dfr::kinematics::PsmReach::kOk) {
      Say(error_, "PSM1: servo_cp dropped, out of reach");
      return;
    }
    at_ = joints;
  }

  void Time(double now_s) {
    const double dt_s = now_s - now_s_;
    if (dt_s > 0.0) {
      velocity_ = (at_ - measured_) / dt_s;
      measured_ = at_;
      now_s_ = now_s;
      Home(dt_s);
    }
    PublishMotion();
  }

 private:
  void Home(double dt_s) {
    if (homing_left_s_ <= 0.0) return;
    homing_left_s_ -= dt_s;
    if (homing_left_s_ > 0.0) return;
    homed_ = true;
    at_.setZero();
    at_[2] = 0.12;
    measured_ = at_;
    Say(tool_type_, "LARGE_NEEDLE_DRIVER:400006");  // the instrument is engaged
    PublishState();
  }

  static void Say(dds_entity_t writer, const std::string& text) {
    std_msgs_msg_dds__String_ message;
    message.data_ = const_cast<char*>(text.c_str());
    Check(dds_write(writer, &message));
  }

  void PublishState() {
    crtk_msgs_msg_dds__OperatingState_ message{};
    char frame[] = "";
    message.header_.frame_id_ = frame;
    message.state_ = state_.data();
    message.is_homed_ = homed_;
    message.is_busy_ = homing_left_s_ > 0.0;
    Check(dds_write(operating_state_, &message));
  }

  void PublishMotion() {
    std_msgs_msg_dds__Header_ header{};
    char frame[] = "PSM1_base";
    header.frame_id_ = frame;
    if (homed_) {
      const std::int64_t ns = std::llround(1e9 * now_s_);
      header.stamp_.sec_ = static_cast<std::int32_t>(ns / 1'000'000'000);
      header.stamp_.nanosec_ = static_cast<std::uint32_t>(ns % 1'000'000'000);
    }
    // The names are omitted, as by older consoles.
    sensor_msgs_msg_dds__JointState_ joints{};
    joints.header_ = header;
    joints.position_._buffer = at_.data();
    joints.position_._length = joints.position_._maximum = 6;
    Check(dds_write(setpoint_js_, &joints));
    joints.position_._buffer = measured_.data();
    joints.velocity_._buffer = velocity_.data();
    joints.velocity_._length = joints.velocity_._maximum = 6;
    Check(dds_write(measured_js_, &joints));

    geometry_msgs_msg_dds__PoseStamped_ pose{};
    pose.header_ = header;
    const Eigen::Isometry3d at = Psm::Forward(measured_);
    const Eigen::Quaterniond turned(at.linear());
    pose.pose_.position_ = {at.translation().x(), at.translation().y(), at.translation().z()};
    pose.pose_.orientation_ = {turned.x(), turned.y(), turned.z(), turned.w()};
    Check(dds_write(measured_cp_, &pose));
  }

  PsmJoints at_ = PsmJoints::Zero();
  PsmJoints measured_ = PsmJoints::Zero();
  PsmJoints velocity_ = PsmJoints::Zero();
  std::string state_ = "DISABLED";
  bool homed_ = false;
  double homing_left_s_ = 0.0;
  double now_s_ = 0.0;
  dds_entity_t measured_js_ = Writer(sensor_msgs_msg_dds__JointState__desc, "measured_js", false);
  dds_entity_t setpoint_js_ = Writer(sensor_msgs_msg_dds__JointState__desc, "setpoint_js", false);
  dds_entity_t measured_cp_ =
      Writer(geometry_msgs_msg_dds__PoseStamped__desc, "measured_cp", false);
  dds_entity_t operating_state_ =
      Writer(crtk_msgs_msg_dds__OperatingState__desc, "operating_state", true);
  dds_entity_t error_ = Writer(std_msgs_msg_dds__String__desc, "error", true);
  dds_entity_t warning_ = Writer(std_msgs_msg_dds__String__desc, "warning", true);
  dds_entity_t tool_type_ = Writer(std_msgs_msg_dds__String__desc, "tool_type", true);
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return EXIT_FAILURE;
  dfr::test::Join(argv[1]);
  Console console;
  const dds_entity_t waitset = Check(dds_create_waitset(participant));
  const dds_entity_t command =
      Reader(crtk_msgs_msg_dds__StringStamped__desc, "rt/PSM1/state_command", waitset);
  const dds_entity_t servo =
      Reader(geometry_msgs_msg_dds__PoseStamped__desc, "rt/PSM1/servo_cp", waitset);
  const dds_entity_t time = Reader(std_msgs_msg_dds__Float64__desc, "rt/test/time", waitset);
  console.Command("");
  for (;;) {
    Check(dds_waitset_wait(waitset, nullptr, 0, DDS_INFINITY));
    Take<crtk_msgs_msg_dds__StringStamped_>(command,
                                            [&](const auto& m) { console.Command(m.string_); });
    Take<geometry_msgs_msg_dds__PoseStamped_>(servo,
                                              [&](const auto& m) { console.Servo(m.pose_); });
    Take<std_msgs_msg_dds__Float64_>(time, [&](const auto& m) { console.Time(m.data_); });
  }
}
