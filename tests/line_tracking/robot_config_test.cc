#include "robot/robot_config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <utility>

#include "commands/commands.h"
#include "dfr/hardware/intrinsics_file.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"
#include "tests/support/write_intrinsics.h"

namespace dfr::apps::line_tracking {
namespace {

using testing::HasSubstr;

class RobotConfigTest : public testing::Test {
 protected:
  RobotConfig Load(const std::string& text) {
    std::ofstream(file_) << text;
    return RobotConfig::Load(file_);
  }
  // Returns the error about `text`.
  std::string Error(const std::string& text) {
    return dfr::test::MessageOf<std::runtime_error>([&] { static_cast<void>(Load(text)); });
  }

  const dfr::test::TempFolder folder_;
  const std::filesystem::path file_ = folder_ / "robot.toml";
};

TEST_F(RobotConfigTest, ReadsTheExamples) {
  const std::filesystem::path folder = DFR_CONFIG_FOLDER;
  EXPECT_EQ(Load("").robot, RobotPlace::kProcess);
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

// Such bytes caused undefined behaviour in the TOML parser.
TEST_F(RobotConfigTest, BinaryFilesAreRefusedBeforeParsing) {
  EXPECT_THAT(
      dfr::test::MessageOf<std::runtime_error>([&] {
        static_cast<void>(RobotConfig::Load(DFR_REGRESSIONS "/robot_config/toml_crash.toml"));
      }),
      HasSubstr("toml_crash.toml:12: there is the control character 16"));
  EXPECT_THAT(Error("robot = \"dds\"\n# \xC3\x28\n"),
              HasSubstr(":2: there is a character that is not UTF-8"));
  EXPECT_THAT(Error("# cut off within a character: \xE2\x82"), HasSubstr("not UTF-8"));
  EXPECT_THAT(Error(std::string("a = 1\n\0b", 8)),
              HasSubstr(":2: there is the control character 0"));
  EXPECT_THAT(Error(std::string((1 << 20) + 1, '#')), HasSubstr("longer than a mebibyte"));
  EXPECT_EQ(Error("# gr\xC3\xB6\xC3\x9F"
                  "er\r\n\trobot = \"dds\"\n"),
            "nothing thrown");
}

TEST_F(RobotConfigTest, ErrorsNameFileLineKeyAndValidValues) {
  const std::pair<const char*, const char*> rows[] = {
      {"robot = \"dds\"\n[arm]\nspeed = \"fast\"\n",
       ":3: arm.speed must be a number in [0.0001, 0.05]"},
      {"robot = \"mars\"\n", ":1: robot must be one of \"dds\", \"process\""},
      {"\n[loop]\nperiode_s = 0.01\n",
       ":3: unknown key 'loop.periode_s' in [loop]; valid: period_s"},
      {"robt = \"dds\"\n", ":1: unknown key 'robt'"},
      {"robot = 'dds'\nmethod = 'magic'\n",
       ":2: method must be a method: unknown method 'magic'; valid: baseline, "},
      {"method = 'true-jacobian'\n", ":1: method must be a method: unknown method"},
      {"[network]\nserver = 'robot.local'\n",
       ":2: network.server must be an IPv4 address such as \"127.0.0.1\""},
      {"[arm]\nname = 'a b'\n", ":2: arm.name must be "},
      {"[network]\ndomain = 1.5\n", ":2: network.domain must be a whole number in [0, 232]"},
      {"[simulator]\nlock_step = true\n", ":2: simulator.lock_step"},
      {"[loop]\nperiod_s = 0.02\nmax_period_s = 0.03\n",
       ":3: loop.max_period_s must be at least twice period_s"},
      {"camera = 3\n", ":1: camera must be a table"},
      {"[arm\n", ":1: "},
      {"[arm]\nworkspace_min_m = [0.0, 1.0]\n",
       ":2: arm.workspace_min_m must be 3 numbers in brackets"},
      {"[arm]\nworkspace_max_m = [inf, 1.0, 1.0]\n",
       ":2: arm.workspace_max_m must be above workspace_min_m in every entry, and both must be "
       "finite"},
      {"[arm]\nmax_tip_speed = 0.02\nspeed = 0.019\n",
       ":3: arm.speed must be at most 0.9 times max_tip_speed"},
      {"[arm]\nmax_tip_speed = 0.01\n", ":1: arm.speed must be at most"},
      {"[arm]\nmax_lag = [0, 1, 1, 1, 1, 1]\n", ":2: arm.max_lag must be 6 positive numbers"},
      {"[arm]\nteleoperation = ['following']\n", ":2: arm.teleoperation must be names of topics"},
      {"[arm]\ngeneration = 'Xi'\n", ":2: arm.generation must be one of \"Classic\", \"Si\""},
      {"[task]\nbox_max_m = [0.1, 0.1, 0.0]\n",
       ":2: task.box_max_m must be above box_min_m in every entry, and both must be finite"},
      {"[task]\nplanes = [[0, 0, 1]]\n",
       ":2: task.planes must be a list of planes, each 4 finite numbers"},
      {"[task]\nplanes = [[0, 0, 2, 0]]\n",
       ":2: task.planes must be planes whose normals have length 1"},
      {"[task]\nforbidden_boxes_m = [[0, 0, 0, -1, 0, 0]]\n",
       ":2: task.forbidden_boxes_m must be boxes with their lower corner first"},
      {"[task]\nplanes = [[0, 0, 1, 0]]\nbox_max_m = [0.1, 0.1, 0.0]\n",
       ":3: task.box_max_m must be"}};
  for (const auto& [text, words] : rows)
    EXPECT_THAT(Error(text), HasSubstr(file_.string() + words));
  EXPECT_THAT(Error("[arm]\nbase_position_m = [0.0, 0.0, 0.0]\n"),
              HasSubstr("unless both base_position_m and base_quaternion_xyzw are given"));
}

TEST_F(RobotConfigTest, ReadsAFeasibleWaveAndRefusesOthers) {
  const std::string port = "robot = 'dds'\n[platform]\ndevice = '/dev/ttyACM0'\n";
  const hardware::PlatformOptions platform =
      Load(port +
           "wave = 'breath'\namplitude = [0.002, 0, 0, 0, 0, 0.05]\n"
           "frequency_hz = [0.1, 0, 0, 0, 0, 0.05]\n")
          .platform;
  EXPECT_EQ(platform.device, "/dev/ttyACM0");
  EXPECT_EQ(platform.wave, hardware::SprkWaveKind::kBreath);
  EXPECT_EQ(platform.motion.amplitude.translation_m.x(), 0.002);
  EXPECT_EQ(platform.motion.amplitude.angles_rad.z(), 0.05);
  EXPECT_EQ(platform.motion.frequency_hz[5], 0.05);
  EXPECT_EQ(Load(port).platform.wave, std::nullopt) << "it rests at home";

  const std::pair<std::string, const char*> rows[] = {
      {port + "wave = 'sine'\namplitude = [0, 0, 0.03, 0, 0, 0]\n",
       ":5: platform.amplitude must be"},
      {port + "wave = 'sine'\namplitude = [0, 0, 0.03, 0, 0, 0]\n", "protocol"},
      {port + "wave = 'sine'\namplitude = [0.01, 0.01, 0.01, 0, 0, 0]\n",
       "beyond the platform's reach"},
      {port + "wave = 'breath'\nfrequency_hz = [0.5, 0, 0, 0, 0, 0]\n",
       "at most 0.99, for a breath 0.157"},
      {port + "wave = 'square'\n", R"(platform.wave must be one of "breath", "none", "sine")"},
      {"robot = 'dds'\n[platform]\nwave = 'sine'\n", "left out without platform.device"},
      {"[platform]\ndevice = '/dev/ttyACM0'\n",
       ":2: platform.device must be left out with robot = \"process\""}};
  for (const auto& [text, words] : rows) EXPECT_THAT(Error(text), HasSubstr(words));
}

TEST_F(RobotConfigTest, RegionAndLimitsAreRead) {
  const RobotConfig config = Load(
      "robot = 'dds'\n[arm]\nteleoperation = ['/a/following']\nservo_cs = true\n"
      "max_lag = [0.1, 0.1, 0.02, 0.2, 0.2, 0.2]\nrest_distance = [1, 1, 1, 1, 1, 1]\n"
      "[task]\nbox_min_m = [-0.01, -0.02, 0.001]\nlift_m = 0.01\n"
      "forbidden_boxes_m = [[0, 0, 0, 0.01, 0.01, 0.01]]\nplanes = [[0, 0, 1, 0.002]]\n");
  EXPECT_EQ(config.teleoperation, (std::vector<std::string>{"/a/following"}));
  EXPECT_TRUE(config.servo_cs);
  EXPECT_EQ(config.arm_client.max_lag[2], 0.02);
  EXPECT_EQ(config.arm_client.rest.max_distance[5], 1.0);
  EXPECT_EQ(config.lift_m, 0.01);
  EXPECT_EQ(config.region.box_min_m.z(), 0.001);
  ASSERT_EQ(config.region.forbidden.size(), 1U);
  EXPECT_EQ(config.region.forbidden[0].max().x(), 0.01);
  ASSERT_EQ(config.region.planes.size(), 1U);
  // The region begins two millimetres above the gauze at rest.
  EXPECT_NEAR(config.region.planes[0].signedDistance(Eigen::Vector3d(0.0, 0.0, 0.003)), 0.001,
              1e-15);
}

TEST_F(RobotConfigTest, AnArmIsAClassicByDefault) {
  using kinematics::Psm;
  using kinematics::PsmGeneration;
  const auto upper = [this](const std::string& text) { return Load(text).arm_client.limits.upper; };
  EXPECT_EQ(upper(""), Psm::upper_limits());
  EXPECT_EQ(upper("[arm]\ngeneration = 'Classic'\n"), Psm::upper_limits());
  const hardware::PsmLimits si = Load("[arm]\ngeneration = 'Si'\n").arm_client.limits;
  EXPECT_EQ(si.generation, PsmGeneration::kSi);
  EXPECT_EQ(si.lower, Psm::lower_limits(PsmGeneration::kSi));
  EXPECT_EQ(si.upper, Psm::upper_limits(PsmGeneration::kSi));
  EXPECT_NO_THROW(si.Check());
}

TEST_F(RobotConfigTest, TheSimulatorGetsTheCalibrationUnlessThereIsNone) {
  const auto given = [&](const std::string& calibration) {
    return std::ranges::count(SimulatorArguments(Load("calibration = '" + calibration + "'\n")),
                              "--calibration");
  };
  EXPECT_EQ(given("c.dfr"), 1);
  EXPECT_EQ(given(kNoCalibration), 0);
}

TEST_F(RobotConfigTest, ACalibrationOfAnotherCameraIsRefused) {
  const std::filesystem::path intrinsics = folder_ / "camera.yaml";
  vision::CameraModel camera;
  test::WriteIntrinsics(intrinsics, camera);
  const RobotConfig config =
      Load("calibration = 'c.dfr'\n[camera]\nintrinsics = '" + intrinsics.string() + "'\n");
  line_task::LineCalibration calibration;
  calibration.camera = camera;
  calibration.camera.fx *= 1.04;
  EXPECT_NO_THROW(CheckCamera(config, calibration));
  calibration.camera.fx *= 1.04;
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] { CheckCamera(config, calibration); }),
              testing::AllOf(HasSubstr("c.dfr is for another camera (640 x 480, focal length "),
                             HasSubstr(intrinsics.string())));
  std::filesystem::remove(intrinsics);
  EXPECT_THROW(CheckCamera(config, calibration), std::runtime_error) << "the file is gone";
  EXPECT_NO_THROW(CheckCamera({}, calibration)) << "nothing to compare with";
}

