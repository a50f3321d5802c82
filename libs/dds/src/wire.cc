#include "wire.h"

#include <chrono>

namespace dfr::dds {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

}  // namespace

Stamp Stamp::FromNanoseconds(std::int64_t since_epoch_ns) noexcept {
  std::int64_t sec = since_epoch_ns / kSecond;
  std::int64_t nanosec = since_epoch_ns % kSecond;
  if (nanosec < 0) {
    nanosec += kSecond;
    --sec;
  }
  return {static_cast<std::int32_t>(sec), static_cast<std::uint32_t>(nanosec)};
}

Stamp Stamp::Now() noexcept {
  return FromNanoseconds(std::chrono::duration_cast<std::chrono::nanoseconds>(
                             std::chrono::system_clock::now().time_since_epoch())
                             .count());
}

std::int64_t Stamp::nanoseconds() const noexcept {
  return kSecond * static_cast<std::int64_t>(sec) + static_cast<std::int64_t>(nanosec);
}

namespace internal {

namespace {

template <typename T>
void HeaderToWire(const T& message, std_msgs::msg::dds_::Header_& header) {
  header.stamp_().sec_(message.stamp.sec);
  header.stamp_().nanosec_(message.stamp.nanosec);
  header.frame_id_(message.frame_id);
}

template <typename T>
void HeaderFromWire(const std_msgs::msg::dds_::Header_& header, T& message) {
  message.stamp.sec = header.stamp_().sec_();
  message.stamp.nanosec = header.stamp_().nanosec_();
  message.frame_id = header.frame_id_();
}

template <typename Wire>
void VectorToWire(const Eigen::Vector3d& vector, Wire& wire) {
  wire.x_(vector.x());
  wire.y_(vector.y());
  wire.z_(vector.z());
}

template <typename Wire>
Eigen::Vector3d VectorFromWire(const Wire& wire) {
  return {wire.x_(), wire.y_(), wire.z_()};
}

template <typename T>
void PoseToWire(const T& message, geometry_msgs::msg::dds_::Pose_& pose) {
  VectorToWire(message.position_m, pose.position_());
  auto& orientation = pose.orientation_();
  orientation.x_(message.orientation.x());
  orientation.y_(message.orientation.y());
  orientation.z_(message.orientation.z());
  orientation.w_(message.orientation.w());
}

template <typename T>
void PoseFromWire(const geometry_msgs::msg::dds_::Pose_& pose, T& message) {
  message.position_m = VectorFromWire(pose.position_());
  const auto& orientation = pose.orientation_();
  message.orientation =
      Eigen::Quaterniond(orientation.w_(), orientation.x_(), orientation.y_(), orientation.z_());
}

template <typename T>
void TwistToWire(const T& message, geometry_msgs::msg::dds_::Twist_& twist) {
  VectorToWire(message.linear_m_s, twist.linear_());
  VectorToWire(message.angular_rad_s, twist.angular_());
}

template <typename T>
void TwistFromWire(const geometry_msgs::msg::dds_::Twist_& twist, T& message) {
  message.linear_m_s = VectorFromWire(twist.linear_());
  message.angular_rad_s = VectorFromWire(twist.angular_());
}

}  // namespace

void ToWire(const PoseStamped& message, WireOf<PoseStamped>::Type& wire) {
  HeaderToWire(message, wire.header_());
  PoseToWire(message, wire.pose_());
}

void FromWire(const WireOf<PoseStamped>::Type& wire, PoseStamped& message) {
  HeaderFromWire(wire.header_(), message);
  PoseFromWire(wire.pose_(), message);
}

void ToWire(const TwistStamped& message, WireOf<TwistStamped>::Type& wire) {
  HeaderToWire(message, wire.header_());
  TwistToWire(message, wire.twist_());
}

void FromWire(const WireOf<TwistStamped>::Type& wire, TwistStamped& message) {
  HeaderFromWire(wire.header_(), message);
  TwistFromWire(wire.twist_(), message);
}

void ToWire(const WrenchStamped& message, WireOf<WrenchStamped>::Type& wire) {
  HeaderToWire(message, wire.header_());
  VectorToWire(message.force_n, wire.wrench_().force_());
  VectorToWire(message.torque_nm, wire.wrench_().torque_());
}

void FromWire(const WireOf<WrenchStamped>::Type& wire, WrenchStamped& message) {
  HeaderFromWire(wire.header_(), message);
  message.force_n = VectorFromWire(wire.wrench_().force_());
  message.torque_nm = VectorFromWire(wire.wrench_().torque_());
}

void ToWire(const CartesianState& message, WireOf<CartesianState>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.pose_is_valid_().data_(message.pose_valid);
  PoseToWire(message, wire.pose_());
  wire.twist_is_valid_().data_(message.twist_valid);
  TwistToWire(message, wire.twist_());
  wire.wrench_is_valid_().data_(false);
}

void FromWire(const WireOf<CartesianState>::Type& wire, CartesianState& message) {
  HeaderFromWire(wire.header_(), message);
  message.pose_valid = wire.pose_is_valid_().data_();
  PoseFromWire(wire.pose_(), message);
  message.twist_valid = wire.twist_is_valid_().data_();
  TwistFromWire(wire.twist_(), message);
}

void ToWire(const JointState& message, WireOf<JointState>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.name_(message.name);
  wire.position_(message.position);
  wire.velocity_(message.velocity);
  wire.effort_(message.effort);
}

void FromWire(const WireOf<JointState>::Type& wire, JointState& message) {
  HeaderFromWire(wire.header_(), message);
  message.name = wire.name_();
  message.position = wire.position_();
  message.velocity = wire.velocity_();
  message.effort = wire.effort_();
}

void ToWire(const OperatingState& message, WireOf<OperatingState>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.state_(message.state);
  wire.is_homed_(message.is_homed);
  wire.is_busy_(message.is_busy);
}

void FromWire(const WireOf<OperatingState>::Type& wire, OperatingState& message) {
  HeaderFromWire(wire.header_(), message);
  message.state = wire.state_();
  message.is_homed = wire.is_homed_();
  message.is_busy = wire.is_busy_();
}

void ToWire(const StringStamped& message, WireOf<StringStamped>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.string_(message.text);
}

void FromWire(const WireOf<StringStamped>::Type& wire, StringStamped& message) {
  HeaderFromWire(wire.header_(), message);
  message.text = wire.string_();
}

void ToWire(const Joy& message, WireOf<Joy>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.axes_(message.axes);
  wire.buttons_(message.buttons);
}

void FromWire(const WireOf<Joy>::Type& wire, Joy& message) {
  HeaderFromWire(wire.header_(), message);
  message.axes = wire.axes_();
  message.buttons = wire.buttons_();
}

void ToWire(const Image& message, WireOf<Image>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.height_(message.height);
  wire.width_(message.width);
  wire.encoding_(message.encoding);
  wire.is_bigendian_(message.is_bigendian ? 1 : 0);
  wire.step_(message.step);
  wire.data_(message.data);
}

void FromWire(const WireOf<Image>::Type& wire, Image& message) {
  HeaderFromWire(wire.header_(), message);
  message.height = wire.height_();
  message.width = wire.width_();
  message.encoding = wire.encoding_();
  message.is_bigendian = wire.is_bigendian_() != 0;
  message.step = wire.step_();
  message.data = wire.data_();
}

void ToWire(const CompressedImage& message, WireOf<CompressedImage>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.format_(message.format);
  wire.data_(message.data);
}

void FromWire(const WireOf<CompressedImage>::Type& wire, CompressedImage& message) {
  HeaderFromWire(wire.header_(), message);
  message.format = wire.format_();
  message.data = wire.data_();
}

void ToWire(const CameraInfo& message, WireOf<CameraInfo>::Type& wire) {
  HeaderToWire(message, wire.header_());
  wire.height_(message.height);
  wire.width_(message.width);
  wire.distortion_model_(message.distortion_model);
  wire.d_(message.d);
  wire.k_(message.k);
  wire.r_(message.r);
  wire.p_(message.p);
  wire.binning_x_(message.binning_x);
  wire.binning_y_(message.binning_y);
  auto& roi = wire.roi_();
  roi.x_offset_(message.roi_x_offset);
  roi.y_offset_(message.roi_y_offset);
  roi.height_(message.roi_height);
  roi.width_(message.roi_width);
  roi.do_rectify_(message.roi_do_rectify);
}

void FromWire(const WireOf<CameraInfo>::Type& wire, CameraInfo& message) {
  HeaderFromWire(wire.header_(), message);
  message.height = wire.height_();
  message.width = wire.width_();
  message.distortion_model = wire.distortion_model_();
  message.d = wire.d_();
  message.k = wire.k_();
  message.r = wire.r_();
  message.p = wire.p_();
  message.binning_x = wire.binning_x_();
  message.binning_y = wire.binning_y_();
  const auto& roi = wire.roi_();
  message.roi_x_offset = roi.x_offset_();
  message.roi_y_offset = roi.y_offset_();
  message.roi_height = roi.height_();
  message.roi_width = roi.width_();
  message.roi_do_rectify = roi.do_rectify_();
}

void ToWire(const Text& message, WireOf<Text>::Type& wire) { wire.data_(message.text); }
void FromWire(const WireOf<Text>::Type& wire, Text& message) { message.text = wire.data_(); }

void ToWire(const Flag& message, WireOf<Flag>::Type& wire) { wire.data_(message.value); }
void FromWire(const WireOf<Flag>::Type& wire, Flag& message) { message.value = wire.data_(); }

void ToWire(const Signal& /*message*/, WireOf<Signal>::Type& wire) {
  wire.structure_needs_at_least_one_member_(0);
}
void FromWire(const WireOf<Signal>::Type& /*wire*/, Signal& /*message*/) {}

void ToWire(const Number& message, WireOf<Number>::Type& wire) { wire.data_(message.value); }
void FromWire(const WireOf<Number>::Type& wire, Number& message) { message.value = wire.data_(); }

void ToWire(const Matrix& message, WireOf<Matrix>::Type& wire) {
  auto& dims = wire.layout_().dim_();
  dims.resize(2);
  dims[0].label_("rows");
  dims[0].size_(message.rows);
  dims[0].stride_(message.rows * message.cols);
  dims[1].label_("cols");
  dims[1].size_(message.cols);
  dims[1].stride_(message.cols);
  wire.data_(message.data);
}

void FromWire(const WireOf<Matrix>::Type& wire, Matrix& message) {
  const auto& dims = wire.layout_().dim_();
  message.rows = dims.size() == 2 ? dims[0].size_() : 0;
  message.cols = dims.size() == 2 ? dims[1].size_() : 0;
  message.data = wire.data_();
}

void ToWire(const ForwardKinematicsQuery& message, WireOf<ForwardKinematicsQuery>::Type& wire) {
  wire.jp_(message.joints);
}

void FromWire(const WireOf<ForwardKinematicsQuery>::Type& wire, ForwardKinematicsQuery& message) {
  message.joints = wire.jp_();
}

void ToWire(const ForwardKinematicsAnswer& message, WireOf<ForwardKinematicsAnswer>::Type& wire) {
  PoseToWire(message, wire.cp_());
  wire.result_(message.good);
  wire.message_(message.message);
}

void FromWire(const WireOf<ForwardKinematicsAnswer>::Type& wire, ForwardKinematicsAnswer& message) {
  PoseFromWire(wire.cp_(), message);
  message.good = wire.result_();
  message.message = wire.message_();
}

void ToWire(const InverseKinematicsQuery& message, WireOf<InverseKinematicsQuery>::Type& wire) {
  PoseToWire(message, wire.cp_());
  wire.jp_(message.joints);
}

void FromWire(const WireOf<InverseKinematicsQuery>::Type& wire, InverseKinematicsQuery& message) {
  PoseFromWire(wire.cp_(), message);
  message.joints = wire.jp_();
}

void ToWire(const InverseKinematicsAnswer& message, WireOf<InverseKinematicsAnswer>::Type& wire) {
  wire.jp_(message.joints);
  wire.result_(message.good);
  wire.message_(message.message);
}

void FromWire(const WireOf<InverseKinematicsAnswer>::Type& wire, InverseKinematicsAnswer& message) {
  message.joints = wire.jp_();
  message.good = wire.result_();
  message.message = wire.message_();
}

}  // namespace internal

}  // namespace dfr::dds
