#include "dfr/recording/read_recording.h"

#include <algorithm>
#include <charconv>
#include <cstddef>
#include <fstream>
#include <ios>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "bytes.h"
#include "channels.h"
#include "crc32.h"
#include "dfr/core/files/read_file.h"
#include "mcap.h"

namespace dfr::recording {
namespace {

using internal::ByteReader;
using internal::Channel;
using internal::kChannels;
using internal::kMagic;
using internal::kRecordHead;
using internal::Op;

// Reads a file sequentially, with a checksum of the bytes that Take() returns.
class File {
 public:
  explicit File(const std::filesystem::path& path) : name_(path.string()) {
    core::CheckPlainFile(path);
    // Reads specify size and position; a buffer would read the same bytes many times.
    in_.rdbuf()->pubsetbuf(nullptr, 0);
    in_.open(path, std::ios::binary | std::ios::ate);
    if (!in_) throw std::runtime_error("cannot read the log " + name_ + "; check that it exists");
    size_ = static_cast<std::uint64_t>(in_.tellg());
    in_.seekg(0);
  }

  [[nodiscard]] std::uint64_t left() const noexcept { return size_ - position_; }
  [[nodiscard]] std::uint64_t position() const noexcept { return position_; }
  [[nodiscard]] std::uint32_t crc() const noexcept { return crc_; }

  /// Returns `size` <= left() bytes at `at` without moving the position.
  std::string Peek(std::uint64_t at, std::uint64_t size) {
    std::string bytes(size, '\0');
    in_.seekg(static_cast<std::streamoff>(at));
    in_.read(bytes.data(), static_cast<std::streamsize>(size));
    if (!in_) throw std::runtime_error("cannot read the log " + name_ + " at byte " + At(at));
    return bytes;
  }
  std::string Take(std::uint64_t size) {
    std::string bytes = Peek(position_, size);
    position_ += size;
    crc_ = internal::Crc32(bytes, crc_);
    return bytes;
  }
  [[nodiscard]] bool EndsWithMagic() {
    return size_ >= 2 * kMagic.size() && Peek(size_ - kMagic.size(), kMagic.size()) == kMagic;
  }
  [[nodiscard]] std::uint64_t size() const noexcept { return size_; }
  /// Moves the position to `at`.
  void Seek(std::uint64_t at) noexcept { position_ = at; }

  [[noreturn]] void Damaged(std::uint64_t at, const std::string& what) const {
    throw std::runtime_error("the log " + name_ + " is damaged at byte " + At(at) + ": " + what);
  }
  [[noreturn]] void Foreign(const std::string& what) const {
    throw std::runtime_error(name_ + " is not a log of this program: " + what);
  }

 private:
  static std::string At(std::uint64_t at) { return std::to_string(at); }

  std::string name_;
  std::ifstream in_;
  std::uint64_t size_ = 0;
  std::uint64_t position_ = 0;
  std::uint32_t crc_ = 0;
};

class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : file_(path) {}

  Recording Read() {
    if (file_.left() < kMagic.size() || file_.Take(kMagic.size()) != kMagic) {
      file_.Foreign("it does not begin like an MCAP file");
    }
    complete_ = file_.EndsWithMagic();
    while (Record()) {
    }
    if (!header_) file_.Damaged(file_.position(), "it is cut off before its header");
    if (complete_ && !recording_.finished) {
      Suffered(file_.position(), "records before its end are missing");
    }
    return std::move(recording_);
  }

