#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "channels.h"
#include "mcap.h"

namespace dfr::recording::internal {

/// Writes the MCAP file of a recording: messages gather in a chunk, and each chunk goes to the file
/// whole, with its checksum and its indexes, in one call. The system keeps what was written when
/// the process dies, so that a killed one loses just the chunk it was gathering.
///
/// Once the file does not take something (disk full), it is cut back to the last whole chunk and
/// nothing more is written; error() tells.
class McapWriter {
 public:
  /// Makes the file. @throws std::runtime_error naming it and the remedy.
  McapWriter(const std::filesystem::path& path, const std::map<std::string, std::string>& metadata,
             std::string_view configuration, std::int64_t now_ns);
  ~McapWriter();
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  /// Adds a message to the chunk.
  void Message(Channel channel, std::uint32_t sequence, std::int64_t time_ns,
               std::string_view message);
  [[nodiscard]] std::size_t chunk_bytes() const noexcept { return chunk_.size(); }
  /// Writes the chunk, if there is something in it. False if the file did not take it.
  bool Flush();
  /// Writes the rest, and closes. False if the file did not take it, now or before.
  bool Finish();

  /// What the system said when it refused something; empty if it never did.
  [[nodiscard]] const std::string& error() const noexcept { return error_; }

 private:
  struct Index {
    std::int64_t time_ns;
    std::uint64_t offset;
  };
  struct Chunk {
    std::int64_t start_ns;
    std::int64_t end_ns;
    std::uint64_t offset;
    std::uint64_t length;
    std::map<std::uint16_t, std::uint64_t> index_offsets;
    std::uint64_t index_length;
    std::uint64_t records_size;
  };

  static void AppendSchemas(std::string& out);
  static void AppendChannels(std::string& out);
  void AppendSummary(std::string& out, std::uint64_t start) const;
  bool Write(std::string_view bytes);

  int file_ = -1;
  std::uint64_t position_ = 0;  // whole records in the file end here
  std::uint32_t crc_ = 0;       // of all up to there
  std::string error_;
  std::string chunk_;
  std::array<std::vector<Index>, kChannels.size()> chunk_index_;
  std::array<std::uint64_t, kChannels.size()> messages_{};
  std::vector<Chunk> chunks_;
  std::string attachment_index_;
  std::string metadata_index_;
  std::string out_;  // kept for its memory
};

}  // namespace dfr::recording::internal
