#include "dfr/recording/recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <atomic>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "dfr/recording/read_recording.h"
#include "tests/recording/example.h"
#include "tests/recording/hand_clock.h"
#include "tests/recording/same.h"
#include "tests/support/eventually.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::recording {
namespace {

// Returns the message of a call's exception.
template <typename F>
std::string Complaint(F&& call) {
  return dfr::test::MessageOf([&] { call(); });
}

// Returns the JPEG data of one picture of a recording.
std::vector<std::uint8_t> JpegAt(const std::filesystem::path& path,
                                 const RecordedPicture& picture) {
  const std::string bytes = test::FileText(path).substr(picture.offset, picture.size);
  return {bytes.begin(), bytes.end()};
}

// Limits the size of files that the process writes. Writing then fails as on a full disk, with part
// of a record written.
class SmallDisk {
 public:
  explicit SmallDisk(rlim_t bytes) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{bytes, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~SmallDisk() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }
  SmallDisk(const SmallDisk&) = delete;
  SmallDisk& operator=(const SmallDisk&) = delete;

 private:
  rlimit before_{};
  void (*handler_)(int) = std::signal(SIGXFSZ, SIG_IGN);
};

class RecorderTest : public testing::Test {
 protected:
  [[nodiscard]] RecorderOptions Options() { return {.clock = &clock_}; }

  const test::TempFolder folder_;
  test::RecorderHandClock clock_;
};

TEST_F(RecorderTest, AllRecordsAreReadBitForBit) {
  constexpr std::uint32_t kRecordedSteps = 1000;
  {
    Recorder recorder(folder_ / "log.mcap", test::ExampleMetadata(), Options());
    for (std::uint32_t i = 0; i < kRecordedSteps; ++i) {
      ASSERT_TRUE(recorder.Record(test::ExampleStep(i)));
      if (i % 100 != 0) continue;
      ASSERT_TRUE(recorder.Transition(test::ExampleTransition(i)));
    }
    recorder.Finish();
    EXPECT_FALSE(recorder.failed());
    EXPECT_EQ(recorder.dropped(), 0U);
    EXPECT_EQ(recorder.counts().records, kRecordedSteps + 10);
  }
  const Recording recording = ReadRecording(folder_ / "log.mcap");
  EXPECT_TRUE(recording.finished);
  EXPECT_EQ(recording.metadata, test::ExampleMetadata());
  EXPECT_EQ(recording.dropped_records, 0U);
  ASSERT_EQ(recording.steps.size(), kRecordedSteps);
  for (std::uint32_t i = 0; i < kRecordedSteps; ++i) {
    ASSERT_TRUE(test::Same(recording.steps[i], test::ExampleStep(i))) << "step " << i;
  }
  ASSERT_EQ(recording.transitions.size(), 10U);
  for (std::uint32_t i = 0; i < 10; ++i) {
    EXPECT_TRUE(test::Same(recording.transitions[i], test::ExampleTransition(100 * i)));
  }
}

TEST_F(RecorderTest, NeitherAllocatesNorWaits) {
  Recorder recorder(folder_ / "log.mcap", {}, Options());
  const StepRecord step = test::ExampleStep(63);
  const TransitionRecord transition = test::ExampleTransition(0);
  const std::vector<std::uint8_t> pixels = test::ExamplePixels(0);
  const test::NoAlloc guard;
  for (int i = 0; i < 5000; ++i) EXPECT_EQ(recorder.Record(step), i < 4096);
  EXPECT_FALSE(recorder.Transition(transition));
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(recorder.Picture(test::ExamplePicture(0, pixels)), i < 8);
  }
  EXPECT_EQ(recorder.dropped(), 5000U - 4096 + 1 + 20 - 8);
  EXPECT_FALSE(recorder.failed());
}