 private:
  // Returns false at the end of the readable data.
  bool Record() {
    const std::uint64_t at = file_.position();
    if (file_.left() < kRecordHead) return false;
    const std::uint32_t crc = file_.crc();
    std::string head = file_.Peek(at, kRecordHead);
    ByteReader fields(head);
    const auto op = static_cast<Op>(fields.Number<std::uint8_t>());
    const auto size = fields.Number<std::uint64_t>();
    if (size > file_.left() - kRecordHead) {
      const char* const what = "a record is larger than the file";
      if (complete_) return GoOn(at, what);
      // A truncated file ends here. If a later chunk exists, the size is damaged instead.
      if (!head_ || !FindChunk(at)) return false;
      Suffered(at, what);
      return true;
    }
    if (!header_ && op != Op::kHeader) file_.Damaged(at, "its header is missing");
    // Rejects a record before reading its content, in which GoOn() looks for the next chunk.
    const bool of_head = op == Op::kHeader || op == Op::kSchema || op == Op::kChannel ||
                         op == Op::kMetadata || op == Op::kAttachment;
    if (head_ && of_head)
      return GoOn(at, "a record from the beginning of a log does not belong here");
    if (!of_head && op != Op::kChunk && op != Op::kMessageIndex && op != Op::kDataEnd) {
      return GoOn(at, "unexpected record of kind " + std::to_string(static_cast<unsigned>(op)));
    }
    if (op == Op::kDataEnd && size != sizeof crc) return GoOn(at, "its end record is malformed");
    file_.Take(kRecordHead);
    const std::uint64_t content_at = file_.position();
    const std::string content = file_.Take(size);
    switch (op) {
      case Op::kHeader:
        Header(content);
        return true;
      case Op::kSchema:
        Schema(at, content);
        return true;
      case Op::kChannel:
        ChannelRecord(at, content);
        return true;
      case Op::kMetadata:
        Metadata(at, content);
        return true;
      case Op::kAttachment:
        Attachment(at, content);
        return true;
      case Op::kChunk:
        Chunk(content_at, content);
        return true;
      case Op::kDataEnd:
        // A damaged chunk invalidates this checksum, too.
        if (recording_.damage.empty() && ByteReader(content).Number<std::uint32_t>() != crc) {
          Suffered(at, "the checksum of all data does not match, although those of all chunks do");
        }
        Summary();
        return false;
      default:  // the index of a chunk's messages
        return true;
    }
  }

  void Suffered(std::uint64_t at, const std::string& what) {
    recording_.damage.push_back("damaged at byte " + std::to_string(at) + ": " + what);
  }

  // Skips a record with a damaged kind or size. Damage before the first chunk is fatal.
  bool GoOn(std::uint64_t at, const std::string& what) {
    if (!head_) file_.Damaged(at, what);
    Suffered(at, what);
    return FindChunk(at);
  }

  // Moves to the first chunk after `at`, or to the end of all chunks. Returns false if neither
  // exists.
  bool FindChunk(std::uint64_t at) {
    constexpr std::uint64_t kHead = kRecordHead + 40;  // size of a chunk's head, before its records
    // The window starts small and doubles: frequent damage must not cost reads of a mebibyte each.
    std::uint64_t window_size = 256;
    for (std::uint64_t base = at + 1; base + kHead <= file_.size(); base += window_size - kHead) {
      window_size = std::min<std::uint64_t>(2 * window_size, 1 << 20);
      const std::string window = file_.Peek(base, std::min(window_size, file_.size() - base));
      for (std::size_t i = 0; i + kHead <= window.size(); ++i) {
        const std::string_view here = std::string_view(window).substr(i, kHead);
        if (!ChunkHead(here, file_.size() - base - i) && !DataEnd(here)) continue;
        file_.Seek(base + i);
        return true;
      }
    }
    return false;
  }

  // Returns true if `bytes` begin with the head of a chunk. `left` bytes follow in the file.
  static bool ChunkHead(std::string_view bytes, std::uint64_t left) {
    if (bytes[0] != static_cast<char>(Op::kChunk)) return false;
    ByteReader reader(bytes);
    reader.Number<std::uint8_t>();
    const auto size = reader.Number<std::uint64_t>();
    reader.Number<std::uint64_t>();
    reader.Number<std::uint64_t>();
    const auto whole = reader.Number<std::uint64_t>();
    reader.Number<std::uint32_t>();
    const auto compression = reader.Number<std::uint32_t>();
    const auto records = reader.Number<std::uint64_t>();
    return compression == 0 && whole == records && records <= left - kRecordHead - 40 &&
           size == records + 40;
  }

  static bool DataEnd(std::string_view bytes) {
    if (bytes[0] != static_cast<char>(Op::kDataEnd)) return false;
    ByteReader reader(bytes);
    reader.Number<std::uint8_t>();
    const bool sized = reader.Number<std::uint64_t>() == sizeof(std::uint32_t);
    reader.Number<std::uint32_t>();
    return sized && reader.Number<std::uint8_t>() == static_cast<std::uint8_t>(Op::kSchema);
  }

