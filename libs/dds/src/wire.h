#pragma once

#include "dfr/dds/messages.h"
#include "ros2_types.h"
#include "ros2_typesPubSubTypes.h"

namespace dfr::dds::internal {

/// The generated type behind each message.
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
#undef DFR_WIRE

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

}  // namespace dfr::dds::internal
