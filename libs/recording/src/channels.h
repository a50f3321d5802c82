#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "dfr/recording/records.h"

namespace dfr::recording::internal {

/// Channels of a recording. Their values are both channel and schema ids in the file.
enum class Channel : std::uint16_t { kStep = 1, kTransition, kPicture, kNote, kArm };

struct ChannelInfo {
  Channel id;
  std::string_view topic;
  std::string_view type;    ///< ROS 2 type name.
  std::string_view schema;  ///< Definition ("ros2msg") of the type, then of its members' types.
};
extern const std::array<ChannelInfo, 5> kChannels;

/// Appends the encoded message to `out`.
void Encode(const StepRecord& step, std::string& out);
void Encode(const TransitionRecord& transition, std::string& out);
void Encode(const ArmRecord& arm, std::string& out);
void EncodePicture(std::int64_t time_ns, std::string_view jpeg, std::string& out);
void EncodeNote(std::int64_t time_ns, std::string_view text, std::string& out);

/// Inverse of Encode(), except that it skips the time stamp, which MCAP also stores. Returns false
/// if `message` does not match the schema.
[[nodiscard]] bool Decode(std::string_view message, StepRecord& step);
[[nodiscard]] bool Decode(std::string_view message, TransitionRecord& transition);
[[nodiscard]] bool Decode(std::string_view message, ArmRecord& arm);
/// Sets `offset` to the start of the JPEG data in the message.
[[nodiscard]] bool DecodePicture(std::string_view message, std::uint64_t& offset,
                                 std::uint64_t& size);
[[nodiscard]] bool DecodeNote(std::string_view message, std::string& text);

}  // namespace dfr::recording::internal
