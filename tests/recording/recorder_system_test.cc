// A recording process that is killed at random moments, in real time.
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <string>
#include <thread>

#include "dfr/core/random.h"
#include "dfr/recording/read_recording.h"
#include "tests/recording/example.h"
#include "tests/recording/same.h"
#include "tests/recording/temp_folder.h"

namespace dfr::recording {
namespace {

// Messages older than a second are complete and correct.
TEST(KilledRecorderTest, AKilledProcessLosesLessThanTheLastSecond) {
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
    std::this_thread::sleep_for(std::chrono::milliseconds(400 + random.Below(1000)));
    ::kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));

    const Recording recording = ReadRecording(log);
    EXPECT_FALSE(recording.finished);
    EXPECT_EQ(recording.metadata, test::ExampleMetadata());
    const auto recorded = std::filesystem::file_size(progress);  // one byte per step
    const auto kept = recording.steps.size();
    EXPECT_LE(kept, recorded + 1);
    // One step per millisecond. An idle machine loses a quarter of a second; the limit is four
    // times that.
    EXPECT_LT(recorded - std::min<std::uintmax_t>(kept, recorded), 1000U) << recorded << " steps";
    for (std::uint32_t i = 0; i < kept; ++i) {
      ASSERT_TRUE(test::Same(recording.steps[i], test::ExampleStep(i))) << "step " << i;
    }
  }
}

}  // namespace
}  // namespace dfr::recording
