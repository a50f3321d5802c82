#pragma once

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

void ToWire(const PoseStamped& message, WireOf<PoseStamped>::Type& wire);
void ToWire(const TwistStamped& message, WireOf<TwistStamped>::Type& wire);
void ToWire(const JointState& message, WireOf<JointState>::Type& wire);
void ToWire(const OperatingState& message, WireOf<OperatingState>::Type& wire);
void ToWire(const StringStamped& message, WireOf<StringStamped>::Type& wire);
void ToWire(const Joy& message, WireOf<Joy>::Type& wire);
void ToWire(const Image& message, WireOf<Image>::Type& wire);
void ToWire(const CompressedImage& message, WireOf<CompressedImage>::Type& wire);
void ToWire(const CameraInfo& message, WireOf<CameraInfo>::Type& wire);
void ToWire(const Text& message, WireOf<Text>::Type& wire);
void ToWire(const Flag& message, WireOf<Flag>::Type& wire);
void ToWire(const Signal& message, WireOf<Signal>::Type& wire);
void ToWire(const WrenchStamped& message, WireOf<WrenchStamped>::Type& wire);
void ToWire(const CartesianState& message, WireOf<CartesianState>::Type& wire);
void ToWire(const Number& message, WireOf<Number>::Type& wire);
void ToWire(const Matrix& message, WireOf<Matrix>::Type& wire);
void ToWire(const ForwardKinematicsQuery& message, WireOf<ForwardKinematicsQuery>::Type& wire);
void ToWire(const ForwardKinematicsAnswer& message, WireOf<ForwardKinematicsAnswer>::Type& wire);
void ToWire(const InverseKinematicsQuery& message, WireOf<InverseKinematicsQuery>::Type& wire);
void ToWire(const InverseKinematicsAnswer& message, WireOf<InverseKinematicsAnswer>::Type& wire);

void FromWire(const WireOf<PoseStamped>::Type& wire, PoseStamped& message);
void FromWire(const WireOf<TwistStamped>::Type& wire, TwistStamped& message);
void FromWire(const WireOf<JointState>::Type& wire, JointState& message);
void FromWire(const WireOf<OperatingState>::Type& wire, OperatingState& message);
void FromWire(const WireOf<StringStamped>::Type& wire, StringStamped& message);
void FromWire(const WireOf<Joy>::Type& wire, Joy& message);
void FromWire(const WireOf<Image>::Type& wire, Image& message);
void FromWire(const WireOf<CompressedImage>::Type& wire, CompressedImage& message);
void FromWire(const WireOf<CameraInfo>::Type& wire, CameraInfo& message);
void FromWire(const WireOf<Text>::Type& wire, Text& message);
void FromWire(const WireOf<Flag>::Type& wire, Flag& message);
void FromWire(const WireOf<Signal>::Type& wire, Signal& message);
void FromWire(const WireOf<WrenchStamped>::Type& wire, WrenchStamped& message);
void FromWire(const WireOf<CartesianState>::Type& wire, CartesianState& message);
void FromWire(const WireOf<Number>::Type& wire, Number& message);
void FromWire(const WireOf<Matrix>::Type& wire, Matrix& message);
void FromWire(const WireOf<ForwardKinematicsQuery>::Type& wire, ForwardKinematicsQuery& message);
void FromWire(const WireOf<ForwardKinematicsAnswer>::Type& wire, ForwardKinematicsAnswer& message);
void FromWire(const WireOf<InverseKinematicsQuery>::Type& wire, InverseKinematicsQuery& message);
void FromWire(const WireOf<InverseKinematicsAnswer>::Type& wire, InverseKinematicsAnswer& message);

}  // namespace dfr::dds::internal
