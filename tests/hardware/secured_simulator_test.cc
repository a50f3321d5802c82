// The simulated console in a secured network made by `hardware certificates`.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <string>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/support/eventually.h"
#include "tests/support/temp_folder.h"

namespace dfr::test {
namespace {

// A client that requests a state and reads the arm's messages.
class Client {
 public:
  explicit Client(const std::filesystem::path& security)
      : participant_({.domain = OwnDomain(), .name = "client", .security = security}) {}

  void Ask(const std::string& state) {
    dds::StringStamped command;
    command.stamp = dds::Stamp::Now();
    command.text = state;
    command_.Write(command);
  }
  void Listen() {
    state_.Wait(0.01);
    state_.TakeNewest(operating_);
    dds::PoseStamped pose;
    if (measured_.TakeNewest(pose)) ++poses_;
  }
  [[nodiscard]] int poses() const { return poses_; }
  [[nodiscard]] const dds::OperatingState& operating() const { return operating_; }
  dds::Participant& participant() { return participant_; }

 private:
  dds::Participant participant_;
  dds::Publisher<dds::StringStamped> command_{participant_, "/PSM1/state_command",
                                              dds::Role::kRequest};
  dds::Subscriber<dds::OperatingState> state_{participant_, "/PSM1/operating_state",
                                              dds::Role::kEvent};
  dds::Subscriber<dds::PoseStamped> measured_{participant_, "/PSM1/measured_cp", dds::Role::kState};
  dds::OperatingState operating_;
  int poses_ = 0;
};

// Takes 2 s, because DDS refuses a participant twice. Only this test commands the simulator without
// a certificate.
TEST(SecuredSimulatorTest, OnlyThoseWithCertificatesHearAndCommandTheArm) {
  const TempFolder temp;
  const std::filesystem::path folder = temp / "lab";
  const auto enclave = [&](const std::string& name) { return folder / "enclaves" / name; };
  ASSERT_EQ(PeerProcess({DFR_HARDWARE, "certificates", folder}).Await(), 0);
  // The second call overwrites no file.
  ASSERT_EQ(PeerProcess({DFR_HARDWARE, "certificates", folder}).Await(), 1);
  const std::string log = folder / "log";
  PeerProcess simulator({"/bin/sh", "-c",
                         "exec " DFR_SIMULATOR " --no-camera --homing 0.2 --domain " +
                             std::to_string(OwnDomain()) + " --security " +
                             enclave("dvrk_simulator").string() + " > " + log});
  Client member(enclave("line_tracking"));
  Eventually([&] {
    member.Ask("home");
    member.Listen();
    return member.operating().is_homed && member.poses() > 0;
  });
  EXPECT_TRUE(member.participant().refused_peers().empty());

  // After both ends have refused each other, the stranger receives nothing, while the member
  // continues to receive.
  Client stranger("");
  int poses = -1;
  Eventually([&] {
    stranger.Ask("disable");
    stranger.Listen();
    member.Listen();
    if (poses < 0 && FileText(log).find("refused 'client'") != std::string::npos &&
        !stranger.participant().refused_peers().empty()) {
      poses = member.poses();
    }
    return poses >= 0 && member.poses() > poses + 20;
  });
  EXPECT_EQ(stranger.poses(), 0);
  EXPECT_EQ(stranger.operating().state, "");
  EXPECT_EQ(member.operating().state, "ENABLED");
  EXPECT_TRUE(member.operating().is_homed);
  EXPECT_THAT(FileText(log), testing::HasSubstr("it has no certificate"));
  simulator.Signal(SIGINT);
  EXPECT_EQ(simulator.Await(), 0);
}

}  // namespace
}  // namespace dfr::test
