// The emergency stop on the loopback, over DDS and in datagrams.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <cstdint>
#include <optional>
#include <string>

#include "dfr/dds/emergency_stop.h"
#include "stop_datagrams.h"
#include "tests/dds/domain.h"
#include "tests/support/eventually.h"

namespace dfr::dds {
namespace {

using internal::StopListener;
using internal::StopSender;
using internal::StopSenderId;
using internal::StopSocket;
using test::Eventually;

constexpr std::int64_t kWall = 1'700'000'000'000'000'000;

class StopWaysTest : public testing::Test {
 protected:
  int domain_ = test::OwnDomain();
  Participant operator_{{.domain = domain_}};
  Participant robot_{{.domain = domain_}};
  Publisher<Flag> publisher_{operator_, kEmergencyStopTopic, Role::kEmergencyStop};
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(StopWaysTest, DdsAloneIsEnoughOnlyIfConfigured) {
  EmergencyStopReceiver both(robot_, 0.1);
  EmergencyStopReceiver dds(robot_, 0.1, kEmergencyStopTopic, false);
  Eventually([&] {
    publisher_.Write({false});
    EXPECT_EQ(both.Check(now_ns_, kWall), EmergencyStop::kSilent);
    const EmergencyStop found = dds.Check(now_ns_, kWall);
    return found == EmergencyStop::kClear && both.num_buttons() == 1;
  });
  EXPECT_TRUE(both.only_datagrams_silent());
}

TEST_F(StopWaysTest, APressInDatagramsAloneStops) {
  StopSender sender({.domain = domain_});
  EmergencyStopReceiver receiver(robot_, 0.1);
  const auto until = [&](EmergencyStop wanted, bool pressed) {
    Eventually([&] {
      publisher_.Write({false});
      sender.Send(pressed, kWall);
      return receiver.Check(now_ns_, kWall) == wanted;
    });
  };
  until(EmergencyStop::kClear, false);
  until(EmergencyStop::kPressed, true);
}

// A late robot must not move before it has received the state of the stop.
TEST_F(StopWaysTest, LateJoinersLearnThatItIsPressed) {
  Eventually([&] { return publisher_.Write({true}); });
  EmergencyStopReceiver late(robot_, 0.1);
  Eventually([&] {  // without a further message
    const EmergencyStop found = late.Check(now_ns_, kWall);
    EXPECT_NE(found, EmergencyStop::kClear);
    return found == EmergencyStop::kPressed;
  });
}

class StopSocketsTest : public testing::Test {
 protected:
  // Waits for the next valid datagram. Returns true if the button is pressed.
  static bool Await(StopListener& listener) {
    StopSenderId who;
    bool pressed = false;
    Eventually([&] { return listener.Take(kWall, who, pressed); });
    return pressed;
  }
  static bool Hears(StopListener& listener) {
    StopSenderId who;
    bool pressed = false;
    return listener.Take(kWall, who, pressed);
  }

  ParticipantOptions options_{.domain = test::OwnDomain()};
};

TEST_F(StopSocketsTest, AllListenersOfADomainHearTheState) {
  StopListener first(options_);
  StopListener second(options_);
  StopSender sender(options_);
  for (const bool pressed : {false, true}) {
    ASSERT_TRUE(sender.Send(pressed, kWall));
    EXPECT_EQ(Await(first), pressed);
    EXPECT_EQ(Await(second), pressed);
  }
  EXPECT_FALSE(Hears(first));
}

// A listener discards up to sixteen datagrams per call, and accepts the valid datagram that
// follows.
TEST_F(StopSocketsTest, ForeignDatagramsAreIgnored) {
  const StopSocket mouth;
  const int yes = 1;
  ::setsockopt(mouth.get(), SOL_SOCKET, SO_BROADCAST, &yes, sizeof yes);
  sockaddr_in all{};
  all.sin_family = AF_INET;
  all.sin_addr.s_addr = htonl(0x7fffffff);
  all.sin_port = htons(internal::StopPort(options_.domain));
  StopListener listener(options_);
  StopSender sender(options_);
  for (const std::size_t size : {0U, 1U, 43U, 4096U, 4097U}) {
    for (int n = 0; n < 4; ++n) {
      const std::string bytes = "dfrstop1" + std::string(size, 'x');
      ASSERT_EQ(::sendto(mouth.get(), bytes.data(), size, 0,
                         reinterpret_cast<const sockaddr*>(&all), sizeof all),
                static_cast<ssize_t>(size));
    }
  }
  ASSERT_TRUE(sender.Send(true, kWall));
  EXPECT_FALSE(Hears(listener)) << "the first sixteen";
  EXPECT_TRUE(Await(listener));
  EXPECT_FALSE(Hears(listener));
}

}  // namespace
}  // namespace dfr::dds
