#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace dfr::dds {

/// Messages exchanged with a console (CRTK convention over ROS 2), as plain structs. Publisher and
/// Subscriber convert them to the ROS 2 wire types named below.

/// Time since the Unix epoch, as in ROS 2 headers. Consoles stamp invalid data with zero.
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
  /// As received: not normalised or checked.
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

/// geometry_msgs/TwistStamped: measured_cv.
struct TwistStamped {
  Stamp stamp;
  std::string frame_id;
  Eigen::Vector3d linear_m_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_rad_s = Eigen::Vector3d::Zero();
};

/// geometry_msgs/WrenchStamped: body/measured_cf, body/servo_cf, ...
struct WrenchStamped {
  Stamp stamp;
  std::string frame_id;
  Eigen::Vector3d force_n = Eigen::Vector3d::Zero();
  Eigen::Vector3d torque_nm = Eigen::Vector3d::Zero();
};

/// crtk_msgs/CartesianState: servo_cs. The wrench, always sent as invalid, is omitted.
struct CartesianState {
  Stamp stamp;
  std::string frame_id;
  bool pose_valid = false;
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  /// As received: not normalised or checked.
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  bool twist_valid = false;
  Eigen::Vector3d linear_m_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_rad_s = Eigen::Vector3d::Zero();
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

/// sensor_msgs/Joy: pedals and buttons; 1 means pressed.
struct Joy {
  Stamp stamp;
  std::string frame_id;
  std::vector<float> axes;
  std::vector<std::int32_t> buttons;
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

/// sensor_msgs/CompressedImage: image_raw/compressed.
struct CompressedImage {
  Stamp stamp;
  std::string frame_id;
  std::string format;  ///< "jpeg", "png", or image_transport's form "bgr8; jpeg compressed".
  std::vector<std::uint8_t> data;
};

/// sensor_msgs/CameraInfo: camera_info. Row-major matrices.
struct CameraInfo {
  Stamp stamp;
  std::string frame_id;
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  std::string distortion_model;    ///< "plumb_bob", "rational_polynomial", ...
  std::vector<double> d;           ///< Distortion; plumb_bob: k1, k2, p1, p2, k3.
  std::array<double, 9> k{};       ///< Intrinsics of the raw image: fx 0 cx, 0 fy cy, 0 0 1.
  std::array<double, 9> r{};       ///< Rectifying rotation; identity for a single camera.
  std::array<double, 12> p{};      ///< Projection matrix of the rectified image, 3 x 4.
  std::uint32_t binning_x = 0;     ///< Binning factor; 0 means 1.
  std::uint32_t binning_y = 0;     ///< Binning factor; 0 means 1.
  std::uint32_t roi_x_offset = 0;  ///< Region of interest; all zero means the whole image.
  std::uint32_t roi_y_offset = 0;
  std::uint32_t roi_height = 0;
  std::uint32_t roi_width = 0;
  bool roi_do_rectify = false;
};

/// std_msgs/String: error, warning, status.
struct Text {
  std::string text;
};

/// std_msgs/Bool: goal_reached.
struct Flag {
  bool value = false;
};

/// std_msgs/Float64: trajectory_j/ratio.
struct Number {
  double value = 0.0;
};

/// std_msgs/Float64MultiArray with two dimensions: body/jacobian. Row-major.
struct Matrix {
  std::uint32_t rows = 0;
  std::uint32_t cols = 0;
  std::vector<double> data;  ///< rows x cols entries in a well-formed message
};

/// std_msgs/Empty: hold, free.
struct Signal {};

/// crtk_msgs/QueryForwardKinematics, the request: joint values, rad (insertion: m).
struct ForwardKinematicsQuery {
  std::vector<double> joints;
};

/// crtk_msgs/QueryForwardKinematics, the response.
struct ForwardKinematicsAnswer {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  bool good = false;
  std::string message;  ///< Description of the error if not good.
};

/// crtk_msgs/QueryInverseKinematics, the request: a pose, and joint values near the desired
/// solution.
struct InverseKinematicsQuery {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  /// As received: not normalised or checked.
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  std::vector<double> joints;
};

/// crtk_msgs/QueryInverseKinematics, the response.
struct InverseKinematicsAnswer {
  std::vector<double> joints;
  bool good = false;
  std::string message;  ///< Description of the error if not good.
};

}  // namespace dfr::dds
