#include "check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

#include "dfr/core/error.h"
#include "dfr/core/random.h"
#include "dfr/dds/channel.h"
#include "dfr/hardware/intrinsics_file.h"
#include "home.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/hardware/check_support.h"
#include "tests/hardware_stewart/sprk_emulator.h"

namespace dfr::apps::hardware_app {
namespace {

using test::Background;
using test::ForArm;
using test::Options;
using test::Shown;
using testing::AllOf;
using testing::HasSubstr;

TEST(NoArmCheckTest, SaysWhatToStart) {
  const DeviceReport report = CheckArm(ForArm("PSM1", 0.3));
  EXPECT_FALSE(report.ok());
  EXPECT_THAT(Shown(report),
              AllOf(HasSubstr("nobody publishes /PSM1/measured_js"), HasSubstr("dvrk_simulator"),
                    HasSubstr("ROS_DOMAIN_ID must be " + std::to_string(test::OwnDomain()))));
}

// A publisher that keeps nothing for late joiners, as a plain ROS 2 node does.
TEST(NoArmCheckTest, QualityOfServiceThatDoesNotMatchIsNamed) {
  dds::Participant participant({.domain = test::OwnDomain()});
  dds::Publisher<dds::JointState> js(participant, "/PSM1/measured_js", dds::Role::kState);
  const dds::Publisher<dds::OperatingState> state(participant, "/PSM1/operating_state",
                                                  dds::Role::kState);
  const Background background([&] {
    dds::JointState sample;
    sample.position.assign(6, 0.0);
    (void)js.Write(sample);
  });
  EXPECT_THAT(Shown(CheckArm(ForArm("PSM1", 2.0))),
              AllOf(HasSubstr("a publisher on /PSM1/operating_state does not match (QoS)"),
                    HasSubstr("nobody publishes /PSM1/measured_cp"),
                    HasSubstr("nobody listens to state_command")));
}

class EndoscopeCheckTest : public testing::Test {
 protected:
  // Pictures of 64 x 48 at some 100 a second, `change`d before they are sent.
  DeviceReport Check(const std::function<void(dds::Image&)>& change, CheckOptions options) {
    dds::Participant participant({.domain = test::OwnDomain()});
    dds::Publisher<dds::Image> publisher(participant, "/ECM/image_raw", dds::Role::kImage);
    core::Random random(5);
    const Background background([&] {
      dds::Image image;
      image.stamp = dds::Stamp::Now();
      image.width = 64;
      image.height = 48;
      image.encoding = "bgr8";
      image.step = 192;
      image.data.resize(std::size_t{48} * 192);
      for (auto& value : image.data) value = static_cast<std::uint8_t>(100 + random.Below(50));
      change(image);
      (void)publisher.Write(image);
      std::this_thread::sleep_for(std::chrono::milliseconds(8));
    });
    options.endoscope = "/ECM/image_raw";
    return CheckEndoscope(options);
  }

  CheckOptions Small() {
    CheckOptions options = Options();
    vision::CameraModel camera;
    camera.width = 64;
    camera.height = 48;
    hardware::WriteIntrinsics(camera_, camera);
    options.camera = camera_;
    return options;
  }
  ~EndoscopeCheckTest() override { std::filesystem::remove(camera_); }

