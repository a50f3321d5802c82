#include "check/check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <string>

#include "certificates.h"
#include "emergency_stop.h"
#include "tests/hardware/check_support.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::apps::hardware_app {
namespace {

using hardware::FrameStatus;
using test::Shown;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// Returns a picture of 64 x 48 pixels per call; every `bad_every`th is `bad`.
class FakeEndoscope final : public hardware::Endoscope {
 public:
  FrameStatus Grab(std::int64_t /*steady_ns*/, std::int64_t /*wall_ns*/,
                   hardware::Frame& frame) noexcept override {
    if (bad == FrameStatus::kNever) return bad;
    frame.width = 64;
    frame.height = 48;
    frame.age_s = age_s;
    frame.sequence = ++counts_.received;
    counts_.lost += lost_of_each;
    return counts_.received % static_cast<std::uint64_t>(bad_every) == 0 ? bad : FrameStatus::kOk;
  }
  hardware::EndoscopeCounts counts() const noexcept override { return counts_; }
  const std::string& source() const noexcept override { return source_; }

  FrameStatus bad = FrameStatus::kOk;
  int bad_every = 1;
  std::uint64_t lost_of_each = 0;
  double age_s = 0.03;

 private:
  hardware::EndoscopeCounts counts_;
  std::string source_ = "/ECM/image_raw";
};

class EndoscopeCheckTest : public testing::Test {
 protected:
  EndoscopeCheckTest() {
    options_.clock = &clock_;
    options_.endoscope = "/ECM/image_raw";
  }
  std::string Check() {
    DeviceReport report;
    LookAt(options_, {.width = 640, .height = 480}, endoscope_, report);
    return Shown(report);
  }

  test::HandMovedClock clock_;
  CheckOptions options_;
  FakeEndoscope endoscope_;
};

TEST_F(EndoscopeCheckTest, GoodPicturesAreFine) {
  EXPECT_THAT(Check(), AllOf(HasSubstr("pictures a second of 64 x 48"),
                             HasSubstr("pictures are 30.0 ms old"), Not(HasSubstr("[wrong]")),
                             Not(HasSubstr("[note]"))));
}

TEST_F(EndoscopeCheckTest, NamesWhatIsWrongWithMostPictures) {
  for (int i = 1; i <= static_cast<int>(FrameStatus::kFrozen); ++i) {
    endoscope_.bad = static_cast<FrameStatus>(i);
    const std::string shown = Check();
    EXPECT_THAT(shown, HasSubstr(hardware::Remedy(endoscope_.bad)));
    const bool ends = endoscope_.bad == FrameStatus::kEnded;
    EXPECT_THAT(shown, HasSubstr(ends ? "[note]" : "[wrong]"));
    if (endoscope_.bad == FrameStatus::kWrongSize) {
      EXPECT_THAT(shown, HasSubstr("have 64 x 48 pixels, the intrinsics are for 640 x 480"));
    } else if (endoscope_.bad == FrameStatus::kNever) {
      EXPECT_THAT(shown, HasSubstr("no program publishes pictures on /ECM/image_raw"));
    } else {
      EXPECT_THAT(shown, HasSubstr(hardware::Name(endoscope_.bad)));
    }
  }
  endoscope_.bad = FrameStatus::kAhead;
  endoscope_.age_s = -5.0;
  EXPECT_THAT(Check(), HasSubstr(": by 5.000 s"));
}

TEST_F(EndoscopeCheckTest, OccasionallyLateIsANote) {
  endoscope_.bad = FrameStatus::kOld;
  endoscope_.bad_every = 5;
  EXPECT_THAT(Check(), AllOf(HasSubstr("[note]  occasionally: "), Not(HasSubstr("[wrong]"))));
  endoscope_.bad_every = 20;
  endoscope_.lost_of_each = 1;
  EXPECT_THAT(Check(), AllOf(Not(HasSubstr("occasionally:")), HasSubstr("pictures were lost")));
}

TEST_F(EndoscopeCheckTest, NamesWhatCannotBeOpened) {
  const test::TempFolder folder;
  const std::filesystem::path camera = folder / "camera.yaml";
  options_.endoscope = "/dev/video97";
  EXPECT_THAT(Shown(CheckEndoscope(options_)),
              AllOf(HasSubstr("cannot be opened"), HasSubstr("-> plug in the camera")));
  options_.camera = camera;
  std::ofstream(camera) << "image_width: 640\n";
  EXPECT_THAT(Shown(CheckEndoscope(options_)), HasSubstr("image_height is missing"));
}

TEST(PlatformCheckTest, NamesAMissingOrInvalidPort) {
  CheckOptions options;
  for (const char* port : {"/dev/no-such-port", "/dev/no; port"}) {
    options.platform = port;
    EXPECT_THAT(Shown(CheckPlatform(options)),
                AllOf(HasSubstr(std::string("[wrong] ") + port + ": cannot be opened"),
                      HasSubstr("-> check that the platform is plugged in")));
  }
  options.platform = "/dev/null";
  EXPECT_THAT(Shown(CheckPlatform(options)), HasSubstr("is not a serial port"));
}

TEST(CheckTest, WordsOfADeviceDoNotControlTheTerminal) {
  DeviceReport report;
  report.device = "PSM1\x1b[2J";
  report.findings.push_back({Finding::Level::kWrong, "was found as \x1b]0;\a", "remove \x7f"});
  std::ostringstream out;
  Print(report, out);
  EXPECT_EQ(out.str(),
            "PSM1\\x1b[2J\n  [wrong] was found as \\x1b]0;\\x07\n          -> remove \\x7f\n");
}

TEST(CheckJsonTest, ContainsAllFindings) {
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

TEST(CertificatesTest, AMisspelledParticipantLeavesNoAuthority) {
  const test::TempFolder temp;
  for (const char* name : {"my pc:monitor", "..:monitor", ":monitor", "a/b:button"}) {
    const std::filesystem::path folder = temp / "lab";
    CertificatesOptions options;
    options.folder = folder;
    options.participants = {"line_tracking", name};
    EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] { RunCertificates(options); }),
                testing::HasSubstr("a participant's name must have"));
    EXPECT_FALSE(std::filesystem::exists(folder)) << name;
  }
}

TEST(StopWordTest, OnlyAnExactLineReleasesItAndEverythingElsePresses) {
  EXPECT_EQ(Meaning("r"), StopWord::kRelease);
  EXPECT_EQ(Meaning("q"), StopWord::kEnd);
  for (const char* line :
       {"", "x", "stop the robot", "R", " r", "r ", "rr", "Q", "quick", "\xff\xfe", "release"}) {
    EXPECT_EQ(Meaning(line), StopWord::kPress) << line;
  }
}

}  // namespace
}  // namespace dfr::apps::hardware_app
