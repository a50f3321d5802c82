#include "stop_datagrams.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <chrono>
#include <cstring>
#include <optional>
#include <string>
#include <thread>

#include "dfr/core/random.h"
#include "dfr/dds/emergency_stop.h"
#include "tests/dds/domain.h"
#include "tests/dds/keystore.h"

namespace dfr::dds {
namespace {

using internal::StopListener;
using internal::StopSender;
using internal::StopSenderId;
using internal::StopSocket;

std::int64_t Wall() { return Stamp::Now().nanoseconds(); }

class StopDatagramsTest : public testing::Test {
 protected:
  [[nodiscard]] ParticipantOptions Options(const std::filesystem::path& security = {}) const {
    ParticipantOptions options{.domain = domain_};
    options.security = security;
    return options;
  }
  // What a listener makes of a datagram that is there at once on this machine: nothing, or whether
  // the button is pressed.
  static std::optional<bool> Take(StopListener& listener, std::int64_t wall_ns = Wall()) {
    StopSenderId who;
    bool pressed = false;
    for (int i = 0; i < 100; ++i) {
      if (listener.Take(wall_ns, who, pressed)) return pressed;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return std::nullopt;
  }
  // The bytes that go by.
  std::string Overhear(const StopSocket& ear) {
    std::string bytes(8192, '\0');
    for (int i = 0; i < 1000; ++i) {
      const ssize_t size = ::recv(ear.get(), bytes.data(), bytes.size(), 0);
      if (size > 0) return bytes.substr(0, static_cast<std::size_t>(size));
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return {};
  }
  // Listens at the domain's port, as everybody may.
  void Bind(const StopSocket& ear) const {
    const int yes = 1;
    ::setsockopt(ear.get(), SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    const sockaddr_in any = At(INADDR_ANY);
    ASSERT_EQ(::bind(ear.get(), reinterpret_cast<const sockaddr*>(&any), sizeof any), 0);
  }
  void Say(const std::string& bytes) {
    const int yes = 1;
    ::setsockopt(mouth_.get(), SOL_SOCKET, SO_BROADCAST, &yes, sizeof yes);
    const sockaddr_in all = At(0x7fffffff);
    ASSERT_EQ(::sendto(mouth_.get(), bytes.data(), bytes.size(), 0,
                       reinterpret_cast<const sockaddr*>(&all), sizeof all),
              static_cast<ssize_t>(bytes.size()));
  }
  [[nodiscard]] sockaddr_in At(std::uint32_t address) const {
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_addr.s_addr = htonl(address);
    at.sin_port = htons(internal::StopPort(domain_));
    return at;
  }

  int domain_ = test::OwnDomain();
  StopSocket mouth_;
};

TEST_F(StopDatagramsTest, AllListenersOfADomainHearHowItStands) {
  StopListener first(Options());
  StopListener second(Options());
  StopSender sender(Options());
  ASSERT_TRUE(sender.Send(false));
  EXPECT_EQ(Take(first), false);
  EXPECT_EQ(Take(second), false);
  ASSERT_TRUE(sender.Send(true));
  EXPECT_EQ(Take(first), true);
  EXPECT_EQ(Take(second), true);
  EXPECT_EQ(Take(first), std::nullopt);
}

TEST_F(StopDatagramsTest, WhatWasSaidOnceIsNotBelievedAgain) {
  const StopSocket ear;
  Bind(ear);
  StopListener listener(Options());
  StopSender sender(Options());
  sender.Send(false);
  const std::string said = Overhear(ear);
  ASSERT_EQ(said.size(), 43U);
  ASSERT_EQ(Take(listener), false);
  Say(said);
  EXPECT_EQ(Take(listener), std::nullopt);
  sender.Send(true);
  EXPECT_EQ(Take(listener), true);
  Say(said);
  EXPECT_EQ(Take(listener), std::nullopt) << "older than what came since";
}

TEST_F(StopDatagramsTest, WhatIsNotOfNowIsPassedOver) {
  StopListener listener(Options());
  StopSender sender(Options());
  sender.Send(false);
  EXPECT_EQ(Take(listener, Wall() + 3'000'000'000), std::nullopt);
  sender.Send(false);
  EXPECT_EQ(Take(listener, Wall() - 3'000'000'000), std::nullopt);
  sender.Send(false);
  EXPECT_EQ(Take(listener), false);
}

// Seeded: random bytes, and good datagrams that are cut, longer or changed by a byte.
TEST_F(StopDatagramsTest, NothingMalformedIsBelieved) {
  const StopSocket ear;
  Bind(ear);
  StopListener listener(Options());
  StopSender sender(Options());
  core::Random random(1);
  StopSenderId who;
  bool pressed = false;
  for (int n = 0; n < 20'000; ++n) {
    std::string bytes(random.Below(200), '\0');
    for (char& byte : bytes) byte = static_cast<char>(random.Below(256));
    if (n % 2 == 0) bytes.replace(0, std::min<std::size_t>(8, bytes.size()), "dfrstop1", 8);
    if (bytes.empty()) continue;
    Say(bytes);
    EXPECT_FALSE(listener.Take(Wall(), who, pressed));
    char drop[8192];
    while (::recv(ear.get(), drop, sizeof drop, 0) > 0) {
    }
  }
  sender.Send(false);
  const std::string good = Overhear(ear);
  Say(good + "x");
  Say(good.substr(0, good.size() - 1));
  EXPECT_EQ(Take(listener), false) << "the good one alone";
  EXPECT_EQ(Take(listener), std::nullopt);
}

TEST_F(StopDatagramsTest, InASecuredNetworkOnlyTheLabIsHeard) {
  const test::Keystore lab = {{"line_tracking", Permission::kController},
                              {"stop", Permission::kButton}};
  const test::Keystore others = {{"stop", Permission::kButton}};
  StopListener listener(Options(lab.enclave("line_tracking")));
  StopSender nobody(Options());
  StopSender foreign(Options(others.enclave("stop")));
  nobody.Send(true);
  foreign.Send(true);
  EXPECT_EQ(Take(listener), std::nullopt);
  const StopSocket ear;
  Bind(ear);
  StopSender sender(Options(lab.enclave("stop")));
  sender.Send(false);
  EXPECT_EQ(Take(listener), false);
  std::string said = Overhear(ear);
  // A later number, a press: with the old signature.
  said[31] = static_cast<char>(said[31] + 1);
  said[40] = 1;
  Say(said);
  EXPECT_EQ(Take(listener), std::nullopt);
  sender.Send(true);
  EXPECT_EQ(Take(listener), true);
  StopListener unsecured(Options());
  sender.Send(true);
  EXPECT_EQ(Take(unsecured), std::nullopt) << "it cannot know whose it is";
}

// -- the two ways together ------------------------------------------------------------------------

class TwoWaysTest : public StopDatagramsTest {
 protected:
  // Says over DDS, the datagrams or both that nothing is pressed, for as long as it takes.
  bool Until(EmergencyStop wanted, bool dds, bool datagrams, bool pressed = false) {
    for (int i = 0; i < 4'000; ++i) {
      if (dds) publisher_.Write({false});
      if (datagrams) sender_.Send(pressed);
      if (receiver_.Check(++now_ns_) == wanted) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }

  Participant operator_{{.domain = domain_}};
  Participant robot_{{.domain = domain_}};
  Publisher<Flag> publisher_{operator_, kEmergencyStopTopic, Role::kEmergencyStop};
  StopSender sender_{Options()};
  EmergencyStopReceiver receiver_{robot_, 0.1};
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(TwoWaysTest, NeitherAloneIsEnough) {
  EXPECT_TRUE(Until(EmergencyStop::kClear, true, true));
  now_ns_ += 200'000'000;
  ASSERT_TRUE(Until(EmergencyStop::kSilent, true, false));
  for (int i = 0; i < 20; ++i) {
    publisher_.Write({false});
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    EXPECT_EQ(receiver_.Check(now_ns_), EmergencyStop::kSilent);
  }
  EXPECT_TRUE(receiver_.only_datagrams_silent());
  EXPECT_TRUE(Until(EmergencyStop::kClear, true, true));
  now_ns_ += 200'000'000;
  for (int i = 0; i < 20; ++i) {
    sender_.Send(false);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    EXPECT_EQ(receiver_.Check(now_ns_), EmergencyStop::kSilent);
  }
  EXPECT_FALSE(receiver_.only_datagrams_silent());
}

TEST_F(TwoWaysTest, APressOnEitherWayStops) {
  EXPECT_TRUE(Until(EmergencyStop::kClear, true, true));
  EXPECT_TRUE(Until(EmergencyStop::kPressed, true, true, true)) << "by datagrams alone";
  receiver_.Acknowledge();
  EXPECT_TRUE(Until(EmergencyStop::kClear, true, true));
}

TEST_F(TwoWaysTest, WhereDatagramsDoNotGoDdsIsEnoughIfSaid) {
  EmergencyStopReceiver receiver(robot_, 0.1, kEmergencyStopTopic, false);
  EmergencyStop found = EmergencyStop::kSilent;
  for (int i = 0; i < 4'000 && found != EmergencyStop::kClear; ++i) {
    publisher_.Write({false});
    found = receiver.Check(now_ns_);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  EXPECT_EQ(found, EmergencyStop::kClear);
}

}  // namespace
}  // namespace dfr::dds
