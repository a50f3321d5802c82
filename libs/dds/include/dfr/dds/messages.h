#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <vector>

namespace dfr::dds {

/// The messages that a console (CRTK convention over ROS 2) and we exchange, as plain structs.
/// Publisher and Subscriber turn them into the ROS 2 wire types named at each.

/// Time since the Unix epoch, as ROS 2 stamps it. Consoles stamp invalid data with zero.
struct Stamp {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;

  [[nodiscard]] static Stamp FromNanoseconds(std::int64_t since_epoch_ns) noexcept;
  [[nodiscard]] static Stamp Now() noexcept;
  [[nodiscard]] std::int64_t nanoseconds() const noexcept;
  [[nodiscard]] bool valid() const noexcept { return sec != 0 || nanosec != 0; }
  bool operator==(const Stamp&) const = default;
};

/// geometry_msgs/PoseStamped: measured_cp, servo_cp, ...
struct PoseStamped {
  Stamp stamp;
  std::string frame_id;
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  /// As received: not normalised, not checked.
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

/// sensor_msgs/JointState: measured_js, servo_jp, jaw/measured_js, ... Each vector may be empty.
struct JointState {
  Stamp stamp;
  std::string frame_id;
  std::vector<std::string> name;
  std::vector<double> position;
  std::vector<double> velocity;
  std::vector<double> effort;
};

/// crtk_msgs/OperatingState: operating_state.
struct OperatingState {
  Stamp stamp;
  std::string frame_id;
  std::string state;
  bool is_homed = false;
  bool is_busy = false;
};

/// crtk_msgs/StringStamped: state_command.
struct StringStamped {
  Stamp stamp;
  std::string frame_id;
  std::string text;
};

/// sensor_msgs/Image: image_raw. Rows from the top, `step` bytes each.
struct Image {
  Stamp stamp;
  std::string frame_id;
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  std::string encoding;  ///< "rgb8", "bgr8", "mono8", ...
  bool is_bigendian = false;
  std::uint32_t step = 0;
  std::vector<std::uint8_t> data;
};

/// std_msgs/String: error, warning, status.
struct Text {
  std::string text;
};

/// std_msgs/Bool: goal_reached.
struct Flag {
  bool value = false;
};

/// std_msgs/Empty: hold, free.
struct Signal {};

}  // namespace dfr::dds
