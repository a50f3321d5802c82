#include "robot_config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

namespace dfr::apps::line_tracking {
namespace {

using testing::HasSubstr;

class RobotConfigTest : public testing::Test {
 protected:
  ~RobotConfigTest() override { std::filesystem::remove(file_); }

  RobotConfig Load(const std::string& text) {
    std::ofstream(file_) << text;
    return RobotConfig::Load(file_);
  }
  // What the error says of `text`; empty if there is none.
  std::string Error(const std::string& text) {
    try {
      static_cast<void>(Load(text));
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return {};
  }

  std::filesystem::path file_ = std::filesystem::temp_directory_path() /
                                ("robot_config_test_" + std::to_string(getpid()) + ".toml");
};

TEST_F(RobotConfigTest, ReadsWhatTheExamplesSay) {
  const std::filesystem::path folder = DFR_CONFIG_FOLDER;
  EXPECT_EQ(RobotConfig::Load(folder / "simulation.toml").robot, RobotPlace::kProcess);
  const RobotConfig simulator = RobotConfig::Load(folder / "simulator.toml");
  EXPECT_EQ(simulator.robot, RobotPlace::kDds);
  EXPECT_TRUE(simulator.simulator);
  EXPECT_FALSE(simulator.lock_step);
  EXPECT_TRUE(RobotConfig::Load(folder / "lock_step.toml").lock_step);
  const RobotConfig robot = RobotConfig::Load(folder / "robot.toml");
  EXPECT_FALSE(robot.simulator);
  EXPECT_TRUE(robot.emergency_stop);
  ASSERT_TRUE(robot.p_world_base.has_value());
  EXPECT_TRUE(
      (robot.p_world_base->linear() * robot.p_world_base->linear().transpose()).isIdentity(1e-12));
  EXPECT_EQ(robot.network.discovery, dds::Discovery::kNetwork);
  EXPECT_EQ(robot.arm_client.limits.workspace_max_m.x(), 0.04);
}

TEST_F(RobotConfigTest, AnEmptyFileIsTheSimulation) {
  EXPECT_EQ(Load("").robot, RobotPlace::kProcess);
}

// The parser of TOML ran into undefined behaviour on such bytes.
TEST_F(RobotConfigTest, WhatIsNoTextIsRefusedBeforeItIsParsed) {
  try {
    static_cast<void>(RobotConfig::Load(DFR_REGRESSIONS "/robot_config/toml_crash.toml"));
    ADD_FAILURE() << "read";
  } catch (const std::runtime_error& e) {
    EXPECT_THAT(e.what(), HasSubstr("toml_crash.toml:12: there is the control character 16"));
  }
  EXPECT_THAT(Error("robot = \"dds\"\n# \xC3\x28\n"),
              HasSubstr(":2: there is a character that is not UTF-8"));
  EXPECT_THAT(Error("# cut off within a character: \xE2\x82"), HasSubstr("not UTF-8"));
  EXPECT_THAT(Error(std::string("a = 1\n\0b", 8)),
              HasSubstr(":2: there is the control character 0"));
  EXPECT_THAT(Error(std::string((1 << 20) + 1, '#')), HasSubstr("longer than a mebibyte"));
  EXPECT_EQ(Error("# gr\xC3\xB6\xC3\x9F"
                  "er\r\n\trobot = \"dds\"\n"),
            "");
}

TEST_F(RobotConfigTest, ErrorsNameFileLineKeyAndWhatThereIs) {
  const std::string file = file_.string();
  EXPECT_THAT(Error("robot = \"dds\"\n[arm]\nspeed = \"fast\"\n"),
              HasSubstr(file + ":3: arm.speed must be a number in [0.0001, 0.05]"));
  EXPECT_THAT(Error("robot = \"mars\"\n"),
              HasSubstr(file + ":1: robot must be one of \"dds\", \"process\""));
  EXPECT_THAT(
      Error("\n[loop]\nperiode_s = 0.01\n"),
      HasSubstr(file + ":3: there is no key 'loop.periode_s' in [loop]. There are: period_s"));
  EXPECT_THAT(Error("robt = \"dds\"\n"), HasSubstr(":1: there is no key 'robt'"));
  EXPECT_THAT(Error("[network]\ndomain = 1.5\n"),
              HasSubstr(":2: network.domain must be a whole number in [0, 232]"));
  EXPECT_THAT(Error("[arm]\nworkspace_min_m = [0.0, 1.0]\n"),
              HasSubstr(":2: arm.workspace_min_m must be 3 numbers in brackets"));
  EXPECT_THAT(Error("[arm]\nbase_position_m = [0.0, 0.0, 0.0]\n"),
              HasSubstr("arm.base_position_m must be given together"));
  EXPECT_THAT(Error("[simulator]\nlock_step = true\n"), HasSubstr(":2: simulator.lock_step"));
  EXPECT_THAT(Error("[loop]\nperiod_s = 0.02\nmax_period_s = 0.03\n"),
              HasSubstr(":3: loop.max_period_s must be at least twice period_s"));
  EXPECT_THAT(Error("camera = 3\n"), HasSubstr(":1: camera must be a table"));
  EXPECT_THAT(Error("[arm\n"), HasSubstr(file + ":1: "));
}

TEST_F(RobotConfigTest, AFileThatIsNotThereIsNamed) {
  EXPECT_THROW(static_cast<void>(RobotConfig::Load("/nonexistent.toml")), std::runtime_error);
}

}  // namespace
}  // namespace dfr::apps::line_tracking
