#pragma once

#include <concepts>
#include <type_traits>

#include "dfr/dds/messages.h"
#include "ros2_types.h"
#include "ros2_typesPubSubTypes.h"

namespace dfr::dds::internal {

/// Generated types of a message: the wire type and its type support.
template <typename T>
struct WireOf;

#define DFR_WIRE(Message, package, Name)                  \
  template <>                                             \
  struct WireOf<Message> {                                \
    using Type = package::msg::dds_::Name;                \
    using Support = package::msg::dds_::Name##PubSubType; \
  };
DFR_WIRE(PoseStamped, geometry_msgs, PoseStamped_)
DFR_WIRE(TwistStamped, geometry_msgs, TwistStamped_)
DFR_WIRE(JointState, sensor_msgs, JointState_)
DFR_WIRE(OperatingState, crtk_msgs, OperatingState_)
DFR_WIRE(StringStamped, crtk_msgs, StringStamped_)
DFR_WIRE(Joy, sensor_msgs, Joy_)
DFR_WIRE(Image, sensor_msgs, Image_)
DFR_WIRE(CompressedImage, sensor_msgs, CompressedImage_)
DFR_WIRE(CameraInfo, sensor_msgs, CameraInfo_)
DFR_WIRE(Text, std_msgs, String_)
DFR_WIRE(Flag, std_msgs, Bool_)
DFR_WIRE(Signal, std_msgs, Empty_)
DFR_WIRE(WrenchStamped, geometry_msgs, WrenchStamped_)
DFR_WIRE(CartesianState, crtk_msgs, CartesianState_)
DFR_WIRE(Number, std_msgs, Float64_)
DFR_WIRE(Matrix, std_msgs, Float64MultiArray_)
#undef DFR_WIRE

#define DFR_SERVICE(Message, package, Name)               \
  template <>                                             \
  struct WireOf<Message> {                                \
    using Type = package::srv::dds_::Name;                \
    using Support = package::srv::dds_::Name##PubSubType; \
  };
DFR_SERVICE(ForwardKinematicsQuery, crtk_msgs, QueryForwardKinematics_Request_)
DFR_SERVICE(ForwardKinematicsAnswer, crtk_msgs, QueryForwardKinematics_Response_)
DFR_SERVICE(InverseKinematicsQuery, crtk_msgs, QueryInverseKinematics_Request_)
DFR_SERVICE(InverseKinematicsAnswer, crtk_msgs, QueryInverseKinematics_Response_)
#undef DFR_SERVICE

/// Satisfied by T (a message that FromWire() fills) and by const T (one that ToWire() reads).
template <typename Message, typename T>
concept Is = std::same_as<std::remove_const_t<Message>, T>;

// Each function below calls copy(field of the message, field of the wire type) for all fields.

void Vector(auto& vector, auto& wire, auto copy) {
  copy(vector.x(), wire.x_());
  copy(vector.y(), wire.y_());
  copy(vector.z(), wire.z_());
}
void Pose(auto& message, auto& wire, auto copy) {
  Vector(message.position_m, wire.position_(), copy);
  Vector(message.orientation, wire.orientation_(), copy);
  copy(message.orientation.w(), wire.orientation_().w_());
}
void Twist(auto& message, auto& wire, auto copy) {
  Vector(message.linear_m_s, wire.linear_(), copy);
  Vector(message.angular_rad_s, wire.angular_(), copy);
}

void Fields(Is<PoseStamped> auto& message, auto& wire, auto copy) {
  Pose(message, wire.pose_(), copy);
}
void Fields(Is<TwistStamped> auto& message, auto& wire, auto copy) {
  Twist(message, wire.twist_(), copy);
}
void Fields(Is<WrenchStamped> auto& message, auto& wire, auto copy) {
  Vector(message.force_n, wire.wrench_().force_(), copy);
  Vector(message.torque_nm, wire.wrench_().torque_(), copy);
}
// Omits the wrench, which a new wire message marks as invalid.
void Fields(Is<CartesianState> auto& message, auto& wire, auto copy) {
  copy(message.pose_valid, wire.pose_is_valid_().data_());
  Pose(message, wire.pose_(), copy);
  copy(message.twist_valid, wire.twist_is_valid_().data_());
  Twist(message, wire.twist_(), copy);
}
void Fields(Is<JointState> auto& message, auto& wire, auto copy) {
  copy(message.name, wire.name_());
  copy(message.position, wire.position_());
  copy(message.velocity, wire.velocity_());
  copy(message.effort, wire.effort_());
}
void Fields(Is<OperatingState> auto& message, auto& wire, auto copy) {
  copy(message.state, wire.state_());
  copy(message.is_homed, wire.is_homed_());
  copy(message.is_busy, wire.is_busy_());
}
void Fields(Is<StringStamped> auto& message, auto& wire, auto copy) {
  copy(message.text, wire.string_());
}
void Fields(Is<Joy> auto& message, auto& wire, auto copy) {
  copy(message.axes, wire.axes_());
  copy(message.buttons, wire.buttons_());
}
void Fields(Is<Image> auto& message, auto& wire, auto copy) {
  copy(message.height, wire.height_());
  copy(message.width, wire.width_());
  copy(message.encoding, wire.encoding_());
  copy(message.is_bigendian, wire.is_bigendian_());
  copy(message.step, wire.step_());
  copy(message.data, wire.data_());
}
void Fields(Is<CompressedImage> auto& message, auto& wire, auto copy) {
  copy(message.format, wire.format_());
  copy(message.data, wire.data_());
}
void Fields(Is<CameraInfo> auto& message, auto& wire, auto copy) {
  copy(message.height, wire.height_());
  copy(message.width, wire.width_());
  copy(message.distortion_model, wire.distortion_model_());
  copy(message.d, wire.d_());
  copy(message.k, wire.k_());
  copy(message.r, wire.r_());
  copy(message.p, wire.p_());
  copy(message.binning_x, wire.binning_x_());
  copy(message.binning_y, wire.binning_y_());
  auto& roi = wire.roi_();
  copy(message.roi_x_offset, roi.x_offset_());
  copy(message.roi_y_offset, roi.y_offset_());
  copy(message.roi_height, roi.height_());
  copy(message.roi_width, roi.width_());
  copy(message.roi_do_rectify, roi.do_rectify_());
}
void Fields(Is<Text> auto& message, auto& wire, auto copy) { copy(message.text, wire.data_()); }
void Fields(Is<Flag> auto& message, auto& wire, auto copy) { copy(message.value, wire.data_()); }
void Fields(Is<Signal> auto& /*message*/, auto& /*wire*/, auto /*copy*/) {}
void Fields(Is<Number> auto& message, auto& wire, auto copy) { copy(message.value, wire.data_()); }
void Fields(Is<ForwardKinematicsQuery> auto& message, auto& wire, auto copy) {
  copy(message.joints, wire.jp_());
}
void Fields(Is<ForwardKinematicsAnswer> auto& message, auto& wire, auto copy) {
  Pose(message, wire.cp_(), copy);
  copy(message.good, wire.result_());
  copy(message.message, wire.message_());
}
void Fields(Is<InverseKinematicsQuery> auto& message, auto& wire, auto copy) {
  Pose(message, wire.cp_(), copy);
  copy(message.joints, wire.jp_());
}
void Fields(Is<InverseKinematicsAnswer> auto& message, auto& wire, auto copy) {
  copy(message.joints, wire.jp_());
  copy(message.good, wire.result_());
  copy(message.message, wire.message_());
}

void AllFields(auto& message, auto& wire, auto copy) {
  if constexpr (requires { message.stamp; }) {
    copy(message.stamp.sec, wire.header_().stamp_().sec_());
    copy(message.stamp.nanosec, wire.header_().stamp_().nanosec_());
    copy(message.frame_id, wire.header_().frame_id_());
  }
  Fields(message, wire, copy);
}

/// Converts a message to its wire type, and back.
template <typename T>
void ToWire(const T& message, typename WireOf<T>::Type& wire) {
  AllFields(message, wire, [](const auto& from, auto& to) { to = from; });
}
template <typename T>
void FromWire(const typename WireOf<T>::Type& wire, T& message) {
  AllFields(message, wire, [](auto& to, const auto& from) { to = from; });
}
void ToWire(const Matrix& message, WireOf<Matrix>::Type& wire);
void FromWire(const WireOf<Matrix>::Type& wire, Matrix& message);

}  // namespace dfr::dds::internal