TEST_F(RecorderTest, PicturesAreKeptAsJpeg) {
  const std::vector<std::uint8_t> jpeg = {0xff, 0xd8, 1, 2, 3, 0xff, 0xd9};
  {
    Recorder recorder(folder_ / "log.mcap", {}, Options());
    for (std::uint32_t i = 0; i < 3; ++i) {
      ASSERT_TRUE(recorder.Picture(test::ExamplePicture(i, test::ExamplePixels(i))));
    }
    ASSERT_TRUE(recorder.Picture(
        {.time_ns = 5, .sequence = 9, .format = PictureFormat::kJpeg, .data = jpeg}));
    recorder.Finish();
    EXPECT_EQ(recorder.counts().pictures, 4U);
  }
  const Recording recording = ReadRecording(folder_ / "log.mcap");
  ASSERT_EQ(recording.pictures.size(), 4U);
  for (std::uint32_t i = 0; i < 3; ++i) {
    EXPECT_EQ(recording.pictures[i].sequence, i);
    EXPECT_EQ(recording.pictures[i].time_ns, test::ExampleStep(i).time_ns);
    const auto file = JpegAt(folder_ / "log.mcap", recording.pictures[i]);
    ASSERT_GT(file.size(), 4U);
    EXPECT_EQ(file[0], 0xff);
    EXPECT_EQ(file[1], 0xd8);
    EXPECT_EQ(file[file.size() - 1], 0xd9);
  }
  EXPECT_EQ(JpegAt(folder_ / "log.mcap", recording.pictures[3]), jpeg);
}

TEST_F(RecorderTest, InvalidPicturesAreCounted) {
  Recorder recorder(folder_ / "log.mcap", {}, {.picture_bytes = 10000, .clock = &clock_});
  const std::vector<std::uint8_t> pixels = test::ExamplePixels(0);
  PictureView picture = test::ExamplePicture(0, pixels);
  EXPECT_TRUE(recorder.Picture(picture));
  picture.height = 49;  // more rows than the data has
  EXPECT_FALSE(recorder.Picture(picture));
  picture.height = 48;
  picture.step = 191;  // rows overlap
  EXPECT_FALSE(recorder.Picture(picture));
  const std::vector<std::uint8_t> large(10001);
  EXPECT_FALSE(recorder.Picture({.format = PictureFormat::kJpeg, .data = large}));
  recorder.Finish();
  EXPECT_EQ(recorder.dropped(), 3U);
  EXPECT_EQ(recorder.counts().dropped_pictures, 3U);
  const Recording recording = ReadRecording(folder_ / "log.mcap");
  EXPECT_EQ(recording.pictures.size(), 1U);
  ASSERT_FALSE(recording.notes.empty());
  EXPECT_THAT(recording.notes[0].text, testing::HasSubstr("pictures were lost"));
}

// If a burst exceeds the queue, the file records the number of missing messages.
TEST_F(RecorderTest, DroppedStepsAreCountedAndNoted) {
  {
    Recorder recorder(folder_ / "log.mcap", {}, {.waiting_records = 4, .clock = &clock_});
    for (std::uint32_t i = 0; i < 10; ++i) {
      EXPECT_EQ(recorder.Record(test::ExampleStep(i)), i < 4);
    }
    clock_.Pass(175);
    EXPECT_EQ(recorder.counts().records, 0U);  // not in the file yet
    clock_.Pass(25);
    EXPECT_EQ(recorder.counts().records, 4U);
    ASSERT_TRUE(recorder.Record(test::ExampleStep(10)));  // reveals the gap before it
    recorder.Finish();
    EXPECT_EQ(recorder.dropped(), 6U);
  }
  const Recording recording = ReadRecording(folder_ / "log.mcap");
  EXPECT_THAT(recording.step_numbers, testing::ElementsAre(1, 2, 3, 4, 11));
  EXPECT_EQ(recording.dropped_records, 6U);
  ASSERT_EQ(recording.notes.size(), 1U);
  EXPECT_THAT(recording.notes[0].text,
              testing::HasSubstr("6 steps, transitions or states of the arm and 0 pictures"));
}

// Advances by 50 ms per reading. Wait() returns at once, so the writing thread is always busy.
class RestlessClock final : public RecorderClock {
 public:
  [[nodiscard]] std::int64_t SteadyNs() override { return now_ns_ += 50'000'000; }
  void Wait(std::int64_t /*ns*/, const std::atomic<bool>& /*stopping*/) override {
    std::this_thread::yield();
  }

 private:
  std::int64_t now_ns_ = 0;
};

TEST_F(RecorderTest, AcceptsStepsAndPicturesFromTwoThreads) {
  RestlessClock clock;
  Recorder recorder(folder_ / "log.mcap", {}, {.clock = &clock});
  constexpr std::uint32_t kPictures = 20;
  std::thread camera([&] {
    const std::vector<std::uint8_t> pixels = test::ExamplePixels(0);
    for (std::uint32_t i = 0; i < kPictures; ++i) {
      test::Eventually([&] { return recorder.Picture(test::ExamplePicture(i, pixels)); });
    }
  });
  for (std::uint32_t i = 0; i < 300; ++i) EXPECT_TRUE(recorder.Record(test::ExampleStep(i)));
  camera.join();
  recorder.Finish();
  const Recording recording = ReadRecording(folder_ / "log.mcap");
  ASSERT_EQ(recording.steps.size(), 300U);
  EXPECT_TRUE(test::Same(recording.steps[299], test::ExampleStep(299)));
  EXPECT_EQ(recording.pictures.size(), kPictures);
}

