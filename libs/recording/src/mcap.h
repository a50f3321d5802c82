#pragma once

#include <cstdint>
#include <string_view>

namespace dfr::recording::internal {

/// Magic bytes of an MCAP file (mcap.dev/spec) of format version 0.
inline constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);

/// Kinds of records. A record is its kind, an eight-byte size, and its content.
enum class Op : std::uint8_t {
  kHeader = 1,
  kFooter,
  kSchema,
  kChannel,
  kMessage,
  kChunk,
  kMessageIndex,
  kChunkIndex,
  kAttachment,
  kAttachmentIndex,
  kStatistics,
  kMetadata,
  kMetadataIndex,
  kSummaryOffset,
  kDataEnd,
};
inline constexpr std::size_t kRecordHead = 9;

inline constexpr std::string_view kLibrary = "dfr";
inline constexpr std::string_view kMetadataName = "dfr";
inline constexpr std::string_view kConfigurationName = "configuration";

}  // namespace dfr::recording::internal
