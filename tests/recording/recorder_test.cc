#include "dfr/recording/recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/recording/read_recording.h"
#include "tests/recording/example.h"
#include "tests/recording/same.h"
#include "tests/recording/temp_folder.h"
#include "tests/support/no_alloc.h"

namespace dfr::recording {
namespace {

using std::chrono::milliseconds;

// What a call throws.
template <typename F>
std::string Complaint(F&& call) {
  try {
    call();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "nothing";
}

TEST(RecorderTest, EverythingComesBackBitForBit) {
  const test::TempFolder folder;
  constexpr std::uint32_t kSteps = 1000;
  {
    Recorder recorder(folder / "log.mcap", test::ExampleMetadata());
    for (std::uint32_t i = 0; i < kSteps; ++i) {
      ASSERT_TRUE(recorder.Record(test::ExampleStep(i)));
      if (i % 100 != 0) continue;
      ASSERT_TRUE(recorder.Transition(test::ExampleTransition(i)));
    }
    recorder.Finish();
    EXPECT_FALSE(recorder.failed());
    EXPECT_EQ(recorder.dropped(), 0U);
    EXPECT_EQ(recorder.counts().records, kSteps + 10);
  }
  const Recording recording = ReadRecording(folder / "log.mcap");
  EXPECT_TRUE(recording.finished);
  EXPECT_EQ(recording.metadata, test::ExampleMetadata());
  EXPECT_EQ(recording.dropped_records, 0U);
  ASSERT_EQ(recording.steps.size(), kSteps);
  for (std::uint32_t i = 0; i < kSteps; ++i) {
    ASSERT_TRUE(test::Same(recording.steps[i], test::ExampleStep(i))) << "step " << i;
  }
  ASSERT_EQ(recording.transitions.size(), 10U);
  for (std::uint32_t i = 0; i < 10; ++i) {
    EXPECT_TRUE(test::Same(recording.transitions[i], test::ExampleTransition(100 * i)));
  }
}

TEST(RecorderTest, NeitherAllocatesNorWaits) {
  const test::TempFolder folder;
  Recorder recorder(folder / "log.mcap", {});
  const StepRecord step = test::ExampleStep(63);
  const TransitionRecord transition = test::ExampleTransition(0);
  const std::vector<std::uint8_t> pixels = test::ExamplePixels(0);
  const test::NoAlloc guard;
  for (int i = 0; i < 5000; ++i) recorder.Record(step);  // more than wait: some are dropped
  recorder.Transition(transition);
  for (int i = 0; i < 20; ++i) recorder.Picture(test::ExamplePicture(0, pixels));
  EXPECT_GT(recorder.dropped(), 0U);
  EXPECT_FALSE(recorder.failed());
}

TEST(RecorderTest, PicturesAreKeptAsJpeg) {
  const test::TempFolder folder;
  const std::vector<std::uint8_t> jpeg = {0xff, 0xd8, 1, 2, 3, 0xff, 0xd9};
  {
    Recorder recorder(folder / "log.mcap", {});
    for (std::uint32_t i = 0; i < 3; ++i) {
      ASSERT_TRUE(recorder.Picture(test::ExamplePicture(i, test::ExamplePixels(i))));
    }
    ASSERT_TRUE(recorder.Picture(
        {.time_ns = 5, .sequence = 9, .format = PictureFormat::kJpeg, .data = jpeg}));
    recorder.Finish();
    EXPECT_EQ(recorder.counts().pictures, 4U);
  }
  const Recording recording = ReadRecording(folder / "log.mcap");
  ASSERT_EQ(recording.pictures.size(), 4U);
  for (std::uint32_t i = 0; i < 3; ++i) {
    EXPECT_EQ(recording.pictures[i].sequence, i);
    EXPECT_EQ(recording.pictures[i].time_ns, test::ExampleStep(i).time_ns);
    const auto file = ReadPicture(folder / "log.mcap", recording.pictures[i]);
    ASSERT_GT(file.size(), 4U);
    EXPECT_EQ(file[0], 0xff);
    EXPECT_EQ(file[1], 0xd8);
    EXPECT_EQ(file[file.size() - 1], 0xd9);
  }
  EXPECT_EQ(ReadPicture(folder / "log.mcap", recording.pictures[3]), jpeg);
}

TEST(RecorderTest, PicturesThatAreNoneAreCounted) {
  const test::TempFolder folder;
  Recorder recorder(folder / "log.mcap", {}, {.picture_bytes = 10000});
  const std::vector<std::uint8_t> pixels = test::ExamplePixels(0);
  PictureView picture = test::ExamplePicture(0, pixels);
  EXPECT_TRUE(recorder.Picture(picture));
  picture.height = 49;  // more rows than data
  EXPECT_FALSE(recorder.Picture(picture));
  picture.height = 48;
  picture.step = 191;  // rows overlap
  EXPECT_FALSE(recorder.Picture(picture));
  const std::vector<std::uint8_t> large(10001);
  EXPECT_FALSE(recorder.Picture({.format = PictureFormat::kJpeg, .data = large}));
  recorder.Finish();
  EXPECT_EQ(recorder.dropped(), 3U);
  EXPECT_EQ(recorder.counts().dropped_pictures, 3U);
  const Recording recording = ReadRecording(folder / "log.mcap");
  EXPECT_EQ(recording.pictures.size(), 1U);
  ASSERT_FALSE(recording.notes.empty());
  EXPECT_THAT(recording.notes[0].text, testing::HasSubstr("pictures were lost"));
}

// A burst that the queue cannot take: the file says how many are missing, and which are there.
TEST(RecorderTest, DroppedStepsAreCountedAndNoted) {
  const test::TempFolder folder;
  constexpr std::uint32_t kSteps = 20000;
  std::uint64_t taken = 0;
  std::uint64_t dropped = 0;
  {
    Recorder recorder(folder / "log.mcap", {}, {.waiting_records = 4});
    for (std::uint32_t i = 0; i < kSteps; ++i) {
      StepRecord step;
      step.time_ns = i;
      taken += recorder.Record(step) ? 1 : 0;
    }
    std::this_thread::sleep_for(milliseconds(100));
    ASSERT_TRUE(recorder.Record({}));  // shows the gap before it
    recorder.Finish();
    dropped = recorder.dropped();
  }
  EXPECT_EQ(taken + dropped, kSteps);
  EXPECT_GT(dropped, 0U);
  const Recording recording = ReadRecording(folder / "log.mcap");
  EXPECT_EQ(recording.steps.size(), taken + 1);
  EXPECT_EQ(recording.dropped_records, dropped);
  ASSERT_FALSE(recording.notes.empty());
  EXPECT_THAT(recording.notes[0].text,
              testing::HasSubstr("steps, transitions or states of the arm"));
}

TEST(RecorderTest, StepsAndPicturesFromTwoThreads) {
  const test::TempFolder folder;
  Recorder recorder(folder / "log.mcap", {});
  std::atomic<bool> done{false};
  std::thread camera([&] {
    const std::vector<std::uint8_t> pixels = test::ExamplePixels(0);
    for (std::uint32_t i = 0; !done; ++i) {
      recorder.Picture(test::ExamplePicture(i, pixels));
      std::this_thread::sleep_for(milliseconds(2));
    }
  });
  for (std::uint32_t i = 0; i < 300; ++i) {
    ASSERT_TRUE(recorder.Record(test::ExampleStep(i)));
    std::this_thread::sleep_for(milliseconds(1));
  }
  done = true;
  camera.join();
  recorder.Finish();
  const Recording recording = ReadRecording(folder / "log.mcap");
  ASSERT_EQ(recording.steps.size(), 300U);
  EXPECT_TRUE(test::Same(recording.steps[299], test::ExampleStep(299)));
  EXPECT_EQ(recording.pictures.size(), recorder.counts().pictures);
  EXPECT_GT(recording.pictures.size(), 0U);
}

TEST(RecorderTest, AFileThatExistsIsNotTouched) {
  const test::TempFolder folder;
  std::ofstream(folder / "log.mcap") << "precious";
  EXPECT_THAT(Complaint([&] { Recorder(folder / "log.mcap", {}); }),
              testing::AllOf(testing::HasSubstr("log.mcap: File exists"),
                             testing::HasSubstr("give it another name")));
  EXPECT_EQ(std::filesystem::file_size(folder / "log.mcap"), 8U);
  EXPECT_THAT(Complaint([&] { Recorder(folder / "missing/log.mcap", {}); }),
              testing::HasSubstr("make its folder first"));
  EXPECT_THROW(Recorder(folder / "a", {}, {.jpeg_quality = 101}), std::invalid_argument);
  EXPECT_THROW(Recorder(folder / "b", {}, {.waiting_records = 0}), std::invalid_argument);
  EXPECT_THROW(Recorder(folder / "c", {}, {.waiting_pictures = 0}), std::invalid_argument);
}

// A child of this process whose files may not grow beyond some size: as on a full disk, writing
// fails, with part of a record written. Its exit code is what `body` returns.
int WithLargestFile(rlim_t bytes, int (*body)(const std::filesystem::path&),
                    const std::filesystem::path& path) {
  const pid_t child = ::fork();
  if (child == 0) {
    ::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{bytes, bytes};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    ::_exit(body(path));
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST(RecorderTest, ADiskThatIsFullAtTheStartIsRefused) {
  const test::TempFolder folder;
  const auto body = [](const std::filesystem::path& path) {
    const std::string complaint = Complaint([&] { Recorder(path, test::ExampleMetadata()); });
    return complaint.find("may not grow") != std::string::npos &&
                   complaint.find(path.string()) != std::string::npos
               ? 0
               : 1;
  };
  EXPECT_EQ(WithLargestFile(1000, body, folder / "log.mcap"), 0);
  EXPECT_FALSE(std::filesystem::exists(folder / "log.mcap"));
}

TEST(RecorderTest, ADiskThatFillsUpDoesNotStopTheRun) {
  const test::TempFolder folder;
  const auto body = [](const std::filesystem::path& path) {
    Recorder recorder(path, test::ExampleMetadata());
    std::uint32_t i = 0;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    while (!recorder.failed() && std::chrono::steady_clock::now() < end) {
      recorder.Record(test::ExampleStep(i++));
      std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
    if (!recorder.failed()) return 1;
    for (int more = 0; more < 10000; ++more) recorder.Record(test::ExampleStep(i++));
    const std::string complaint = Complaint([&] { recorder.Finish(); });
    if (complaint.find("is incomplete: the file may not grow") == std::string::npos) return 2;
    return recorder.dropped() >= 10000 ? 0 : 3;
  };
  ASSERT_EQ(WithLargestFile(600'000, body, folder / "log.mcap"), 0);
  const Recording recording = ReadRecording(folder / "log.mcap");
  EXPECT_FALSE(recording.finished);
  ASSERT_GT(recording.steps.size(), 100U);
  for (std::uint32_t i = 0; i < recording.steps.size(); ++i) {
    ASSERT_TRUE(test::Same(recording.steps[i], test::ExampleStep(i))) << "step " << i;
  }
}

// kill -9 at random moments: what came more than a second before is there, and right.
TEST(RecorderTest, AKilledProcessLosesLessThanTheLastSecond) {
  const test::TempFolder folder;
  core::Random random(3);
  for (int run = 0; run < 6; ++run) {
    const std::string log = folder / ("log" + std::to_string(run));
    const std::string progress = folder / ("progress" + std::to_string(run));
    std::string program = DFR_RECORDING_CHILD;
    std::string log_argument = log;
    std::string progress_argument = progress;
    char* argv[] = {program.data(), log_argument.data(), progress_argument.data(), nullptr};
    pid_t child = -1;
    ASSERT_EQ(::posix_spawn(&child, program.c_str(), nullptr, nullptr, argv, environ), 0);
    std::this_thread::sleep_for(milliseconds(400 + random.Below(1000)));
    ::kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));

    const Recording recording = ReadRecording(log);
    EXPECT_FALSE(recording.finished);
    EXPECT_EQ(recording.metadata, test::ExampleMetadata());
    const auto recorded = std::filesystem::file_size(progress);  // one byte a step
    const auto kept = recording.steps.size();
    EXPECT_LE(kept, recorded + 1);
    EXPECT_LT(recorded - std::min<std::uintmax_t>(kept, recorded), 1000U) << recorded << " steps";
    for (std::uint32_t i = 0; i < kept; ++i) {
      ASSERT_TRUE(test::Same(recording.steps[i], test::ExampleStep(i))) << "step " << i;
    }
  }
}

}  // namespace
}  // namespace dfr::recording