  std::filesystem::path camera_ =
      std::filesystem::path(testing::TempDir()) /
      (std::string("check_") + testing::UnitTest::GetInstance()->current_test_info()->name() +
       ".yaml");
};

TEST_F(EndoscopeCheckTest, GoodPicturesAreFine) {
  const DeviceReport report = Check([](dds::Image&) {}, Small());
  EXPECT_TRUE(report.ok()) << Shown(report);
  EXPECT_THAT(Shown(report), AllOf(HasSubstr("pictures a second of 64 x 48"), HasSubstr("ms old")));
}

TEST_F(EndoscopeCheckTest, NamesWrongSizeBlackFrozenAndStamps) {
  EXPECT_THAT(Shown(Check([](dds::Image&) {}, Options())),
              HasSubstr("pictures have 64 x 48 pixels, the intrinsics are for 640 x 480"));
  EXPECT_THAT(Shown(Check(
                  [](dds::Image& image) {
                    std::fill(image.data.begin() + 1, image.data.end(), std::uint8_t{3});
                  },
                  Small())),
              AllOf(HasSubstr("pictures are black"), HasSubstr("light source")));
  EXPECT_THAT(Shown(Check(
                  [](dds::Image& image) {
                    std::fill(image.data.begin(), image.data.end(), std::uint8_t{90});
                  },
                  Small())),
              HasSubstr("the same picture comes again and again"));
  EXPECT_THAT(Shown(Check([](dds::Image& image) { image.stamp = {}; }, Small())),
              HasSubstr("stamped zero"));
  EXPECT_THAT(Shown(Check([](dds::Image& image) { image.stamp.sec += 5; }, Small())),
              AllOf(HasSubstr("in the future"), HasSubstr("NTP")));
}

TEST_F(EndoscopeCheckTest, NamesWhatIsNotThere) {
  CheckOptions options = Options();
  options.find_s = 0.3;
  options.endoscope = "/ECM/image_raw";
  EXPECT_THAT(Shown(CheckEndoscope(options)),
              HasSubstr("[wrong] nobody publishes pictures on /ECM/image_raw"));
  options.endoscope = "/dev/video97";
  EXPECT_THAT(Shown(CheckEndoscope(options)),
              AllOf(HasSubstr("cannot be opened"), HasSubstr("-> is the camera")));
  options.camera = camera_;
  std::ofstream(camera_) << "image_width: 640\n";
  EXPECT_THAT(Shown(CheckEndoscope(options)), HasSubstr("image_height is missing"));
}

TEST(PlatformCheckTest, OpensThePortAndMovesOnlyAfterAsking) {
  test::SprkEmulator emulator;
  CheckOptions options = Options();
  options.platform = emulator.device();
  DeviceReport report = CheckPlatform(options);
  EXPECT_TRUE(report.ok()) << Shown(report);
  EXPECT_THAT(Shown(report), HasSubstr("never answers"));
  options.move = true;
  options.ask = [](const std::string&) { return true; };
  report = CheckPlatform(options);
  EXPECT_TRUE(report.ok()) << Shown(report);
  const auto commands = emulator.Await(3);
  ASSERT_EQ(commands.size(), 3U);
  EXPECT_EQ(commands[0].letter, 'h');
  EXPECT_EQ(commands[1].letter, 'a');
}

TEST(PlatformCheckTest, NamesAPortThatIsMissingOrNoPort) {
  CheckOptions options = Options();
  options.platform = "/dev/no-such-port";
  EXPECT_THAT(Shown(CheckPlatform(options)), HasSubstr("-> is the platform plugged in"));
  options.platform = "/dev/no; port";
  EXPECT_THAT(Shown(CheckPlatform(options)),
              AllOf(HasSubstr("[wrong] /dev/no; port: cannot be opened"),
                    HasSubstr("-> is the platform plugged in")));
  options.platform = "/dev/null";
  EXPECT_THAT(Shown(CheckPlatform(options)), HasSubstr("is not a serial port"));
}

class PlatformHomeTest : public testing::Test {
 protected:
  // What it says, and how it ends.
  std::pair<std::string, int> Home(const std::string& answer) {
    std::string said;
    HomeOptions options;
    options.platform = emulator_.device();
    options.confirms = [&](const std::string& question, const std::string& word) {
      EXPECT_THAT(question, HasSubstr(emulator_.device()));
      return answer == word;
    };
    options.say = [&](const std::string& text) { said += text; };
    options.interrupted = &interrupted_;
    const int code = RunHome(options);
    return {said, code};
  }