  void Header(std::string_view content) {
    ByteReader reader(content);
    reader.Text();
    const std::string_view library = reader.Text();
    if (!reader.ok() || library != internal::kLibrary) {
      file_.Foreign("it was written by '" + std::string(library) + "'");
    }
    header_ = true;
  }

  void Schema(std::uint64_t at, std::string_view content) {
    ByteReader reader(content);
    const auto& info = Info(at, reader.Number<std::uint16_t>());
    const bool same =
        reader.Text() == info.type && reader.Text() == "ros2msg" && reader.Text() == info.schema;
    if (!same || !reader.at_end()) {
      file_.Damaged(at, "the schema of " + std::string(info.topic) +
                            " differs from the one that this version writes");
    }
  }

  void ChannelRecord(std::uint64_t at, std::string_view content) {
    ByteReader reader(content);
    const auto id = reader.Number<std::uint16_t>();
    const auto& info = Info(at, id);
    if (reader.Number<std::uint16_t>() != id || reader.Text() != info.topic ||
        reader.Text() != "cdr" || !reader.ok()) {
      file_.Damaged(at, "channel " + std::to_string(id) + " is not " + std::string(info.topic));
    }
  }

  const internal::ChannelInfo& Info(std::uint64_t at, std::uint16_t id) const {
    if (id < 1 || id > kChannels.size()) {
      file_.Damaged(at, "there is no channel " + std::to_string(id));
    }
    return kChannels[id - 1U];
  }

  void Metadata(std::uint64_t at, std::string_view content) {
    ByteReader reader(content);
    const bool ours = reader.Text() == internal::kMetadataName;
    ByteReader entries(reader.Text());
    if (!ours || !reader.ok()) file_.Damaged(at, "the metadata are incomplete");
    RecordingMetadata& metadata = recording_.metadata;
    while (!entries.at_end()) {
      const std::string key(entries.Text());
      std::string value(entries.Text());
      if (!entries.ok()) file_.Damaged(at, "the metadata are incomplete");
      if (key == "program") {
        metadata.program = value;
      } else if (key == "commit") {
        metadata.commit = value;
      } else if (key == "model") {
        metadata.model = value;
      } else if (key == "model_checksum") {
        metadata.model_checksum = value;
      } else if (key == "method") {
        metadata.method = value;
      } else if (key == "seed") {
        const auto [end, error] =
            std::from_chars(value.data(), value.data() + value.size(), metadata.seed);
        if (error != std::errc() || end != value.data() + value.size()) {
          file_.Damaged(at, "the seed is not a number: '" + value + "'");
        }
      } else {
        metadata.more[key] = std::move(value);
      }
    }
  }

  void Attachment(std::uint64_t at, std::string_view content) {
    ByteReader reader(content);
    reader.Number<std::uint64_t>();
    reader.Number<std::uint64_t>();
    const bool configuration = reader.Text() == internal::kConfigurationName;
    reader.Text();
    const std::string_view text = reader.Bytes(reader.Number<std::uint64_t>());
    const std::uint32_t crc = internal::Crc32(content.substr(0, reader.position()));
    if (reader.Number<std::uint32_t>() != crc || !reader.ok() || !configuration) {
      file_.Damaged(at, "the checksum of the configuration does not match");
    }
    recording_.metadata.configuration = text;
    head_ = true;
  }

  void Chunk(std::uint64_t at, std::string_view content) {
    ByteReader reader(content);
    reader.Number<std::uint64_t>();
    reader.Number<std::uint64_t>();
    const auto size = reader.Number<std::uint64_t>();
    const auto crc = reader.Number<std::uint32_t>();
    const bool plain = reader.Text().empty();
    const std::string_view records = reader.Bytes(reader.Number<std::uint64_t>());
    if (!reader.ok() || !plain || size != records.size() || internal::Crc32(records) != crc) {
      Suffered(at, "the checksum of a chunk of " + std::to_string(content.size()) +
                       " bytes does not match; its contents are lost");
      return;
    }
    const std::uint64_t records_at =
        at + static_cast<std::uint64_t>(records.data() - content.data());
    ByteReader inner(records);
    while (!inner.at_end()) {
      const std::uint64_t record_at = records_at + inner.position();
      const auto op = static_cast<Op>(inner.Number<std::uint8_t>());
      const std::string_view message = inner.Bytes(inner.Number<std::uint64_t>());
      if (!inner.ok() || op != Op::kMessage) file_.Damaged(record_at, "there is no message");
      Message(record_at + kRecordHead, message);
    }
  }

