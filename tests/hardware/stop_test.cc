// `hardware stop` as a program.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>
#include <string>
#include <string_view>

#include "dfr/dds/emergency_stop.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/support/eventually.h"
#include "tests/support/temp_folder.h"

namespace dfr {
namespace {

using dds::EmergencyStop;

class StopTest : public testing::Test {
 protected:
  // Waits, without advancing the time, until the receiver reports `wanted`.
  void Hears(EmergencyStop wanted) {
    test::Eventually([&] { return receiver_.Check(now_ns_) == wanted; });
  }
  // Advances the time until the silence is long enough.
  void HearsNothingAnyMore() {
    test::Eventually(
        [&] { return receiver_.Check(now_ns_ += 10'000'000) == EmergencyStop::kSilent; });
  }

  const int domain_ = test::OwnDomain();
  dds::Participant robot_{{.domain = domain_}};
  dds::EmergencyStopReceiver receiver_{robot_, 1.0};
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(StopTest, AnUnattendedStopReportsClearAndItsDeathStops) {
  test::PeerProcess stop(
      {DFR_HARDWARE, "stop", "--unattended", "--domain", std::to_string(domain_)});
  Hears(EmergencyStop::kClear);
  stop.Signal(SIGSTOP);
  HearsNothingAnyMore();
  stop.Signal(SIGCONT);
  Hears(EmergencyStop::kClear);
  stop.Signal(SIGINT);
  EXPECT_EQ(stop.Await(), 0);
  HearsNothingAnyMore();
}

// This process types on the program's keyboard.
class TypedStopTest : public StopTest {
 protected:
  TypedStopTest() {
    EXPECT_EQ(::mkfifo((folder_ / "typed").c_str(), 0600), 0);
    keyboard_ = ::open((folder_ / "typed").c_str(), O_RDWR | O_CLOEXEC);
  }
  ~TypedStopTest() override { EndOfInput(); }
  void Type(std::string_view text) const {
    EXPECT_EQ(::write(keyboard_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }
  void EndOfInput() {
    if (keyboard_ >= 0) ::close(keyboard_);
    keyboard_ = -1;
  }
  [[nodiscard]] bool Shows(const std::string& text) const {
    return test::FileText(folder_ / "shown").find(text) != std::string::npos;
  }

  const test::TempFolder folder_;
  int keyboard_ = -1;
};

TEST_F(TypedStopTest, PressesReleasesAndShowsTheRobotsState) {
  test::PeerProcess stop({"/bin/sh", "-c",
                          "exec " DFR_HARDWARE " stop --domain " + std::to_string(domain_) + " < " +
                              (folder_ / "typed").string() + " > " + (folder_ / "shown").string()});
  Hears(EmergencyStop::kClear);
  for (const char* typed : {"\n", "r\n\n", "stop\n"}) {
    SCOPED_TRACE(typed);
    Type(typed);
    Hears(EmergencyStop::kPressed);
    Type("r\n");
    test::Eventually([&] {
      receiver_.Acknowledge();
      return receiver_.Check(now_ns_) == EmergencyStop::kClear;
    });
  }
  {
    dds::Publisher<dds::OperatingState> states(robot_, dds::kRunStateTopic, dds::Role::kState);
    test::Eventually([&] {
      dds::OperatingState state;
      state.stamp = dds::Stamp::Now();
      state.state = "running";
      states.Write(state);
      return Shows("robot: running\n");
    });
  }
  test::Eventually([&] { return Shows("robot: SILENT while running"); });
  EndOfInput();
  Hears(EmergencyStop::kPressed);
  EXPECT_EQ(stop.Await(), 0);
}

}  // namespace
}  // namespace dfr
