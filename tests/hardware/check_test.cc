#include "check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <thread>

#include "dfr/core/random.h"
#include "dfr/dds/channel.h"
#include "dfr/hardware/intrinsics_file.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/hardware_stewart/sprk_emulator.h"

namespace dfr::apps {
namespace {

using Clock = std::chrono::steady_clock;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

CheckOptions Options() {
  CheckOptions options;
  options.network.domain = test::OwnDomain();
  options.find_s = 20.0;  // of a machine that is busy with other things
  options.listen_s = 0.4;
  return options;
}

// `find_s` is waited for in vain where something is missing.
CheckOptions ForArm(const std::string& arm = "PSM1", double find_s = 20.0) {
  CheckOptions options = Options();
  options.find_s = find_s;
  options.arm = arm;
  return options;
}

std::string Shown(const DeviceReport& report) {
  std::ostringstream out;
  Print(report, out);
  return out.str();
}

// Something that goes on in a thread of its own while the test checks.
class Background {
 public:
  explicit Background(const std::function<void()>& step)
      : thread_([this, step] {
          while (!stop_) {
            step();
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
          }
        }) {}
  ~Background() {
    stop_ = true;
    thread_.join();
  }
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

class ArmCheckTest : public testing::Test {
 protected:
  void Change(const std::function<void()>& change) {
    const std::lock_guard lock(mutex_);
    change();
  }

  std::mutex mutex_;
  sim::PsmConsole console_{{.arm = "PSM1", .homing_s = 0.1}};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  sim::PsmConsoleServer server_{participant_, console_};
  Clock::time_point last_ = Clock::now();
  Background background_{[this] {
    const auto now = Clock::now();
    const std::lock_guard lock(mutex_);
    server_.Tick(std::min(0.05, std::chrono::duration<double>(now - last_).count()));
    last_ = now;
  }};
};

TEST_F(ArmCheckTest, FindsTheConsoleAndSaysToHome) {
  const DeviceReport report = CheckArm(ForArm());
  EXPECT_FALSE(report.ok());
  EXPECT_THAT(Shown(report), AllOf(HasSubstr("6 of the console's topics found"),
                                   HasSubstr("[wrong] the arm is DISABLED"), HasSubstr("--home")));
}

TEST_F(ArmCheckTest, HomesAndMovesOnlyAfterAsking) {
  CheckOptions options = ForArm();
  options.home = options.move = true;
  int asked = 0;
  options.ask = [&](const std::string&) {
    ++asked;
    return false;
  };
  EXPECT_FALSE(CheckArm(options).ok());
  EXPECT_EQ(asked, 1);
  Change([&] { EXPECT_FALSE(console_.homed()); });
  options.ask = [&](const std::string&) {
    ++asked;
    return true;
  };
  const DeviceReport report = CheckArm(options);
  EXPECT_TRUE(report.ok()) << Shown(report);
  EXPECT_EQ(asked, 3);
  EXPECT_THAT(Shown(report), HasSubstr("told to insert by 2.0 mm, the arm moved"));
  Change([&] { EXPECT_NEAR(console_.setpoint_joints()[2], 0.12, 1e-9); });
}

TEST_F(ArmCheckTest, NamesFaultInTheConsolesWords) {
  Change([&] {
    console_.StateCommand("home");
    console_.Fail("the brake is stuck");
  });
  EXPECT_THAT(Shown(CheckArm(ForArm())),
              AllOf(HasSubstr("FAULT"), HasSubstr("\"PSM1: the brake is stuck\""),
                    HasSubstr("disable, home")));
}

TEST_F(ArmCheckTest, NamesWhatIsWrongWithTheSamples) {
  Change([&] { console_.StateCommand("home"); });
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  sim::ConsoleFaults faults;
  faults.delay_s = 1.0;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("s behind this machine's clock"));
  faults = {};
  faults.invalid = true;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("stamped zero though the arm is homed"));
  faults = {};
  faults.corrupt = true;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("not finite"));
  faults = {};
  faults.drop = 0.9;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("a console publishes 100 times"));
}

TEST_F(ArmCheckTest, NamesOtherClientsAndASecondConsole) {
  Change([&] { console_.StateCommand("home"); });
  const dds::Publisher<dds::PoseStamped> other(participant_, "/PSM1/servo_cp", dds::Role::kCommand);
  const dds::Publisher<dds::JointState> console(participant_, "/PSM1/measured_js",
                                                dds::Role::kState);
  EXPECT_THAT(Shown(CheckArm(ForArm())),
              AllOf(HasSubstr("someone else can command the arm"),
                    HasSubstr("2 publishers on /PSM1/measured_js"), HasSubstr("but one")));
}

TEST_F(ArmCheckTest, AnotherArmsNameIsNamed) {
  EXPECT_THAT(Shown(CheckArm(ForArm("PSM2", 1.0))),
              AllOf(HasSubstr("nobody publishes /PSM2/measured_js"), HasSubstr("there is PSM1")));
}

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
  options.platform = "/dev/null";
  EXPECT_THAT(Shown(CheckPlatform(options)), HasSubstr("is not a serial port"));
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
}

}  // namespace
}  // namespace dfr::apps