  void Message(std::uint64_t at, std::string_view content) {
    ByteReader reader(content);
    const auto& info = Info(at, reader.Number<std::uint16_t>());
    const auto sequence = reader.Number<std::uint32_t>();
    const auto time_ns = static_cast<std::int64_t>(reader.Number<std::uint64_t>());
    reader.Number<std::uint64_t>();
    const std::uint64_t data_at = at + reader.position();
    const std::string_view data = reader.Bytes(content.size() - reader.position());
    bool good = reader.ok();
    switch (info.id) {
      case Channel::kStep: {
        StepRecord step;
        step.time_ns = time_ns;
        good = good && internal::Decode(data, step);
        recording_.steps.push_back(step);
        recording_.step_numbers.push_back(sequence);
        CountDropped(sequence, steps_);
        break;
      }
      case Channel::kTransition: {
        TransitionRecord transition;
        transition.time_ns = time_ns;
        good = good && internal::Decode(data, transition);
        recording_.transitions.push_back(transition);
        CountDropped(sequence, transitions_);
        break;
      }
      case Channel::kArm: {
        ArmRecord arm;
        arm.time_ns = time_ns;
        good = good && internal::Decode(data, arm);
        recording_.arm.push_back(arm);
        CountDropped(sequence, arms_);
        break;
      }
      case Channel::kPicture: {
        RecordedPicture picture{.time_ns = time_ns, .sequence = sequence, .offset = 0, .size = 0};
        good = good && internal::DecodePicture(data, picture.offset, picture.size);
        picture.offset += data_at;
        recording_.pictures.push_back(picture);
        break;
      }
      case Channel::kNote: {
        RecordedNote note{.time_ns = time_ns, .text = {}};
        good = good && internal::DecodeNote(data, note.text);
        recording_.notes.push_back(std::move(note));
        break;
      }
    }
    if (!good) {
      file_.Damaged(at, "a message of " + std::string(info.topic) + " does not match its schema");
    }
  }

  // Gaps in the numbering are dropped messages. A number that does not increase leaves no gap.
  void CountDropped(std::uint32_t sequence, std::uint32_t& last) {
    if (sequence > last) recording_.dropped_records += sequence - last - 1;
    last = sequence;
  }

  // Verifies the checksum of the summary and ignores its content, which repeats the file's.
  void Summary() {
    constexpr std::uint64_t kFooter = kRecordHead + 20;
    if (!complete_) return;
    recording_.finished = true;
    const std::uint64_t at = file_.position();
    if (file_.left() < kFooter + kMagic.size()) {
      Suffered(at, "its summary is missing");
      return;
    }
    const std::string summary = file_.Take(file_.left() - kMagic.size());
    const std::string_view footer = std::string_view(summary).substr(summary.size() - kFooter);
    const std::string_view covered = std::string_view(summary).substr(0, summary.size() - 4);
    ByteReader reader(footer);
    const auto op = static_cast<Op>(reader.Number<std::uint8_t>());
    reader.Number<std::uint64_t>();
    const auto start = reader.Number<std::uint64_t>();
    reader.Number<std::uint64_t>();
    if (op != Op::kFooter || start != at ||
        reader.Number<std::uint32_t>() != internal::Crc32(covered)) {
      Suffered(at, "the checksum of its summary does not match");
    }
  }

  File file_;
  Recording recording_;
  bool complete_ = false;  // the file ends with the magic
  bool header_ = false;
  std::uint32_t steps_ = 0;
  std::uint32_t transitions_ = 0;
  std::uint32_t arms_ = 0;
  bool head_ = false;  // everything before the chunks has been read
};

}  // namespace

Recording ReadRecording(const std::filesystem::path& path) { return Reader(path).Read(); }

}  // namespace dfr::recording
