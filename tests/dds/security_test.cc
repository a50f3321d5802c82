// A secured network, as its users and as those who do not belong to it see it.
#include "dfr/dds/security.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <thread>

#include "dfr/dds/certificates.h"
#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/keystore.h"
#include "tests/dds/peer_process.h"

namespace dfr::dds {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::seconds kPatience(60);  // of a machine that is busy with other things
constexpr std::chrono::milliseconds kPause(20);
constexpr const char* kServo = "/PSM1/servo_cp";
constexpr const char* kMeasured = "/PSM1/measured_cp";

PoseStamped Pose(double x) {
  PoseStamped pose;
  pose.position_m.x() = x;
  return pose;
}

template <typename Condition>
bool Eventually(Condition&& condition) {
  const auto end = Clock::now() + kPatience;
  while (Clock::now() < end) {
    if (condition()) return true;
    std::this_thread::sleep_for(kPause);
  }
  return false;
}

class SecurityTest : public testing::Test {
 protected:
  static ParticipantOptions With(const std::filesystem::path& folder) {
    return {.domain = test::OwnDomain(), .security = folder};
  }

  // The two ends of a lab, talking both ways.
  struct Lab {
    explicit Lab(const test::Keystore& keystore)
        : client(With(keystore.enclave("client"))), console(With(keystore.enclave("console"))) {}
    // Commands and answers go on until one of each has arrived.
    [[nodiscard]] bool Talks() {
      bool commanded = false;
      bool measured = false;
      return Eventually([&] {
        command.Write(Pose(1));
        state.Write(Pose(4));
        PoseStamped pose;
        commanded = commanded || (heard.Take(pose) && pose.position_m.x() == 1.0);
        measured = measured || (seen.Take(pose) && pose.position_m.x() == 4.0);
        return commanded && measured;
      });
    }

    Participant client;
    Participant console;
    Publisher<PoseStamped> command{client, kServo, Role::kCommand};
    Subscriber<PoseStamped> heard{console, kServo, Role::kCommand};
    Publisher<PoseStamped> state{console, kMeasured, Role::kState};
    Subscriber<PoseStamped> seen{client, kMeasured, Role::kState};
  };

  // Both ends of a lab talk on while `stranger` tries to command and to listen, for so long that a
  // friend would have been found several times.
  static void ExpectShutOut(Lab& lab, Participant& stranger) {
    Publisher<PoseStamped> command(stranger, kServo, Role::kCommand);
    Subscriber<PoseStamped> spy(stranger, kMeasured, Role::kState);
    Subscriber<PoseStamped> heard(lab.console, kServo, Role::kState);
    const auto end = Clock::now() + std::chrono::seconds(2);
    while (Clock::now() < end) {
      command.Write(Pose(666));
      lab.command.Write(Pose(1));
      lab.state.Write(Pose(4));
      PoseStamped pose;
      ASSERT_FALSE(spy.Take(pose));
      while (heard.Take(pose)) ASSERT_EQ(pose.position_m.x(), 1.0);
      std::this_thread::sleep_for(kPause);
    }
    EXPECT_EQ(command.num_subscribers(), 0);
    EXPECT_EQ(spy.health().publishers, 0);
    EXPECT_EQ(heard.health().publishers, 1);
    EXPECT_TRUE(lab.Talks());
  }

