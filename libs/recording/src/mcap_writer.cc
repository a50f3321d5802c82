#include "mcap_writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <tuple>

#include "bytes.h"
#include "crc32.h"

namespace dfr::recording::internal {
namespace {

// Writes a record and fills in its size once the content is complete.
class RecordWriter : public ByteWriter {
 public:
  RecordWriter(Op op, std::string& out) : ByteWriter(out) {
    Number(static_cast<std::uint8_t>(op));
    size_at_ = position();
    Number(std::uint64_t{0});
  }
  ~RecordWriter() { NumberAt(size_at_, std::uint64_t{position() - size_at_ - 8}); }
  RecordWriter(const RecordWriter&) = delete;
  RecordWriter& operator=(const RecordWriter&) = delete;

 private:
  std::size_t size_at_ = 0;
};

std::size_t IndexOf(Channel channel) { return static_cast<std::size_t>(channel) - 1; }

std::uint64_t Unsigned(std::int64_t time_ns) { return static_cast<std::uint64_t>(time_ns); }

std::string Refused(int error) {
  switch (error) {
    case ENOSPC:
    case EDQUOT:
      return "the disk is full (" + std::string(std::strerror(error)) + ")";
    case EFBIG:
      return "the file cannot grow further (" + std::string(std::strerror(error)) + ")";
    default:
      return std::strerror(error);
  }
}

}  // namespace

McapWriter::McapWriter(const std::filesystem::path& path,
                       const std::map<std::string, std::string>& metadata,
                       std::string_view configuration, std::int64_t now_ns) {
  file_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (file_ < 0) {
    const int error = errno;
    std::string message = "cannot create the log " + path.string() + ": " + std::strerror(error);
    if (error == EEXIST) message += "; choose another name, or move that file away";
    if (error == ENOENT) message += "; create its folder first";
    if (error == EACCES || error == EROFS) message += "; choose a folder that you may write to";
    throw std::runtime_error(message);
  }
  std::string head(kMagic);
  {
    RecordWriter header(Op::kHeader, head);
    header.Text("");  // profile
    header.Text(kLibrary);
  }
  AppendSchemas(head);
  AppendChannels(head);
  const std::uint64_t metadata_at = head.size();
  {
    std::string entries;
    ByteWriter writer(entries);
    for (const auto& [key, value] : metadata) {
      writer.Text(key);
      writer.Text(value);
    }
    RecordWriter record(Op::kMetadata, head);
    record.Text(kMetadataName);
    record.Text(entries);
  }
  {
    RecordWriter record(Op::kMetadataIndex, metadata_index_);
    record.Number(metadata_at);
    record.Number(std::uint64_t{head.size() - metadata_at});
    record.Text(kMetadataName);
  }
  const std::uint64_t attachment_at = head.size();
  {
    RecordWriter record(Op::kAttachment, head);
    record.Number(Unsigned(now_ns));
    record.Number(Unsigned(now_ns));
    record.Text(kConfigurationName);
    record.Text("text/plain");
    record.Number(std::uint64_t{configuration.size()});
    record.Bytes(configuration);
    record.Number(Crc32(std::string_view(head).substr(attachment_at + kRecordHead)));
  }
  {
    RecordWriter record(Op::kAttachmentIndex, attachment_index_);
    record.Number(attachment_at);
    record.Number(std::uint64_t{head.size() - attachment_at});
    record.Number(Unsigned(now_ns));
    record.Number(Unsigned(now_ns));
    record.Number(std::uint64_t{configuration.size()});
    record.Text(kConfigurationName);
    record.Text("text/plain");
  }
  if (!Write(head)) {
    ::close(file_);
    ::unlink(path.c_str());
    throw std::runtime_error("cannot write the log " + path.string() + ": " + error_ +
                             "; choose a disk with more space");
  }
}

McapWriter::~McapWriter() {
  if (file_ >= 0) ::close(file_);
}

void McapWriter::AppendSchemas(std::string& out) {
  for (const ChannelInfo& channel : kChannels) {
    RecordWriter record(Op::kSchema, out);
    record.Number(static_cast<std::uint16_t>(channel.id));
    record.Text(channel.type);
    record.Text("ros2msg");
    record.Text(channel.schema);
  }
}

void McapWriter::AppendChannels(std::string& out) {
  for (const ChannelInfo& channel : kChannels) {
    RecordWriter record(Op::kChannel, out);
    record.Number(static_cast<std::uint16_t>(channel.id));
    record.Number(static_cast<std::uint16_t>(channel.id));
    record.Text(channel.topic);
    record.Text("cdr");
    record.Text("");  // no metadata
  }
}

void McapWriter::Message(Channel channel, std::uint32_t sequence, std::int64_t time_ns,
                         std::string_view message) {
  if (!error_.empty()) return;
  chunk_index_[IndexOf(channel)].push_back({time_ns, chunk_.size()});
  RecordWriter record(Op::kMessage, chunk_);
  record.Number(static_cast<std::uint16_t>(channel));
  record.Number(sequence);
  record.Number(Unsigned(time_ns));
  record.Number(Unsigned(time_ns));
  record.Bytes(message);
}

bool McapWriter::Flush() {
  if (!error_.empty()) return false;
  if (chunk_.empty()) return true;
  Chunk chunk{.start_ns = std::numeric_limits<std::int64_t>::max(),
              .end_ns = std::numeric_limits<std::int64_t>::min(),
              .offset = position_,
              .length = 0,
              .index_offsets = {},
              .index_length = 0,
              .records_size = chunk_.size()};
  for (const std::vector<Index>& entries : chunk_index_) {
    for (const Index& entry : entries) {
      chunk.start_ns = std::min(chunk.start_ns, entry.time_ns);
      chunk.end_ns = std::max(chunk.end_ns, entry.time_ns);
    }
  }
  out_.clear();
  {
    RecordWriter record(Op::kChunk, out_);
    record.Number(Unsigned(chunk.start_ns));
    record.Number(Unsigned(chunk.end_ns));
    record.Number(std::uint64_t{chunk_.size()});
    record.Number(Crc32(chunk_));
    record.Text("");  // not compressed
    record.Number(std::uint64_t{chunk_.size()});
    record.Bytes(chunk_);
  }
  chunk.length = out_.size();
  for (const ChannelInfo& channel : kChannels) {
    std::vector<Index>& entries = chunk_index_[IndexOf(channel.id)];
    if (entries.empty()) continue;
    chunk.index_offsets[static_cast<std::uint16_t>(channel.id)] = position_ + out_.size();
    RecordWriter record(Op::kMessageIndex, out_);
    record.Number(static_cast<std::uint16_t>(channel.id));
    record.Number(static_cast<std::uint32_t>(16 * entries.size()));
    for (const Index& entry : entries) {
      record.Number(Unsigned(entry.time_ns));
      record.Number(entry.offset);
    }
  }
  chunk.index_length = out_.size() - chunk.length;
  const bool written = Write(out_);
  for (std::size_t i = 0; i < kChannels.size(); ++i) {
    if (written) messages_[i] += chunk_index_[i].size();
    chunk_index_[i].clear();
  }
  chunk_.clear();
  if (written) chunks_.push_back(std::move(chunk));
  return written;
}

void McapWriter::AppendSummary(std::string& out, std::uint64_t start) const {
  const std::size_t base = out.size();
  struct Group {
    Op op;
    std::uint64_t start;
    std::uint64_t length;
  };
  std::vector<Group> groups;
  std::size_t begin = base;
  const auto end_group = [&](Op op) {
    groups.push_back({op, start + begin - base, out.size() - begin});
    begin = out.size();
  };
  AppendSchemas(out);
  end_group(Op::kSchema);
  AppendChannels(out);
  end_group(Op::kChannel);
  {
    RecordWriter record(Op::kStatistics, out);
    std::uint64_t total = 0;
    for (const std::uint64_t count : messages_) total += count;
    std::int64_t first = chunks_.empty() ? 0 : chunks_.front().start_ns;
    std::int64_t last = chunks_.empty() ? 0 : chunks_.front().end_ns;
    for (const Chunk& chunk : chunks_) {
      first = std::min(first, chunk.start_ns);
      last = std::max(last, chunk.end_ns);
    }
    record.Number(total);
    record.Number(static_cast<std::uint16_t>(kChannels.size()));
    record.Number(static_cast<std::uint32_t>(kChannels.size()));
    record.Number(std::uint32_t{1});  // attachments
    record.Number(std::uint32_t{1});  // metadata
    record.Number(static_cast<std::uint32_t>(chunks_.size()));
    record.Number(Unsigned(first));
    record.Number(Unsigned(last));
    record.Number(static_cast<std::uint32_t>(10 * kChannels.size()));
    for (std::size_t i = 0; i < kChannels.size(); ++i) {
      record.Number(static_cast<std::uint16_t>(kChannels[i].id));
      record.Number(messages_[i]);
    }
  }
  end_group(Op::kStatistics);
  for (const Chunk& chunk : chunks_) {
    RecordWriter record(Op::kChunkIndex, out);
    record.Number(Unsigned(chunk.start_ns));
    record.Number(Unsigned(chunk.end_ns));
    record.Number(chunk.offset);
    record.Number(chunk.length);
    record.Number(static_cast<std::uint32_t>(10 * chunk.index_offsets.size()));
    for (const auto& [channel, offset] : chunk.index_offsets) {
      record.Number(channel);
      record.Number(offset);
    }
    record.Number(chunk.index_length);
    record.Text("");  // not compressed
    record.Number(chunk.records_size);
    record.Number(chunk.records_size);
  }
  if (!chunks_.empty()) end_group(Op::kChunkIndex);
  out += attachment_index_;
  end_group(Op::kAttachmentIndex);
  out += metadata_index_;
  end_group(Op::kMetadataIndex);

  const std::uint64_t offsets_start = start + out.size() - base;
  for (const Group& group : groups) {
    RecordWriter record(Op::kSummaryOffset, out);
    record.Number(static_cast<std::uint8_t>(group.op));
    record.Number(group.start);
    record.Number(group.length);
  }
  RecordWriter footer(Op::kFooter, out);
  // The checksum covers the record's size, which ~RecordWriter() would write too late.
  footer.Number(start);
  footer.Number(offsets_start);
  footer.NumberAt(out.size() - 24, std::uint64_t{20});
  footer.Number(Crc32(std::string_view(out).substr(base)));
}

bool McapWriter::Finish() {
  if (file_ < 0) return error_.empty();
  if (Flush()) {
    std::string end;
    {
      RecordWriter record(Op::kDataEnd, end);
      record.Number(crc_);
    }
    const std::uint64_t summary_at = position_ + end.size();
    AppendSummary(end, summary_at);
    end += kMagic;
    // Some file systems report a full disk only now.
    if (Write(end) && ::fsync(file_) != 0 && errno != EINVAL) error_ = Refused(errno);
  }
  if (::close(file_) != 0 && error_.empty()) error_ = Refused(errno);
  file_ = -1;
  return error_.empty();
}

bool McapWriter::Write(std::string_view bytes) {
  std::string_view left = bytes;
  while (!left.empty()) {
    const ssize_t written = ::write(file_, left.data(), left.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) {
      error_ = Refused(written == 0 ? ENOSPC : errno);
      // Readers stop before an incomplete record, so a failed truncation is harmless.
      std::ignore = ::ftruncate(file_, static_cast<off_t>(position_));
      return false;
    }
    left.remove_prefix(static_cast<std::size_t>(written));
  }
  position_ += bytes.size();
  crc_ = Crc32(bytes, crc_);
  return true;
}

}  // namespace dfr::recording::internal
