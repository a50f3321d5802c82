// A client of a console written with CycloneDDS, that knows only the CRTK names and types. It homes
// PSM1, moves the wrist 8 mm along x with servo_cp, a millimetre a tick, opens nothing, and on
// demand waits for a picture of the endoscope and what camera took it:
//   cyclone_client DOMAIN [picture]
// Exit code: 0 done; 2 never homed; 3 no valid pose; 4 not where it was sent; 5 measured_js does
// not agree; 6 no picture of 640 x 480, or a black one; 7 no camera_info that fits it; 1 DDS
// failed.
#include <dds/dds.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "ros2_types.h"

namespace {

using Clock = std::chrono::steady_clock;

dds_entity_t participant;

dds_entity_t Check(dds_entity_t code) {
  if (code < 0) std::exit(1);
  return code;
}

dds_qos_t* RosDefaults(int depth) {
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, depth);
  return qos;
}

dds_entity_t Topic(const dds_topic_descriptor_t& type, const char* name) {
  const std::string full = std::string("rt/") + name;
  return Check(dds_create_topic(participant, &type, full.c_str(), nullptr, nullptr));
}

dds_entity_t Reader(const dds_topic_descriptor_t& type, const char* name) {
  dds_qos_t* qos = RosDefaults(1);
  const dds_entity_t reader =
      Check(dds_create_reader(participant, Topic(type, name), qos, nullptr));
  dds_delete_qos(qos);
  return reader;
}

dds_entity_t Writer(const dds_topic_descriptor_t& type, const char* name) {
  dds_qos_t* qos = RosDefaults(10);
  const dds_entity_t writer =
      Check(dds_create_writer(participant, Topic(type, name), qos, nullptr));
  dds_delete_qos(qos);
  return writer;
}

// Calls use(sample) if there is one.
template <typename T, typename Use>
bool Take(dds_entity_t reader, Use use) {
  void* sample = nullptr;
  dds_sample_info_t info;
  const dds_return_t count = dds_take(reader, &sample, &info, 1, 1);
  Check(count);
  const bool any = count > 0 && info.valid_data;
  if (any) use(*static_cast<const T*>(sample));
  if (count > 0) dds_return_loan(reader, &sample, count);
  return any;
}

struct Position {
  double x, y, z;
};

double Distance(const Position& a, const Position& b) {
  return std::hypot(a.x - b.x, a.y - b.y, a.z - b.z);
}

// 0, or the exit code.
int AwaitPicture(Clock::time_point end) {
  const dds_entity_t image = Reader(sensor_msgs_msg_dds__Image__desc, "ECM/image_raw");
  const dds_entity_t info = Reader(sensor_msgs_msg_dds__CameraInfo__desc, "ECM/camera_info");
  for (bool good = false; !good;) {
    if (Clock::now() > end) return 6;
    dds_sleepfor(DDS_MSECS(2));
    Take<sensor_msgs_msg_dds__Image_>(image, [&](const auto& m) {
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
    if (Clock::now() > end) return 7;
    dds_sleepfor(DDS_MSECS(2));
    Take<sensor_msgs_msg_dds__CameraInfo_>(info, [&](const auto& m) {
      good = m.height_ == 480 && m.width_ == 640 && m.d_._length == 5 && m.k_[0] > 100.0 &&
             m.k_[8] == 1.0 && std::strcmp(m.distortion_model_, "plumb_bob") == 0;
    });
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2 && argc != 3) return 1;
  participant = Check(dds_create_participant(
      static_cast<dds_domainid_t>(std::strtoul(argv[1], nullptr, 10)), nullptr, nullptr));
  const auto end = Clock::now() + std::chrono::seconds(60);

  const dds_entity_t state =
      Reader(crtk_msgs_msg_dds__OperatingState__desc, "PSM1/operating_state");
  const dds_entity_t cp = Reader(geometry_msgs_msg_dds__PoseStamped__desc, "PSM1/measured_cp");
  const dds_entity_t js = Reader(sensor_msgs_msg_dds__JointState__desc, "PSM1/measured_js");
  const dds_entity_t command = Writer(crtk_msgs_msg_dds__StringStamped__desc, "PSM1/state_command");
  const dds_entity_t servo = Writer(geometry_msgs_msg_dds__PoseStamped__desc, "PSM1/servo_cp");

  bool homed = false;
  for (int tick = 0; !homed; ++tick) {
    if (Clock::now() > end) return 2;
    if (tick % 50 == 0) {
      crtk_msgs_msg_dds__StringStamped_ home{};
      char frame[] = "";
      char text[] = "home";
      home.header_.frame_id_ = frame;
      home.string_ = text;
      Check(dds_write(command, &home));
    }
    dds_sleepfor(DDS_MSECS(10));
    Take<crtk_msgs_msg_dds__OperatingState_>(state, [&](const auto& m) {
      homed = std::strcmp(m.state_, "ENABLED") == 0 && m.is_homed_ && !m.is_busy_;
    });
  }

  // The first valid pose: a console stamps those before homing with zero.
  geometry_msgs_msg_dds__PoseStamped_ goal{};
  char frame[] = "PSM1_base";
  goal.header_.frame_id_ = frame;
  Position from{};
  for (bool valid = false; !valid;) {
    if (Clock::now() > end) return 3;
    dds_sleepfor(DDS_MSECS(5));
    Take<geometry_msgs_msg_dds__PoseStamped_>(cp, [&](const auto& m) {
      valid = m.header_.stamp_.sec_ != 0;
      goal.pose_ = m.pose_;
      from = {m.pose_.position_.x_, m.pose_.position_.y_, m.pose_.position_.z_};
    });
  }
  if (Distance(from, {0.0, 0.0, -0.1135}) > 1e-6) return 3;

  const Position there{from.x + 0.008, from.y, from.z};
  Position at = from;
  int arrived = 0;
  for (int tick = 0; arrived < 20; ++tick) {
    if (Clock::now() > end) return 4;
    goal.pose_.position_.x_ = from.x + 0.001 * std::min(tick, 8);
    Check(dds_write(servo, &goal));
    dds_sleepfor(DDS_MSECS(10));
    if (Take<geometry_msgs_msg_dds__PoseStamped_>(cp, [&](const auto& m) {
          at = {m.pose_.position_.x_, m.pose_.position_.y_, m.pose_.position_.z_};
        })) {
      arrived = Distance(at, there) < 1e-5 ? arrived + 1 : 0;
    }
  }

  // 2.0 mm per degree of yaw or pitch at home: 8 mm are 4 degrees.
  for (bool any = false; !any;) {
    if (Clock::now() > end) return 5;
    dds_sleepfor(DDS_MSECS(5));
    bool agrees = false;
    any = Take<sensor_msgs_msg_dds__JointState_>(js, [&](const auto& m) {
      agrees = m.position_._length == 6 && m.name_._length == 6 &&
               std::strcmp(m.name_._buffer[2], "insertion") == 0 &&
               std::abs(std::hypot(m.position_._buffer[0], m.position_._buffer[1]) - 0.0702) < 5e-3;
    });
    if (any && !agrees) return 5;
  }
  return argc == 3 ? AwaitPicture(end) : 0;
}
