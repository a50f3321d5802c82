#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "dfr/recording/records.h"

namespace dfr::recording::internal {

/// The channels of a recording; as numbers they are both channel and schema in the file.
enum class Channel : std::uint16_t { kStep = 1, kTransition, kPicture, kNote, kArm };

struct ChannelInfo {
  Channel id;
  std::string_view topic;
  std::string_view type;    ///< As ROS 2 names it.
  std::string_view schema;  ///< Its definition ("ros2msg"), those of its members behind it.
};
extern const std::array<ChannelInfo, 5> kChannels;

/// A message of each channel, appended to `out`.
void Encode(const StepRecord& step, std::string& out);
void Encode(const TransitionRecord& transition, std::string& out);
void Encode(const ArmRecord& arm, std::string& out);
void EncodePicture(std::int64_t time_ns, std::string_view jpeg, std::string& out);
void EncodeNote(std::int64_t time_ns, std::string_view text, std::string& out);

/// The reverse. Stamps are those of the message in the file, not repeated here. False if `message`
/// is not what the schema says.
[[nodiscard]] bool Decode(std::string_view message, StepRecord& step);
[[nodiscard]] bool Decode(std::string_view message, TransitionRecord& transition);
[[nodiscard]] bool Decode(std::string_view message, ArmRecord& arm);
/// `offset` is where the JPEG file begins in the message.
[[nodiscard]] bool DecodePicture(std::string_view message, std::uint64_t& offset,
                                 std::uint64_t& size);
[[nodiscard]] bool DecodeNote(std::string_view message, std::string& text);

}  // namespace dfr::recording::internal
