#include "robot_watch.h"

#include <gtest/gtest.h>

#include <sstream>
#include <string>

#include "dfr/dds/emergency_stop.h"

namespace dfr::apps::hardware_app {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr dds::Origin kFirst = {1};
constexpr dds::Origin kSecond = {2};

class RobotWatchTest : public testing::Test {
 protected:
  // Returns the output since the last call.
  std::string Said() {
    std::string said = out_.str();
    out_.str("");
    return said;
  }

  std::ostringstream out_;
  RobotWatch watch_{out_};
};

TEST_F(RobotWatchTest, ReportsEachStateOnceAndSilenceAfter150Ms) {
  watch_.Hear(kFirst, "running", 0);
  watch_.Hear(kFirst, "running", 20 * kMs);
  EXPECT_EQ(Said(), "robot: running\n");
  watch_.Hear(kFirst, "holding", 40 * kMs);
  EXPECT_EQ(Said(), "robot: holding\n");
  watch_.Look(190 * kMs);
  EXPECT_EQ(Said(), "");
  watch_.Look(190 * kMs + 1);
  const std::string silent = Said();
  EXPECT_EQ(silent.find("robot: SILENT while holding"), 0U);
  EXPECT_EQ(silent.find("the arm holds"), std::string::npos)
      << "the arm's state is unknown: " << silent;
  EXPECT_NE(silent.find("the robot may move"), std::string::npos) << silent;
  watch_.Look(900 * kMs);
  EXPECT_EQ(Said(), "");
  watch_.Hear(kFirst, "holding", 1000 * kMs);
  EXPECT_EQ(Said(), "robot: holding\n") << "it is heard again";
}

TEST_F(RobotWatchTest, TheEndOfASecondProgramDoesNotHideTheFirst) {
  watch_.Hear(kFirst, "running", 0);
  watch_.Hear(kSecond, "idle", 10 * kMs);
  watch_.Hear(kSecond, dds::kRunEnded, 20 * kMs);
  EXPECT_EQ(Said(), "robot: running\nrobot 2: idle\nrobot 2: ended\n");
  watch_.Look(900 * kMs);
  EXPECT_EQ(Said().find("robot: SILENT while running"), 0U);
  watch_.Look(1000 * kMs);
  EXPECT_EQ(Said(), "") << "the second has ended in order";
}

TEST_F(RobotWatchTest, ConsecutiveProgramsAreOneRobot) {
  watch_.Hear(kFirst, "running", 0);
  watch_.Hear(kFirst, dds::kRunEnded, 10 * kMs);
  watch_.Hear(kSecond, "idle", 20 * kMs);
  EXPECT_EQ(Said(), "robot: running\nrobot: ended\nrobot: idle\n");
}

// A hostile participant cannot flood the screen or write control characters.
TEST_F(RobotWatchTest, CountsAFloodAndStillReportsSilence) {
  for (int i = 0; i < 1000; ++i) watch_.Hear(kFirst, i % 2 == 0 ? "run\x1b[2Jning" : "idle", 0);
  EXPECT_EQ(Said(),
            "robot: run?[2Jning\nrobot: idle\nrobot: run?[2Jning\nrobot: idle\n"
            "robot: run?[2Jning\nrobot: idle\nrobot: run?[2Jning\nrobot: idle\n"
            "robot: run?[2Jning\nrobot: idle\n");
  watch_.Look(900 * kMs);
  EXPECT_EQ(Said().find("robot: SILENT while idle"), 0U);
  watch_.Look(1000 * kMs);
  EXPECT_EQ(Said(), "robots: 990 more changes are not shown\n");
  watch_.Hear(kFirst, "idle", 1001 * kMs);
  watch_.Look(1002 * kMs);
  EXPECT_EQ(Said(), "robot: idle\n");
}

TEST_F(RobotWatchTest, OmitsParticipantsBeyondTheLimit) {
  for (std::uint8_t n = 1; n <= 9; ++n) watch_.Hear({n}, "idle", 0);
  const std::string said = Said();
  EXPECT_NE(said.find("robot 8: idle\n"), std::string::npos) << said;
  EXPECT_EQ(said.find("robot 9"), std::string::npos) << said;
}

}  // namespace
}  // namespace dfr::apps::hardware_app
