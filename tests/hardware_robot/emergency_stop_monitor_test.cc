#include "dfr/hardware/emergency_stop_monitor.h"

#include <gtest/gtest.h>

#include <optional>
#include <string_view>

#include "tests/dds/domain.h"
#include "tests/support/eventually.h"

namespace dfr::hardware {
namespace {

TEST(EmergencyStopMonitorTest, PublishesTheLoopsStateAndItsEnd) {
  dds::Participant network({.domain = test::OwnDomain()});
  dds::Subscriber<dds::OperatingState> listener(network, dds::kRunStateTopic, dds::Role::kState);
  std::optional<EmergencyStopMonitor> monitor;
  monitor.emplace(network, false, 1.0);
  dds::OperatingState heard;
  test::Eventually([&] {
    monitor->Beat(runtime::RunState::kHolding);
    return listener.TakeNewest(heard) && heard.state == "holding";
  });
  EXPECT_TRUE(monitor->Report().finding.ok()) << "there is no stop to listen to";
  monitor.reset();
  test::Eventually([&] { return listener.TakeNewest(heard) && heard.state == dds::kRunEnded; });
}

TEST(EmergencyStopMonitorTest, AStopIsSilentUntilHeardAndPressedUntilAcknowledged) {
  dds::Participant network({.domain = test::OwnDomain()});
  EmergencyStopMonitor monitor(network, true, 10.0);
  EXPECT_EQ(monitor.Report().finding.reason, runtime::HoldReason::kEmergencyStopSilent);
  dds::EmergencyStopButton button(network);
  const auto becomes = [&](runtime::HoldReason reason) {
    test::Eventually([&] {
      button.Beat();
      return monitor.Report().finding.reason == reason;
    });
  };
  becomes(runtime::HoldReason::kNone);
  button.Press();
  button.Release();
  becomes(runtime::HoldReason::kEmergencyStop);  // a press outlasts an immediate release
  test::Eventually([&] {
    button.Beat();
    monitor.Acknowledge();
    return monitor.Report().finding.ok();
  });
}

// DDS has no limit on the age of a message.
TEST(EmergencyStopMonitorTest, AClockThatIsWrongIsNamed) {
  dds::Participant network({.domain = test::OwnDomain()});
  EmergencyStopMonitor monitor(network, true, 10.0);
  dds::EmergencyStopButton button(network);
  test::Eventually([&] {
    button.Beat(dds::Stamp::Now().nanoseconds() - 5'000'000'000);
    return monitor.Report().finding.detail.find("clocks differ") != std::string_view::npos;
  });
  EXPECT_EQ(monitor.Report().finding.reason, runtime::HoldReason::kEmergencyStopSilent);
}

}  // namespace
}  // namespace dfr::hardware
