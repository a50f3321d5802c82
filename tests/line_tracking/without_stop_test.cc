// Output of a run whose configuration has no emergency stop.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "dfr/recording/read_recording.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/line_tracking/model_folder.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr const char* kWithoutStop =
    "WITHOUT AN EMERGENCY STOP: only the console and Ctrl-C here stop the arm\n";

// Two episodes in lock-step: the output of the program, and its recording.
struct RunOfTwo {
  explicit RunOfTwo(bool with_stop) {
    const std::filesystem::path folder =
        Data().path / (with_stop ? "run-with-stop" : "run-without-stop");
    std::filesystem::create_directories(folder);
    const int domain = test::OwnDomain();
    std::ofstream(folder / "run.toml")
        << "robot = 'dds'\nmethod = 'baseline'\nmodel = '" << (Data().path / "model").string()
        << "'\ncalibration = '" << (Data().path / "calibration.dfr").string() << "'\nrecordings = '"
        << (folder / "log").string() << "'\n[network]\ndomain = " << domain
        << "\n[simulator]\npresent = true\nlock_step = true\nanswer_s = 86400.0\n"
           "[emergency_stop]\nrequired = "
        << (with_stop ? "true\nmax_silence_s = 10.0" : "false") << "\n[loop]\npriority = 0\n";
    const test::PeerProcess simulator(
        {DFR_SIMULATOR, "--lock-step", "--domain", std::to_string(domain)});
    std::optional<test::PeerProcess> stop;
    if (with_stop) {
      stop.emplace(std::vector<std::string>{DFR_HARDWARE, "stop", "--unattended", "--domain",
                                            std::to_string(domain)});
    }
    const std::filesystem::path out = folder / "out.txt";
    test::PeerProcess run({"/bin/sh", "-c",
                           "exec '" DFR_LINE_TRACKING "' run --episodes 2 --config '" +
                               (folder / "run.toml").string() + "' > '" + out.string() + "'"});
    code = run.Await();
    std::ostringstream text;
    text << std::ifstream(out).rdbuf();
    printed = text.str();
    log = recording::ReadRecording(std::filesystem::directory_iterator(folder / "log")->path());
  }
  // Number of occurrences.
  [[nodiscard]] int Count(const std::string& text) const {
    int count = 0;
    for (std::size_t at = printed.find(text); at != std::string::npos;
         at = printed.find(text, at + 1)) {
      ++count;
    }
    return count;
  }

  int code = -1;
  std::string printed;
  recording::Recording log;
};

// Runs the program twice, 10 s. Only this test reads the operator's output of a whole run.
TEST(WithoutStopTest, ARunSaysSoFirstAtEveryStartAndInItsRecording) {
  const RunOfTwo without(false);
  ASSERT_EQ(without.code, 0) << without.printed;
  EXPECT_TRUE(without.printed.starts_with(kWithoutStop)) << without.printed;
  const int starts = without.Count("-> armed");
  EXPECT_GE(starts, 2) << without.printed;
  EXPECT_EQ(without.Count(std::string("  ") + kWithoutStop), starts) << without.printed;
  EXPECT_EQ(without.log.metadata.more.at("emergency stop"), "none");

  const RunOfTwo with(true);
  ASSERT_EQ(with.code, 0) << with.printed;
  EXPECT_EQ(with.Count("WITHOUT AN EMERGENCY STOP"), 0) << with.printed;
  EXPECT_EQ(with.log.metadata.more.at("emergency stop"), "required");
}

}  // namespace
}  // namespace dfr::apps::line_tracking
