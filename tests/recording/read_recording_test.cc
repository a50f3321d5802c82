#include "dfr/recording/read_recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>

#include "dfr/core/random.h"
#include "dfr/recording/recorder.h"
#include "tests/recording/example.h"
#include "tests/recording/hand_clock.h"
#include "tests/recording/same.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::recording {
namespace {

constexpr std::uint32_t kSteps = 12;

std::string Load(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

void Save(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

// Writes a small file of two chunks and returns its bytes.
std::string SmallFile(const test::TempFolder& folder) {
  test::RecorderHandClock clock;
  Recorder recorder(folder / "small.mcap", test::ExampleMetadata(), {.clock = &clock});
  for (std::uint32_t i = 0; i < kSteps / 2; ++i) recorder.Record(test::ExampleStep(i));
  recorder.Transition(test::ExampleTransition(0));
  recorder.Arm(test::ExampleArm(0));
  clock.Pass(200);
  for (std::uint32_t i = kSteps / 2; i < kSteps; ++i) recorder.Record(test::ExampleStep(i));
  recorder.Arm(test::ExampleArm(1));
  recorder.Picture(test::ExamplePicture(0, test::ExamplePixels(0)));
  recorder.Finish();
  return Load(folder / "small.mcap");
}

// Expects that each message of the recording equals the message that was written.
void ExpectPart(const Recording& recording) {
  ASSERT_LE(recording.steps.size(), kSteps);
  ASSERT_EQ(recording.steps.size(), recording.step_numbers.size());
  std::uint32_t last = 0;
  for (std::size_t i = 0; i < recording.steps.size(); ++i) {
    const std::uint32_t number = recording.step_numbers[i];
    ASSERT_GT(number, last);
    last = number;
    ASSERT_TRUE(test::Same(recording.steps[i], test::ExampleStep(number - 1)));
  }
  ASSERT_LE(recording.transitions.size(), 1U);
  if (!recording.transitions.empty()) {
    ASSERT_TRUE(test::Same(recording.transitions[0], test::ExampleTransition(0)));
  }
  ASSERT_LE(recording.arm.size(), 2U);
  for (const ArmRecord& arm : recording.arm) {
    const bool first = arm.time_ns == test::ExampleArm(0).time_ns;
    ASSERT_TRUE(test::Same(arm, test::ExampleArm(first ? 0 : 1)));
  }
}

TEST(ReadRecordingTest, NumbersThatDecreaseAreNotDroppedMessages) {
  const test::TempFolder folder;
  std::string bytes = SmallFile(folder);
  constexpr std::size_t kMagicSize = 8;
  constexpr char kChunk = 6;
  std::size_t at = kMagicSize;
  const auto size = [&] {
    std::uint64_t content = 0;
    std::memcpy(&content, bytes.data() + at + 1, sizeof(content));
    return static_cast<std::size_t>(content) + 1 + sizeof(content);
  };
  while (bytes[at] != kChunk) at += size();
  const std::string chunk = bytes.substr(at, size());
  while (bytes[at] == kChunk) at += size();
  bytes.insert(at, chunk);
  Save(folder / "twice.mcap", bytes);
  const Recording recording = ReadRecording(folder / "twice.mcap");
  EXPECT_EQ(recording.steps.size(), kSteps + kSteps / 2);
  EXPECT_EQ(recording.dropped_records, 0U);
}

TEST(ReadRecordingTest, AFileCutOffAnywhereGivesItsCompleteRecords) {
  const test::TempFolder folder;
  const std::string whole = SmallFile(folder);
  Save(folder / "cut", whole);
  std::size_t least = kSteps;
  std::size_t refused = 0;
  // Tests every size up to 100 bytes, and every eleventh size above.
  for (std::size_t size = whole.size() - 1; size + 1 > 0; size -= size > 100 ? 11 : 1) {
    SCOPED_TRACE(size);
    std::filesystem::resize_file(folder / "cut", size);
    try {
      const Recording recording = ReadRecording(folder / "cut");
      EXPECT_FALSE(recording.finished);
      ExpectPart(recording);
      EXPECT_TRUE(recording.damage.empty());
      // A shorter file contains at most as many steps.
      EXPECT_LE(recording.steps.size(), least);
      if (size == whole.size() - 1) {
        EXPECT_EQ(recording.steps.size(), kSteps);
      }
      least = recording.steps.size();
    } catch (const std::runtime_error& e) {
      ++refused;
      EXPECT_THAT(e.what(), testing::HasSubstr((folder / "cut").string()));
    }
  }
  EXPECT_EQ(least, 0U);
  // Only files that end within the magic (8 bytes) or the header (9 + 4 + 4 + 3) are rejected.
  EXPECT_EQ(refused, 28U);
  EXPECT_TRUE(ReadRecording(folder / "small.mcap").finished);
}

// A changed byte is detected and reported, and only the messages of its chunk are lost.
TEST(ReadRecordingTest, AChangedByteLosesOnlyItsChunk) {
  const test::TempFolder folder;
  const std::string whole = SmallFile(folder);
  core::Random random(1);
  int unseen = 0;
  int refused = 0;
  int lost = 0;
  Save(folder / "changed", whole);
  std::fstream file(folder / "changed", std::ios::in | std::ios::out | std::ios::binary);
  const auto put = [&](std::size_t at, char byte) {
    file.seekp(static_cast<std::streamoff>(at));
    file.put(byte).flush();
  };
  // Tests each byte of the magic at the end, and every ninth byte before it.
  for (std::size_t at = 0; at < whole.size(); at += at + 17 <= whole.size() ? 9 : 1) {
    SCOPED_TRACE(at);
    put(at, static_cast<char>(whole[at] ^ static_cast<char>(1 + random.Below(255))));
    try {
      const Recording recording = ReadRecording(folder / "changed");
      ExpectPart(recording);
      // Damage of one chunk does not affect the other chunk.
      EXPECT_GE(recording.steps.size(), kSteps / 2);
      EXPECT_GE(recording.arm.size(), 1U);
      const bool whole_content = recording.steps.size() == kSteps &&
                                 recording.transitions.size() == 1 && recording.arm.size() == 2 &&
                                 recording.pictures.size() == 1;
      if (recording.damage.empty()) {
        ++unseen;
        EXPECT_TRUE(whole_content);
        EXPECT_FALSE(recording.finished);
        EXPECT_EQ(recording.metadata, test::ExampleMetadata());
      } else {
        EXPECT_THAT(recording.damage[0], testing::HasSubstr("damaged at byte "));
        lost += whole_content ? 0 : 1;
      }
    } catch (const std::runtime_error& e) {
      EXPECT_THAT(e.what(), testing::HasSubstr((folder / "changed").string()));
      ++refused;
    }
    put(at, whole[at]);
  }
  // A change of one of the last eight bytes, the magic, makes the file incomplete, not damaged.
  EXPECT_EQ(unseen, 8);
  // The content that a reader must trust precedes the first chunk: header, types, metadata,
  // configuration.
  EXPECT_GT(refused, 0);
  EXPECT_LT(static_cast<std::size_t>(refused), whole.size() / 2);
  EXPECT_GT(lost, 100);
}

// The size of the first chunk has a changed bit, and the process was killed.
TEST(ReadRecordingTest, ADamagedSizeInAnUnfinishedFileLosesOnlyItsChunk) {
  const test::TempFolder folder;
  std::string bytes = SmallFile(folder);
  constexpr std::size_t kMagicSize = 8;
  bytes.resize(bytes.size() - kMagicSize);
  std::size_t at = kMagicSize;
  while (bytes[at] != 6) {
    std::uint64_t size = 0;
    std::memcpy(&size, &bytes[at + 1], sizeof size);
    at += 9 + size;
  }
  bytes[at + 8] = '\x40';
  Save(folder / "killed", bytes);
  const Recording recording = ReadRecording(folder / "killed");
  EXPECT_FALSE(recording.finished);
  ExpectPart(recording);
  EXPECT_EQ(recording.steps.size(), kSteps / 2);
  ASSERT_EQ(recording.damage.size(), 1U);
  EXPECT_THAT(recording.damage[0],
              testing::HasSubstr("damaged at byte " + std::to_string(at) + ": a record is larger"));
}

// Returns the number of bytes that this process has read.
std::uint64_t BytesRead() {
  std::ifstream io("/proc/self/io");
  std::string name;
  std::uint64_t bytes = 0;
  io >> name >> bytes;
  return bytes;
}

// The file's chunks are empty or declare more bytes than the file has. Damaged bytes separate the
// chunks.
TEST(ReadRecordingTest, ADamagedFileIsReadInProportionToItsSize) {
  const test::TempFolder folder;
  const std::string whole = SmallFile(folder);
  const auto bytes = [](auto value) {
    return std::string(reinterpret_cast<const char*>(&value), sizeof value);
  };
  std::size_t first_chunk = 8;
  while (whole[first_chunk] != 6) {
    std::uint64_t size = 0;
    std::memcpy(&size, &whole[first_chunk + 1], sizeof size);
    first_chunk += 9 + size;
  }
  for (const std::uint64_t claimed : {std::uint64_t{0}, std::uint64_t{1} << 40}) {
    const std::string chunk = '\6' + bytes(claimed + 40) + std::string(16, '\0') + bytes(claimed) +
                              std::string(8, '\0') + bytes(claimed) + '\x70';
    std::string content = whole.substr(0, first_chunk);
    for (int i = 0; i < 10'000; ++i) content += chunk;
    Save(folder / "damaged", content + whole.substr(whole.size() - 8));
    const std::uint64_t before = BytesRead();
    EXPECT_FALSE(ReadRecording(folder / "damaged").damage.empty());
    EXPECT_LT(BytesRead() - before, 20 * content.size()) << claimed;
  }
}

TEST(ReadRecordingTest, OtherFilesAreRefusedByName) {
  const test::TempFolder folder;
  const auto complaint = [&](const std::string& name) -> std::string {
    return dfr::test::MessageOf<std::runtime_error>(
        [&] { static_cast<void>(ReadRecording(folder / name)); });
  };
  EXPECT_THAT(complaint("missing"), testing::HasSubstr("check that it exists"));
  Save(folder / "text", "a text of some length");
  EXPECT_THAT(complaint("text"), testing::HasSubstr("does not begin like an MCAP file"));
  std::string foreign = SmallFile(folder);
  foreign.replace(foreign.find("dfr"), 3, "cat");
  Save(folder / "foreign", foreign);
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  EXPECT_THAT(complaint("pipe"), testing::HasSubstr("pipe: is a pipe or a device, not a file"));
  EXPECT_THAT(complaint("foreign"), testing::HasSubstr("it was written by 'cat'"));
}

TEST(ReadRecordingTest, AbsurdSizesAllocateNothing) {
  const test::TempFolder folder;
  const std::string whole = SmallFile(folder);
  // A chunk that declares 2^63 bytes, in a file without an end.
  Save(folder / "absurd",
       whole.substr(0, 28) + std::string("\x06\0\0\0\0\0\0\0\x80", 9) + std::string(100, 'x'));
  const Recording recording = ReadRecording(folder / "absurd");
  EXPECT_FALSE(recording.finished);
  EXPECT_TRUE(recording.steps.empty());
}

}  // namespace
}  // namespace dfr::recording