  const test::Keystore keystore_{{"client", Permission::kController},
                                 {"console", Permission::kConsole},
                                 {"button", Permission::kButton},
                                 {"monitor", Permission::kMonitor}};
};

TEST_F(SecurityTest, ThoseWithCertificatesOfOneAuthorityTalk) {
  Lab lab(keystore_);
  EXPECT_TRUE(lab.Talks());
  EXPECT_TRUE(lab.client.refused_peers().empty());
  EXPECT_TRUE(lab.console.refused_peers().empty());
}

// Larger than what is sent at a time: it is cut up, encrypted and put together again.
TEST_F(SecurityTest, PicturesArriveWhole) {
  for (const bool shared_memory : {false, true}) {
    SCOPED_TRACE(shared_memory ? "shared memory" : "UDP");
    ParticipantOptions camera_options = With(keystore_.enclave("console"));
    ParticipantOptions client_options = With(keystore_.enclave("client"));
    camera_options.shared_memory = shared_memory;
    client_options.shared_memory = shared_memory;
    Participant camera(camera_options);
    Participant client(client_options);
    Publisher<Image> pictures(camera, "/ECM/image_raw", Role::kImage);
    Subscriber<Image> eye(client, "/ECM/image_raw", Role::kImage);
    Image sent;
    sent.height = 480;
    sent.width = 640;
    sent.encoding = "bgr8";
    sent.step = 1920;
    sent.data.resize(std::size_t{480} * 1920);
    for (std::size_t i = 0; i < sent.data.size(); ++i) {
      sent.data[i] = static_cast<std::uint8_t>(i * 31 + i / 1920);
    }
    Image seen;
    ASSERT_TRUE(Eventually([&] {
      if (pictures.num_subscribers() > 0) pictures.Write(sent);
      // Long enough for lost parts to be repeated: the next picture would replace it.
      return eye.Wait(0.5) && eye.Take(seen);
    }));
    EXPECT_EQ(seen.encoding, "bgr8");
    EXPECT_TRUE(seen.data == sent.data);
  }
}

TEST_F(SecurityTest, APeerWithoutCertificateHearsAndCommandsNothing) {
  Lab lab(keystore_);
  ASSERT_TRUE(lab.Talks());
  Participant stranger({.domain = test::OwnDomain(), .name = "stranger"});
  ExpectShutOut(lab, stranger);
  for (const Participant* member : {&lab.client, &lab.console}) {
    ASSERT_EQ(member->refused_peers().size(), 1U);
    EXPECT_EQ(member->refused_peers()[0].name, "stranger");
    EXPECT_EQ(member->refused_peers()[0].reason, "it has no certificate");
    EXPECT_EQ(ExplainRefused(*member),
              "; 'stranger' is there, and not admitted: it has no certificate");
  }
  EXPECT_EQ(lab.client.TakeRefusedPeers().size(), 1U);
  EXPECT_TRUE(lab.client.TakeRefusedPeers().empty());
  // It is told, too, why it hears nothing.
  ASSERT_EQ(stranger.refused_peers().size(), 2U);
  EXPECT_THAT(stranger.refused_peers()[0].reason, testing::HasSubstr("secured network"));
}

TEST_F(SecurityTest, APeerOfAnotherAuthorityIsRefusedAndReported) {
  const test::Keystore other({{"client", Permission::kController}});
  Lab lab(keystore_);
  ASSERT_TRUE(lab.Talks());
  ASSERT_TRUE(lab.console.refused_peers().empty());
  ParticipantOptions options = With(other.enclave("client"));
  options.name = "stranger";
  Participant stranger(options);
  ExpectShutOut(lab, stranger);
  for (const Participant* member : {&lab.client, &lab.console}) {
    ASSERT_EQ(member->refused_peers().size(), 1U);
    EXPECT_EQ(member->refused_peers()[0].name, "stranger");
    EXPECT_THAT(member->refused_peers()[0].reason, testing::HasSubstr("authority '/CN=dfr"));
  }
  EXPECT_EQ(stranger.refused_peers().size(), 2U);
}

TEST_F(SecurityTest, APeerOfAnotherImplementationWithoutCertificateIsShutOut) {
  Participant client(With(keystore_.enclave("client")));
  Publisher<PoseStamped> ask(client, "/peer/ask/pose", Role::kCommand);
  Subscriber<PoseStamped> answers(client, "/peer/answer/pose", Role::kState);
  const test::PeerProcess peer({DFR_CYCLONE_PEER, std::to_string(test::OwnDomain())});
  {
    // It is there, for those without security.
    Participant open({.domain = test::OwnDomain()});
    Publisher<PoseStamped> open_ask(open, "/peer/ask/pose", Role::kCommand);
    ASSERT_TRUE(Eventually([&] { return open_ask.num_subscribers() == 1; }));
  }
  const auto end = Clock::now() + std::chrono::seconds(2);
  while (Clock::now() < end) {
    ask.Write({});
    PoseStamped pose;
    ASSERT_FALSE(answers.Take(pose));
    std::this_thread::sleep_for(kPause);
  }
  EXPECT_EQ(ask.num_subscribers(), 0);
  EXPECT_EQ(answers.health().publishers, 0);
  const auto refused = client.refused_peers();
  EXPECT_TRUE(std::any_of(refused.begin(), refused.end(), [](const RefusedPeer& stranger) {
    return stranger.reason == "it has no certificate";
  }));
}

TEST_F(SecurityTest, PermissionsDecideWhoMayPublishWhat) {
  struct Case {
    const char* participant;
    bool commands;
    bool measures;
    bool stops;
  };
  for (const Case& expected :
       {Case{"client", true, false, true}, Case{"console", false, true, false},
        Case{"button", false, false, true}, Case{"monitor", false, false, false}}) {
    SCOPED_TRACE(expected.participant);
    Participant participant(With(keystore_.enclave(expected.participant)));
    const auto may_publish = [&](const std::string& topic) {
      try {
        const Publisher<PoseStamped> publisher(participant, topic, Role::kState);
        return true;
      } catch (const std::runtime_error& e) {
        EXPECT_THAT(e.what(), testing::HasSubstr(topic));
        EXPECT_THAT(e.what(), testing::HasSubstr("permitted"));
        return false;
      }
    };
    for (const char* topic : {kServo, "/PSM2/jaw/servo_jp", "/PSM1/move_jp", "/PSM1/hold",
                              "/PSM1/state_command", "/simulator/request"}) {
      EXPECT_EQ(may_publish(topic), expected.commands) << topic;
    }
    for (const char* topic : {kMeasured, "/PSM1/local/setpoint_cp", "/PSM1/operating_state",
                              "/ECM/image_raw", "/ECM/camera_info", "/simulator/reply"}) {
      EXPECT_EQ(may_publish(topic), expected.measures) << topic;
    }
    EXPECT_EQ(may_publish("/emergency_stop"), expected.stops);
    for (const char* topic : {kServo, kMeasured, "/emergency_stop"}) {
      EXPECT_NO_THROW(Subscriber<PoseStamped>(participant, topic, Role::kState)) << topic;
    }
  }
}

TEST_F(SecurityTest, AFaultyFolderIsRefusedByName) {
  std::filesystem::remove(SecurityFiles(keystore_.enclave("client")).permissions);
  try {
    const Participant participant(With(keystore_.enclave("client")));
    FAIL() << "it was accepted";
  } catch (const std::runtime_error& e) {
    EXPECT_THAT(e.what(), testing::HasSubstr("permissions.p7s"));
  }
}

}  // namespace
}  // namespace dfr::dds