TEST_F(RecorderTest, AFileThatExistsIsNotTouched) {
  std::ofstream(folder_ / "log.mcap") << "precious";
  EXPECT_THAT(Complaint([&] { Recorder(folder_ / "log.mcap", {}); }),
              testing::AllOf(testing::HasSubstr("log.mcap: File exists"),
                             testing::HasSubstr("choose another name")));
  EXPECT_EQ(std::filesystem::file_size(folder_ / "log.mcap"), 8U);
  EXPECT_THAT(Complaint([&] { Recorder(folder_ / "missing/log.mcap", {}); }),
              testing::HasSubstr("create its folder first"));
  EXPECT_THROW(Recorder(folder_ / "a", {}, {.jpeg_quality = 101}), std::invalid_argument);
  EXPECT_THROW(Recorder(folder_ / "b", {}, {.waiting_records = 0}), std::invalid_argument);
  EXPECT_THROW(Recorder(folder_ / "c", {}, {.waiting_pictures = 0}), std::invalid_argument);
}

TEST_F(RecorderTest, ADiskThatIsFullAtTheStartIsRefused) {
  const std::string path = folder_ / "log.mcap";
  std::string complaint;
  {
    const SmallDisk disk(1000);
    complaint = Complaint([&] { Recorder(path, test::ExampleMetadata(), Options()); });
  }
  EXPECT_THAT(complaint,
              testing::AllOf(testing::HasSubstr("cannot grow"), testing::HasSubstr(path)));
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST_F(RecorderTest, ADiskThatFillsUpDoesNotStopTheRun) {
  RecorderCounts counts;
  std::uint32_t i = 0;
  {
    const SmallDisk disk(600'000);
    Recorder recorder(folder_ / "log.mcap", test::ExampleMetadata(), Options());
    for (; !recorder.failed(); clock_.Pass(200)) {
      for (int k = 0; k < 100; ++k) ASSERT_TRUE(recorder.Record(test::ExampleStep(i++)));
    }
    const std::uint64_t dropped = recorder.dropped();
    for (int k = 0; k < 100; ++k) recorder.Record(test::ExampleStep(i++));
    EXPECT_THAT(Complaint([&] { recorder.Finish(); }),
                testing::HasSubstr("is incomplete: the file cannot grow"));
    EXPECT_EQ(recorder.dropped(), dropped + 100);
    counts = recorder.counts();
  }
  const Recording recording = ReadRecording(folder_ / "log.mcap");
  EXPECT_FALSE(recording.finished);
  ASSERT_GE(recording.steps.size(), 100U);
  EXPECT_EQ(counts.records, recording.steps.size());
  EXPECT_EQ(counts.records + counts.dropped_records, i);
  for (std::uint32_t k = 0; k < recording.steps.size(); ++k) {
    ASSERT_TRUE(test::Same(recording.steps[k], test::ExampleStep(k))) << "step " << k;
  }
}

// A killed process keeps the data that it passed to the system.
TEST_F(RecorderTest, AStepIsWrittenWithinAQuarterOfASecond) {
  const std::string path = folder_ / "log.mcap";
  Recorder recorder(path, test::ExampleMetadata(), Options());
  const auto written = [&] { return ReadRecording(path).steps.size(); };
  std::uint32_t steps = 0;
  for (int second = 0; second < 3; ++second) {
    ASSERT_TRUE(recorder.Record(test::ExampleStep(steps++)));
    for (int ms = 0; ms < 200; ms += 25) {
      EXPECT_EQ(written(), steps - 1);
      clock_.Pass(25);
    }
    EXPECT_EQ(written(), steps);
  }
  const Recording recording = ReadRecording(path);
  EXPECT_FALSE(recording.finished);
  EXPECT_EQ(recording.metadata, test::ExampleMetadata());
  for (std::uint32_t i = 0; i < steps; ++i) {
    EXPECT_TRUE(test::Same(recording.steps[i], test::ExampleStep(i)));
  }
}

}  // namespace
}  // namespace dfr::recording
