// Performs the actions of dvrk_python 2.4's test scripts on a PSM (its arm and psm classes, crtk's
// utils, the scripts for an arm and for a PSM). This independent client is written with CycloneDDS,
// and shares with dfr only names, types and ROS 2's quality of service:
//   cyclone_system_script DOMAIN
// Exit code: 0 after all steps, 1 if DDS fails, else the number of the failed step, whose name it
// prints.
#include <dds/dds.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <numeric>
#include <string>
#include <vector>

#include "ros2_types.h"
#include "tests/dds/cyclone.h"
#include "tests/dvrk_simulator/cyclone_system_psm.h"

namespace {

using dfr::test::Check;
using dfr::test::Joints;
using dfr::test::MakeReader;
using dfr::test::MakeWriter;
using dfr::test::Psm;
using dfr::test::Require;
using dfr::test::Step;
using dfr::test::TakeAll;

constexpr double kDegree = 0.017453292519943295;

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

// Sends a query and waits for its answer. Returns false without an answer.
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

// Waits for a picture of the endoscope that is not dark, and for its camera's description.
void AwaitPicture(Psm& psm) {
  const dds_entity_t images = MakeReader(sensor_msgs_msg_dds__Image__desc, "rt/ECM/image_raw", 1);
  const dds_entity_t infos =
      MakeReader(sensor_msgs_msg_dds__CameraInfo__desc, "rt/ECM/camera_info", 1);
  bool good = false;
  Require(psm.Until(30.0, [&] {
    TakeAll<sensor_msgs_msg_dds__Image_>(images, [&](const auto& m) {
      const std::uint8_t* const begin = m.data_._buffer;
      const std::uint8_t* const end = begin + m.data_._length;
      good = m.height_ == 480 && m.width_ == 640 && m.step_ == 1920 &&
             std::strcmp(m.encoding_, "bgr8") == 0 && m.data_._length == 480 * 1920 &&
             std::accumulate(begin, end, 0.0) > 20.0 * m.data_._length;
    });
    return good;
  }));
  good = false;
  Require(psm.Until(30.0, [&] {
    TakeAll<sensor_msgs_msg_dds__CameraInfo_>(infos, [&](const auto& m) {
      good = m.height_ == 480 && m.width_ == 640 && m.d_._length == 5 && m.k_[0] > 100.0 &&
             m.k_[8] == 1.0 && std::strcmp(m.distortion_model_, "plumb_bob") == 0;
    });
    return good;
  }));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 1;
  dfr::test::Join(argv[1]);
  Psm psm;

  Step("check_connections");
  psm.CheckConnections();
  // Discovery is not symmetric: the simulator may not have found this process yet.
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

  Step("servo_jp and servo_cp");
  const Joints home = Current(psm);
  Joints goal = home;
  goal[0] += 10.0 * kDegree;
  goal[1] -= 10.0 * kDegree;
  psm.SendJoints("servo_jp", {goal.begin(), goal.end()});
  Require(psm.Until(5.0, [&] { return Near(psm.setpoint, goal); }));
  psm.Until(0.1, [] { return false; });
  const geometry_msgs_msg_dds__Pose_ turned = psm.setpoint_cp;
  psm.Wait(psm.Move(home));
  psm.SendPose("servo_cp", turned);
  Require(psm.Until(5.0, [&] { return Near(psm.setpoint, goal); }));
  Step("move_jp and move_cp");
  psm.Wait(psm.Move(home));
  Require(psm.Until(5.0, [&] { return Near(psm.setpoint, home); }));
  psm.Wait(psm.SendPose("move_cp", turned));
  Require(psm.Until(5.0, [&] { return Near(psm.setpoint, goal); }));
  Step("jaw/move_jp, alone and during a move of the arm");
  psm.Wait(psm.SendJoints("jaw/move_jp", {-20.0 * kDegree}));
  Require(psm.Until(5.0, [&] { return std::abs(psm.jaw.at(0) + 20.0 * kDegree) < 1e-9; }));
  psm.WaitBusy(psm.SendJoints("jaw/move_jp", {60.0 * kDegree}));
  psm.Wait(psm.Move(home));
  Step("jaw/servo_jp");
  psm.SendJoints("jaw/servo_jp", {50.0 * kDegree});
  Require(psm.Until(5.0, [&] { return std::abs(psm.jaw.at(0) - 50.0 * kDegree) < 1e-6; }));
  Step("trajectory_j/ratio");
  psm.SetRatio(0.5);
  Require(psm.Until(5.0, [&] { return psm.ratio == 0.5; }));

  Step("body/ and spatial/jacobian: a turn about the remote centre's y, upside down");
  psm.Wait(psm.Move({0.0, 0.0, 0.12, 0.0, 0.0, 0.0}));
  psm.Until(0.5, [] { return false; });
  Require(psm.jacobians_are_6_by_6 && psm.jacobians["body/jacobian"].size() == 36);
  const std::vector<double>& spatial = psm.jacobians["spatial/jacobian"];
  Require(spatial.size() == 36);
  // Columns 0 and 2, by rows. Yaw turns the origin about -y without moving it. Insertion moves the
  // origin along -z.
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
  Step("image_raw and camera_info");
  AwaitPicture(psm);
  Step("hold and disable");
  std_msgs_msg_dds__Empty_ nothing{};
  Check(dds_write(psm.writer("hold"), &nothing));
  psm.Command("disable");
  Require(psm.Until(5.0, [&] { return psm.state == "DISABLED" && psm.state_word == "DISABLED"; }));
  return 0;
}