  test::SprkEmulator emulator_;
  std::atomic<bool> interrupted_ = false;
};

TEST_F(PlatformHomeTest, MovesOnlyOnTheOperatorsWord) {
  for (const char* answer : {"", "y", "yes", "home"}) EXPECT_EQ(Home(answer).second, 1) << answer;
  const auto [said, code] = Home("platform");
  EXPECT_EQ(code, 0);
  EXPECT_THAT(said, HasSubstr("look whether it is there"));
  const auto commands = emulator_.Await(1);
  ASSERT_EQ(commands.size(), 1U);
  EXPECT_EQ(commands[0].letter, 'h');
}

TEST_F(PlatformHomeTest, StopsOnCtrlC) {
  interrupted_ = true;
  const auto [said, code] = Home("platform");
  EXPECT_EQ(code, 1);
  EXPECT_THAT(said, HasSubstr("told to stop"));
  const auto commands = emulator_.Await(2);
  ASSERT_EQ(commands.size(), 2U);
  EXPECT_EQ(commands[1].letter, 'a') << "a pose, and not home";
}

TEST_F(PlatformHomeTest, APortThatFailsIsNamed) {
  HomeOptions options;
  options.platform = emulator_.device();
  options.confirms = [&](const std::string&, const std::string&) {
    emulator_.Unplug();
    return true;
  };
  try {
    RunHome(options);
    ADD_FAILURE() << "it went home";
  } catch (const core::Error& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr(emulator_.device()), HasSubstr("cut its power")));
  }
}

// Whoever has no keyboard cannot have typed the word.
TEST_F(PlatformHomeTest, NothingMovesWithoutATerminal) {
  const std::string command =
      std::string("echo platform | " DFR_HARDWARE " home --platform ") + emulator_.device();
  EXPECT_EQ(test::PeerProcess({"/bin/sh", "-c", command}).Await(60.0), 1);
  EXPECT_EQ(Home("platform").second, 0);
  EXPECT_EQ(emulator_.Await(1).size(), 1U) << "the second alone";
}

TEST(CheckJsonTest, SaysTheSameAsTheText) {
  DeviceReport report;
  report.device = "PSM1";
  report.findings.push_back({Finding::Level::kOk, "fine", ""});
  report.findings.push_back({Finding::Level::kWrong, "a \"word\"\n", "turn it on"});
  std::ostringstream out;
  PrintJson({report}, out);
  const nlohmann::json json = nlohmann::json::parse(out.str());
  EXPECT_FALSE(json["ok"]);
  EXPECT_EQ(json["devices"][0]["device"], "PSM1");
  EXPECT_EQ(json["devices"][0]["findings"][1]["level"], "wrong");
  EXPECT_EQ(json["devices"][0]["findings"][1]["what"], "a \"word\"\n");
  EXPECT_EQ(json["devices"][0]["findings"][1]["remedy"], "turn it on");
}

TEST(CheckProgramTest, ExitCodeTellsWhetherAllIsWell) {
  test::SprkEmulator emulator;
  EXPECT_EQ(test::PeerProcess({DFR_HARDWARE, "check", "--platform", emulator.device()}).Await(60.0),
            0);
  EXPECT_EQ(test::PeerProcess({DFR_HARDWARE, "check", "--platform", "/dev/none"}).Await(60.0), 1);
  EXPECT_EQ(test::PeerProcess({DFR_HARDWARE, "check", "--domain", std::to_string(test::OwnDomain()),
                               "--wait", "0.3"})
                .Await(60.0),
            1);
  EXPECT_GT(test::PeerProcess({DFR_HARDWARE, "check", "--domain", "900"}).Await(60.0), 1);
  EXPECT_EQ(test::PeerProcess(
                {DFR_HARDWARE, "check", "--platform", emulator.device(), "--generation", "Si"})
                .Await(60.0),
            0);
  EXPECT_GT(test::PeerProcess({DFR_HARDWARE, "check", "--generation", "Xi"}).Await(60.0), 1);
}

}  // namespace
}  // namespace dfr::apps::hardware_app
