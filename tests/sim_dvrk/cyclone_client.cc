// A console's client, written with CycloneDDS, that uses only the CRTK names and types. It homes
// PSM1 and moves the wrist 8 mm along x with servo_cp, by a millimetre for each pose that it
// receives. On demand it waits for a picture of the endoscope and its camera's description:
//   cyclone_client DOMAIN [picture]
// It waits without a limit. Exit code: 0 done; 3 the arm is not where homing ends;
// 1 DDS failed.
#include <dds/dds.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "ros2_types.h"
#include "tests/dds/cyclone.h"

namespace {

using dfr::test::Check;
using dfr::test::MakeReader;
using dfr::test::MakeWriter;
using dfr::test::participant;
using dfr::test::Take;

struct Reader {
  Reader(const dds_topic_descriptor_t& type, const char* name)
      : entity(MakeReader(type, std::string("rt/") + name, 1)),
        waitset(Check(dds_create_waitset(participant))) {
    Check(dds_waitset_attach(waitset, Check(dds_create_readcondition(entity, DDS_ANY_STATE)), 0));
  }
  dds_entity_t entity;
  dds_entity_t waitset;
};

struct Position {
  double x, y, z;
};

double Distance(const Position& a, const Position& b) {
  return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z);
}

// Calls use(sample) for the next sample.
template <typename T, typename Use>
void Await(const Reader& reader, Use use) {
  while (!Take<T>(reader.entity, use)) {
    Check(dds_waitset_wait(reader.waitset, nullptr, 0, DDS_INFINITY));
  }
}

void AwaitPicture() {
  const Reader image(sensor_msgs_msg_dds__Image__desc, "ECM/image_raw");
  const Reader info(sensor_msgs_msg_dds__CameraInfo__desc, "ECM/camera_info");
  for (bool good = false; !good;) {
    Await<sensor_msgs_msg_dds__Image_>(image, [&](const auto& m) {
      if (m.height_ != 480 || m.width_ != 640 || m.step_ != 1920 ||
          std::strcmp(m.encoding_, "bgr8") != 0 || m.data_._length != 480 * 1920) {
        return;
      }
      double sum = 0.0;
      for (std::uint32_t i = 0; i < m.data_._length; ++i) sum += m.data_._buffer[i];
      good = sum / m.data_._length > 20.0;
    });
  }
  for (bool good = false; !good;) {
    Await<sensor_msgs_msg_dds__CameraInfo_>(info, [&](const auto& m) {
      good = m.height_ == 480 && m.width_ == 640 && m.d_._length == 5 && m.k_[0] > 100.0 &&
             m.k_[8] == 1.0 && std::strcmp(m.distortion_model_, "plumb_bob") == 0;
    });
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2 && argc != 3) return 1;
  participant = Check(dds_create_participant(
      static_cast<dds_domainid_t>(std::strtoul(argv[1], nullptr, 10)), nullptr, nullptr));

  const Reader state(crtk_msgs_msg_dds__OperatingState__desc, "PSM1/operating_state");
  const Reader cp(geometry_msgs_msg_dds__PoseStamped__desc, "PSM1/measured_cp");
  const Reader js(sensor_msgs_msg_dds__JointState__desc, "PSM1/measured_js");
  const dds_entity_t command =
      MakeWriter(crtk_msgs_msg_dds__StringStamped__desc, "rt/PSM1/state_command", 10);
  const dds_entity_t servo =
      MakeWriter(geometry_msgs_msg_dds__PoseStamped__desc, "rt/PSM1/servo_cp", 10);

  // The first pose of a homed arm. Before homing, a console sends poses with stamp zero.
  geometry_msgs_msg_dds__PoseStamped_ goal{};
  char frame[] = "PSM1_base";
  goal.header_.frame_id_ = frame;
  Position from{};
  bool homed = false;
  bool valid = false;
  for (int pose = 0; !homed || !valid; ++pose) {
    if (!homed && pose % 10 == 0) {
      crtk_msgs_msg_dds__StringStamped_ home{};
      char nowhere[] = "";
      char text[] = "home";
      home.header_.frame_id_ = nowhere;
      home.string_ = text;
      Check(dds_write(command, &home));
    }
    Await<geometry_msgs_msg_dds__PoseStamped_>(cp, [&](const auto& m) {
      valid = m.header_.stamp_.sec_ != 0;
      goal.pose_ = m.pose_;
      from = {m.pose_.position_.x_, m.pose_.position_.y_, m.pose_.position_.z_};
    });
    Take<crtk_msgs_msg_dds__OperatingState_>(state.entity, [&](const auto& m) {
      homed = std::strcmp(m.state_, "ENABLED") == 0 && m.is_homed_ && !m.is_busy_;
    });
  }
  if (Distance(from, {0.0, 0.0, -0.1135}) > 1e-6) return 3;

  const Position there{from.x + 0.008, from.y, from.z};
  int arrived = 0;
  for (int pose = 0; arrived < 20; ++pose) {
    goal.pose_.position_.x_ = from.x + 0.001 * std::min(pose, 8);
    Check(dds_write(servo, &goal));
    Await<geometry_msgs_msg_dds__PoseStamped_>(cp, [&](const auto& m) {
      const Position at{m.pose_.position_.x_, m.pose_.position_.y_, m.pose_.position_.z_};
      arrived = Distance(at, there) < 1e-5 ? arrived + 1 : 0;
    });
  }

  // 2.0 mm per degree of yaw or pitch at home: 8 mm correspond to 4 degrees.
  for (bool agrees = false; !agrees;) {
    Await<sensor_msgs_msg_dds__JointState_>(js, [&](const auto& m) {
      agrees = m.position_._length == 6 && m.name_._length == 6 &&
               std::strcmp(m.name_._buffer[2], "insertion") == 0 &&
               std::abs(std::hypot(m.position_._buffer[0], m.position_._buffer[1]) - 0.0702) < 5e-3;
    });
  }
  if (argc == 3) AwaitPicture();
  return 0;
}
