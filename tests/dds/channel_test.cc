#include "dfr/dds/channel.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "tests/dds/domain.h"
#include "tests/dds/picture.h"
#include "tests/dds/repeat.h"
#include "tests/support/eventually.h"

namespace dfr::dds {
namespace {

using test::Eventually;

ParticipantOptions Loopback() { return {.domain = test::OwnDomain()}; }

// Returns Fast DDS's segments mapped by this process.
std::vector<std::string> SharedSegments() {
  std::vector<std::string> segments;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    if (line.find("/dev/shm/fast") != std::string::npos) segments.push_back(line);
  }
  return segments;
}

TEST(ParticipantTest, OptionsOutOfRangeAreRefused) {
  EXPECT_THROW(Participant({.domain = 233}), std::invalid_argument);
  EXPECT_THROW(Participant({.domain = -1}), std::invalid_argument);
  EXPECT_THROW(Participant({.discovery = Discovery::kServerClient, .server_address = "somewhere"}),
               std::invalid_argument);
}

// Fast DDS numbers the participants of a process without limit. Discovery must accept high numbers.
TEST(ParticipantTest, IsFoundAfterManyEarlierParticipantsOfItsProcess) {
  for (int i = 0; i < 30; ++i) {
    const Participant gone(Loopback());
  }
  Participant one(Loopback());
  Participant other(Loopback());
  const Publisher<Text> publisher(one, "/topic", Role::kEvent);
  const Subscriber<Text> subscriber(other, "/topic", Role::kEvent);
  Eventually([&] { return publisher.num_subscribers() == 1; });
}

// The watcher reports a guest before the guest's publisher, with increasing numbers, even after
// both have left.
TEST(ParticipantTest, ReportsParticipantsInOrder) {
  const Participant watcher({.domain = test::OwnDomain(), .name = "watcher"});
  const auto any = [](std::string_view topic) { return topic == "/arm/hold"; };
  {
    Participant guest({.domain = test::OwnDomain(), .name = "guest"});
    Publisher<Signal> hold(guest, "/arm/hold", Role::kRequest);
    test::Eventually([&] { return watcher.OthersPublishers(any).size() == 1; });
    const Newcomer there = watcher.OthersPublishers(any).front();
    EXPECT_EQ(there.origin, hold.origin());
    EXPECT_EQ(Describe(watcher.PublisherOf(hold.origin())),
              "'guest' at 127.0.0.1 publishes /arm/hold");
  }
  test::Eventually([&] { return watcher.OthersPublishers(any).empty(); });
  const std::vector<Newcomer> found = watcher.FoundAfter(0);
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(Describe(found[0]), "'guest' at 127.0.0.1");
  EXPECT_EQ(found[0].number, 1U);
  EXPECT_EQ(found[1].topic, "/arm/hold");
  EXPECT_EQ(found[1].number, watcher.num_found());
  EXPECT_TRUE(watcher.FoundAfter(2).empty());
  EXPECT_EQ(watcher.PublisherOf(found[1].origin).topic, "") << "it has left";
}

class ChannelTest : public testing::Test {
 protected:
  Participant first_{Loopback()};
  Participant second_{Loopback()};
};

TEST_F(ChannelTest, TopicsHaveOneTypeAndBeginWithASlash) {
  EXPECT_THROW(Publisher<Text>(first_, "no_slash", Role::kEvent), std::invalid_argument);
  const Publisher<Text> text(first_, "/topic", Role::kEvent);
  EXPECT_THROW(Publisher<Flag>(first_, "/topic", Role::kEvent), std::runtime_error);
}

// A late subscriber receives the stored events completely and in order.
TEST_F(ChannelTest, EventsReachLateJoinersInOrder) {
  Publisher<Text> publisher(first_, "/error", Role::kEvent);
  for (int i = 0; i < 20; ++i) Eventually([&] { return publisher.Write({std::to_string(i)}); });
  Subscriber<Text> subscriber(second_, "/error", Role::kEvent);
  Text text;
  for (int i = 0; i < 20; ++i) {
    Eventually([&] { return subscriber.Take(text); });
    EXPECT_EQ(text.text, std::to_string(i));
  }
  EXPECT_FALSE(subscriber.Take(text));
  EXPECT_EQ(text.text, "19");  // unchanged
}

// A console that starts later must not home its arm because of a request to another console.
TEST_F(ChannelTest, ARequestDoesNotReachLateJoiners) {
  Publisher<StringStamped> publisher(first_, "/state_command", Role::kRequest);
  Eventually([&] { return publisher.Write({{}, {}, "home"}); });
  // A subscriber that requests stored samples is not matched. Other subscribers receive new
  // samples.
  const Subscriber<StringStamped> keeps(second_, "/state_command", Role::kEvent);
  Subscriber<StringStamped> late(second_, "/state_command", Role::kRequest);
  Eventually([&] { return publisher.num_subscribers() == 1; });
  Eventually([&] { return keeps.health().incompatible == 1; });
  Eventually([&] { return publisher.Write({{}, {}, "disable"}); });
  StringStamped got;
  Eventually([&] { return late.Take(got); });
  EXPECT_EQ(got.text, "disable");
}

// The publisher is destroyed immediately after the wait.
TEST_F(ChannelTest, APublisherWaitsUntilItsLastSampleIsReceived) {
  Subscriber<Text> subscriber(second_, "/topic", Role::kRequest);
  for (int i = 0; i < 20; ++i) {
    SCOPED_TRACE(i);
    auto publisher = std::make_unique<Publisher<Text>>(first_, "/topic", Role::kRequest);
    EXPECT_TRUE(publisher->WaitUntilReceived(0.0)) << "no subscriber to wait for";
    Eventually(
        [&] { return publisher->num_subscribers() == 1 && subscriber.health().publishers == 1; });
    ASSERT_TRUE(publisher->Write({"the last"}));
    ASSERT_TRUE(publisher->WaitUntilReceived(600.0));
    publisher.reset();
    Text text;
    ASSERT_TRUE(subscriber.Take(text));
    EXPECT_EQ(text.text, "the last");
    Eventually([&] { return subscriber.health().publishers == 0; });
  }
}

TEST_F(ChannelTest, StateKeepsOnlyTheNewest) {
  Publisher<PoseStamped> publisher(first_, "/measured_cp", Role::kState);
  Subscriber<PoseStamped> subscriber(second_, "/measured_cp", Role::kState);
  Eventually([&] { return publisher.num_subscribers() == 1; });
  Eventually([&] { return subscriber.health().publishers == 1; });
  PoseStamped pose;
  for (int i = 1; i <= 50; ++i) {
    pose.position_m.x() = i;
    Eventually([&] { return publisher.Write(pose); });
  }
  PoseStamped got;
  Eventually([&] { return subscriber.TakeNewest(got) && got.position_m.x() == 50; });
  EXPECT_FALSE(subscriber.Take(got));
}

// A command that waits for a reader expires and is not executed late.
TEST_F(ChannelTest, OldCommandsExpire) {
  Publisher<PoseStamped> publisher(first_, "/servo_cp", Role::kCommand);
  Subscriber<PoseStamped> subscriber(second_, "/servo_cp", Role::kCommand);
  Eventually([&] { return publisher.num_subscribers() == 1; });
  Eventually([&] { return subscriber.health().publishers == 1; });
  PoseStamped got;
  Eventually([&] { return publisher.Write({}) && subscriber.Take(got); });
  Eventually([&] { return publisher.Write({}) && subscriber.Wait(0.0); });
  // No call takes the command that arrived. A later command may still be on its way.
  Eventually([&] { return !subscriber.Wait(0.0) && !subscriber.Take(got); });
}

// Tests a type without strings, because by default Fast DDS shares memory for such types.
TEST_F(ChannelTest, SharedMemoryIsOffByDefault) {
  const std::vector<std::string> before = SharedSegments();
  Publisher<Flag> publisher(first_, "/emergency_stop", Role::kEmergencyStop);
  Subscriber<Flag> subscriber(second_, "/emergency_stop", Role::kEmergencyStop);
  Eventually([&] { return publisher.Write({true}); });
  Flag flag;
  Eventually([&] { return subscriber.Take(flag); });
  EXPECT_EQ(SharedSegments(), before);
}

TEST(ChannelOptionsTest, ImageArrivesOverSharedMemory) {
  ParticipantOptions options = Loopback();
  options.shared_memory = true;
  Participant first(options);
  Participant second(options);
  Publisher<Image> publisher(first, "/image_raw", Role::kImage);
  Subscriber<Image> subscriber(second, "/image_raw", Role::kImage);
  Eventually([&] { return publisher.num_subscribers() == 1; });
  Eventually([&] { return subscriber.health().publishers == 1; });
  const Image image = test::LargePicture();
  Image got;
  test::RepeatUntilHeard(
      [&] { publisher.Write(image); },
      [&](double wait_s) { return subscriber.Wait(wait_s) && subscriber.Take(got); });
  EXPECT_EQ(got.data, image.data);
}

// Clients that have only the server's address find each other.
TEST(ChannelOptionsTest, DiscoveryServerIntroducesItsClients) {
  ParticipantOptions options = Loopback();
  options.server_port = static_cast<std::uint16_t>(11811 + test::OwnDomain());
  options.discovery = Discovery::kServer;
  const Participant server(options);
  options.discovery = Discovery::kServerClient;
  Participant first(options);
  Participant second(options);
  Publisher<Text> publisher(first, "/status", Role::kEvent);
  Subscriber<Text> subscriber(second, "/status", Role::kEvent);
  Eventually([&] { return publisher.Write({"here"}); });
  Text text;
  Eventually([&] { return subscriber.Take(text); });
  EXPECT_EQ(text.text, "here");
}

}  // namespace
}  // namespace dfr::dds
