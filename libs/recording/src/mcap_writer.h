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

/// Writes the MCAP file of a recording. Messages accumulate in a chunk; each complete chunk is
/// written in one call with its checksum and indexes. The system keeps written data when the
/// process dies, so a killed process loses only the current chunk.
///
/// After a failed write (disk full), truncates the file to the last complete chunk and writes
/// nothing more; see error().
class McapWriter {
 public:
  /// Creates the file. @throws std::runtime_error naming the file and the remedy.
  McapWriter(const std::filesystem::path& path, const std::map<std::string, std::string>& metadata,
             std::string_view configuration, std::int64_t now_ns);
  ~McapWriter();
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  /// Adds a message to the chunk.
  void Message(Channel channel, std::uint32_t sequence, std::int64_t time_ns,
               std::string_view message);
  [[nodiscard]] std::size_t chunk_bytes() const noexcept { return chunk_.size(); }
  /// Writes the chunk unless it is empty. Returns false if writing failed.
  bool Flush();
  /// Writes the last chunk and the summary, and closes the file. Returns false if any write failed.
  bool Finish();

  /// Returns the system's error; empty if there was none.
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
  std::uint64_t position_ = 0;  // end of the complete records in the file
  std::uint32_t crc_ = 0;       // checksum of all preceding bytes
  std::string error_;
  std::string chunk_;
  std::array<std::vector<Index>, kChannels.size()> chunk_index_;
  std::array<std::uint64_t, kChannels.size()> messages_{};
  std::vector<Chunk> chunks_;
  std::string attachment_index_;
  std::string metadata_index_;
  std::string out_;  // a member, to reuse its memory
};

}  // namespace dfr::recording::internal