class ProvenanceTest : public RobotConfigTest {
 protected:
  static constexpr char kRobot[] =
      "robot = 'dds'\n[arm]\nname = 'PSM1'\nserial = 'A7'\n[camera]\nname = 'left eye'\n";
  // Returns the error about a calibration with this provenance.
  static std::string Refusal(const RobotConfig& config, const core::Provenance& provenance) {
    return dfr::test::MessageOf<std::runtime_error>(
        [&] { CheckProvenance(config, "c.dfr", provenance, "Do it again"); });
  }
};

TEST_F(ProvenanceTest, ARobotAcceptsOnlyFilesMadeWithIt) {
  const RobotConfig robot = Load(kRobot);
  const core::Provenance own = ProvenanceOf(robot);
  EXPECT_EQ(own.origin, core::Origin::kReal);
  EXPECT_EQ(own.date, core::Today());
  EXPECT_EQ(Refusal(robot, own), "nothing thrown");
  core::Provenance other = own;
  other.date = "1999-12-31";
  EXPECT_EQ(Refusal(robot, other), "nothing thrown") << "the date need not match";
  other.origin = core::Origin::kSimulated;
  EXPECT_EQ(Refusal(robot, other), "c.dfr of 1999-12-31: its origin is 'simulated', and " +
                                       file_.string() +
                                       "'s (simulator.present) is 'real'. Do it again");
  EXPECT_THAT(Refusal(robot, {}), HasSubstr("c.dfr: its origin is 'unknown'"));
  other = own;
  other.arm = "PSM2";
  EXPECT_THAT(Refusal(robot, other), HasSubstr("its arm is 'PSM2', and"));
  other = own;
  other.serial = "A8";
  EXPECT_THAT(Refusal(robot, other), HasSubstr("its serial is 'A8', and"));
  EXPECT_THAT(Refusal(robot, other), HasSubstr("'s (arm.serial) is 'A7'. Do it again"));
  other = own;
  other.camera = "right eye";
  EXPECT_THAT(Refusal(robot, other), HasSubstr("'s (camera.name) is 'left eye'"));
}

