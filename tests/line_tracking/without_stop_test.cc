// Output of a run whose configuration has no emergency stop.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "dfr/recording/read_recording.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/line_tracking/model_folder.h"

namespace dfr::apps::line_tracking {
namespace {

int Count(const std::string& printed, const std::string& text) {
  int count = 0;
  for (std::size_t at = printed.find(text); at != std::string::npos;
       at = printed.find(text, at + 1)) {
    ++count;
  }
  return count;
}

// Takes 4 s for two episodes in lock-step. Only this test reads the operator's output of a whole
// run. LaunchTest has a run with an emergency stop.
TEST(WithoutStopTest, ARunWarnsFirstAtEveryStartAndInItsRecording) {
  const std::string warning =
      "WITHOUT AN EMERGENCY STOP: only the console and Ctrl-C here stop the arm\n";
  const std::filesystem::path folder = Data().path / "run-without-stop";
  std::filesystem::create_directories(folder);
  const int domain = test::OwnDomain();
  std::ofstream(folder / "run.toml")
      << "robot = 'dds'\nmethod = 'early-stopping'\nmodel = '" << (Data().path / "model").string()
      << "'\ncalibration = '" << (Data().path / "calibration.dfr").string() << "'\nrecordings = '"
      << (folder / "log").string() << "'\n[network]\ndomain = " << domain
      << "\n[simulator]\npresent = true\nlock_step = true\nanswer_s = 86400.0\n"
         "[emergency_stop]\nrequired = false\n[loop]\npriority = 0\n";
  const test::PeerProcess simulator(
      {DFR_SIMULATOR, "--lock-step", "--domain", std::to_string(domain)});
  const std::filesystem::path out = folder / "out.txt";
  test::PeerProcess run({"/bin/sh", "-c",
                         "exec '" DFR_LINE_TRACKING "' run --episodes 2 --config '" +
                             (folder / "run.toml").string() + "' > '" + out.string() + "'"});
  const int code = run.Await();
  std::ostringstream text;
  text << std::ifstream(out).rdbuf();
  const std::string printed = text.str();
  ASSERT_EQ(code, 0) << printed;
  EXPECT_TRUE(printed.starts_with(warning)) << printed;
  const int starts = Count(printed, "-> armed");
  EXPECT_GE(starts, 2) << printed;
  EXPECT_EQ(Count(printed, "  " + warning), starts) << printed;
  const recording::Recording log =
      recording::ReadRecording(std::filesystem::directory_iterator(folder / "log")->path());
  EXPECT_EQ(log.metadata.more.at("emergency stop"), "none");
}

}  // namespace
}  // namespace dfr::apps::line_tracking
