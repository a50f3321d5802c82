// A secured network, from the inside and from the outside.
#include "dfr/dds/security.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <thread>

#include "dfr/dds/certificates.h"
#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/picture.h"
#include "tests/dds/repeat.h"
#include "tests/dds/security/keystore.h"
#include "tests/support/eventually.h"
#include "tests/support/message_of.h"

namespace dfr::dds {
namespace {

using test::Eventually;

constexpr const char* kServo = "/PSM1/servo_cp";
constexpr const char* kMeasured = "/PSM1/measured_cp";

PoseStamped Pose(double x) {
  PoseStamped pose;
  pose.position_m.x() = x;
  return pose;
}

// The program openssl, as a lab's administrator would call it.
testing::AssertionResult OpenSsl(const std::string& arguments) {
  const std::string command = "openssl " + arguments + " >/dev/null 2>&1";
  if (std::system(command.c_str()) == 0) return testing::AssertionSuccess();
  return testing::AssertionFailure() << command;
}

class SecurityTest : public testing::Test {
 protected:
  static ParticipantOptions With(const std::filesystem::path& folder) {
    return {.domain = test::OwnDomain(), .security = folder};
  }

  // Two ends of a lab that communicate in both directions.
  struct Lab {
    explicit Lab(const test::Keystore& keystore)
        : client(With(keystore.enclave("client"))), console(With(keystore.enclave("console"))) {}
    // Repeats commands and answers until one of each has arrived.
    void Talk() {
      bool commanded = false;
      bool measured = false;
      Eventually([&] {
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

  // Waits until both ends of a lab and `stranger` have refused each other.
  static void AwaitRefusal(const Lab& lab, const Participant& stranger, const std::string& reason) {
    for (const Participant* member : {&lab.client, &lab.console}) {
      Eventually([&] { return member->refused_peers().size() == 1; });
      EXPECT_EQ(member->refused_peers()[0].name, "stranger");
      EXPECT_THAT(member->refused_peers()[0].reason, testing::HasSubstr(reason));
    }
    Eventually([&] { return stranger.refused_peers().size() == 2; });
  }

  // The refused `stranger` tries to command and to listen. A trusted participant that joins later
  // exchanges messages during that time.
  void ExpectShutOut(Lab& lab, Participant& stranger) const {
    Publisher<PoseStamped> command(stranger, kServo, Role::kCommand);
    Subscriber<PoseStamped> spy(stranger, kMeasured, Role::kState);
    Participant friendly(With(keystore_.enclave("friend")));
    Publisher<PoseStamped> friends_command(friendly, kServo, Role::kState);
    Subscriber<PoseStamped> friends_ear(friendly, kMeasured, Role::kState);
    Subscriber<PoseStamped> heard(lab.console, kServo, Role::kRequest);
    bool client = false;
    bool friend_heard = false;
    bool friend_hears = false;
    Eventually([&] {
      command.Write(Pose(666));
      friends_command.Write(Pose(2));
      lab.command.Write(Pose(1));
      lab.state.Write(Pose(4));
      PoseStamped pose;
      EXPECT_FALSE(spy.Take(pose));
      friend_hears = friend_hears || friends_ear.Take(pose);
      while (heard.Take(pose)) {
        EXPECT_NE(pose.position_m.x(), 666.0);
        client = client || pose.position_m.x() == 1.0;
        friend_heard = friend_heard || pose.position_m.x() == 2.0;
      }
      return client && friend_heard && friend_hears;
    });
    EXPECT_EQ(command.num_subscribers(), 0);
    EXPECT_EQ(spy.health().publishers, 0);
    EXPECT_EQ(heard.health().publishers, 2);
  }

  const test::Keystore keystore_{{"client", Permission::kController},
                                 {"friend", Permission::kController},
                                 {"console", Permission::kConsole},
                                 {"button", Permission::kButton},
                                 {"monitor", Permission::kMonitor}};
};

TEST_F(SecurityTest, OpenSslAgreesWithTheCertificates) {
  const SecurityFiles files(keystore_.enclave("client"));
  const std::string ca = (keystore_.folder() / "public/ca.cert.pem").string();
  EXPECT_TRUE(OpenSsl("verify -x509_strict -CAfile " + ca + " " + files.certificate.string()));
  for (const std::filesystem::path& file : {files.permissions, files.governance}) {
    EXPECT_TRUE(OpenSsl("smime -verify -text -in " + file.string() + " -CAfile " + ca));
  }
  const test::Keystore other({});
  EXPECT_FALSE(OpenSsl("verify -CAfile " + (other.folder() / "public/ca.cert.pem").string() + " " +
                       files.certificate.string()));
}

// A picture larger than a message is divided, encrypted and reassembled.
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
    const Image sent = test::LargePicture();
    Image seen;
    Eventually([&] {
      pictures.Write({});
      return eye.Take(seen);
    });
    test::RepeatUntilHeard(
        [&] { pictures.Write(sent); },
        [&](double wait_s) { return eye.Wait(wait_s) && eye.Take(seen) && !seen.data.empty(); });
    EXPECT_TRUE(seen.data == sent.data);
  }
}

TEST_F(SecurityTest, SubscribersMayLeaveWhilePicturesAreSent) {
  for (const Role role : {Role::kImage, Role::kSensorImage}) {
    Participant camera(With(keystore_.enclave("console")));
    Participant client(With(keystore_.enclave("client")));
    Publisher<Image> pictures(camera, "/ECM/image_raw", role);
    const Image sent = test::LargePicture();
    std::atomic<bool> stop = false;
    std::thread writer([&] {
      while (!stop) pictures.Write(sent);
    });
    for (int i = 0; i < 15; ++i) {
      Subscriber<Image> eye(client, "/ECM/image_raw", role);
      Image seen;
      Eventually([&] { return eye.Take(seen); });
    }
    stop = true;
    writer.join();
  }
}

TEST_F(SecurityTest, APeerWithoutCertificateHearsAndCommandsNothing) {
  Lab lab(keystore_);
  lab.Talk();
  EXPECT_TRUE(lab.client.refused_peers().empty());
  EXPECT_TRUE(lab.console.refused_peers().empty());
  Participant stranger({.domain = test::OwnDomain(), .name = "stranger"});
  AwaitRefusal(lab, stranger, "it has no certificate");
  EXPECT_EQ(ExplainRefused(lab.client),
            "; 'stranger' is present, but not admitted: it has no certificate");
  EXPECT_EQ(lab.client.TakeRefusedPeers().size(), 1U);
  EXPECT_TRUE(lab.client.TakeRefusedPeers().empty());
  // The stranger also reports the reason: the member belongs to a secured network.
  EXPECT_THAT(stranger.refused_peers()[0].reason, testing::HasSubstr("secured network"));
  ExpectShutOut(lab, stranger);
}

TEST_F(SecurityTest, APeerOfAnotherAuthorityIsRefusedAndReported) {
  const test::Keystore other({{"client", Permission::kController}});
  Lab lab(keystore_);
  lab.Talk();
  ParticipantOptions options = With(other.enclave("client"));
  options.name = "stranger";
  Participant stranger(options);
  AwaitRefusal(lab, stranger, "authority '/CN=dfr");
  ExpectShutOut(lab, stranger);
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
        EXPECT_THAT(e.what(), testing::HasSubstr("permits it"));
        return false;
      }
    };
    for (const char* topic :
         {kServo, "/PSM2/jaw/servo_jp", "/PSM1/move_jp", "/PSM1/hold", "/PSM1/state_command",
          "/simulator/request", "/PSM1/trajectory_j/set_ratio", "/PSM1/set_base_frame",
          "/PSM1/use_gravity_compensation", "/PSM1/emulate_tool_present"}) {
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
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>(
                  [&] { const Participant participant(With(keystore_.enclave("client"))); }),
              testing::HasSubstr("permissions.p7s"));
}

}  // namespace
}  // namespace dfr::dds