TEST_F(ProvenanceTest, ASimulationAcceptsSimulatedAndUnmarkedFiles) {
  const core::Provenance real = ProvenanceOf(Load(kRobot));
  core::Provenance simulated;
  simulated.origin = core::Origin::kSimulated;
  simulated.serial = "another arm's";
  for (const RobotConfig& config : {Load("robot = 'dds'\n[simulator]\npresent = true\n"),
                                    Load("robot = 'process'\n"), RobotConfig()}) {
    EXPECT_EQ(ProvenanceOf(config).origin, core::Origin::kSimulated);
    EXPECT_EQ(Refusal(config, simulated), "nothing thrown");
    EXPECT_EQ(Refusal(config, {}), "nothing thrown");
    EXPECT_THAT(Refusal(config, real), HasSubstr("its origin is 'real', and"));
  }
}

TEST_F(ProvenanceTest, ARobotWithoutIdentityIsRefused) {
  EXPECT_THAT(Refusal(Load("robot = 'dds'\n[camera]\nname = 'left eye'\n"), {}),
              HasSubstr(".toml: arm.serial is not set"));
  EXPECT_THAT(Refusal(Load("robot = 'dds'\n[arm]\nserial = 'A7'\n"), {}),
              HasSubstr(".toml: camera.name is not set"));
}

}  // namespace
}  // namespace dfr::apps::line_tracking
