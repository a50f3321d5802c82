#include "robot_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <sstream>
#include <string>
#include <thread>

#include "dfr/dds/emergency_stop.h"
#include "tests/dds/domain.h"

namespace dfr::apps::hardware_app {
namespace {

using testing::HasSubstr;
using testing::Not;

// What a robot's program announces while it lives.
class Program {
 public:
  explicit Program(dds::Participant& participant)
      : announcer_(participant, dds::kRunStateTopic, dds::Role::kState) {}
  void Say(const std::string& state) {
    dds::OperatingState message;
    message.stamp = dds::Stamp::Now();
    message.state = state;
    announcer_.Write(message);
  }

 private:
  dds::Publisher<dds::OperatingState> announcer_;
};

class RobotWatchTest : public testing::Test {
 protected:
  // Shows what `say` says over and over until `text` is shown, a minute at most.
  [[nodiscard]] bool Shows(const std::string& text, const std::function<void()>& say = {}) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
    while (out_.str().find(text) == std::string::npos) {
      if (std::chrono::steady_clock::now() > end) return false;
      if (say) say();
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      watch_.Show();
    }
    return true;
  }

  dds::Participant robots_{{.domain = test::OwnDomain()}};
  dds::Participant button_{{.domain = test::OwnDomain()}};
  std::ostringstream out_;
  RobotWatch watch_{button_, out_};
};

TEST_F(RobotWatchTest, ASecondProgramThatEndsSaysNothingOfTheFirst) {
  Program first(robots_);
  ASSERT_TRUE(Shows("robot: running\n", [&] { first.Say("running"); }));
  {
    Program second(robots_);
    ASSERT_TRUE(Shows("robot 2: idle\n", [&] {
      first.Say("running");
      second.Say("idle");
    }));
    second.Say(dds::kRunEnded);
    ASSERT_TRUE(Shows("robot 2: ended\n", [&] { first.Say("running"); }));
  }
  EXPECT_THAT(out_.str(), Not(HasSubstr("robot: ended")));
  EXPECT_TRUE(Shows("robot: SILENT while running")) << "it is still the one that is missed";
  EXPECT_THAT(out_.str(), Not(HasSubstr("robot 2: SILENT"))) << "it has ended in order";
}

TEST_F(RobotWatchTest, OneAfterTheOtherIsTheRobot) {
  {
    Program first(robots_);
    ASSERT_TRUE(Shows("robot: running\n", [&] { first.Say("running"); }));
    first.Say(dds::kRunEnded);
    ASSERT_TRUE(Shows("robot: ended\n"));
  }
  Program next(robots_);
  EXPECT_TRUE(Shows("robot: idle\n", [&] { next.Say("idle"); })) << out_.str();
  EXPECT_TRUE(Shows("robot: SILENT while idle"));
  EXPECT_TRUE(Shows("robot: armed\n", [&] { next.Say("armed"); })) << "it is heard again";
}

}  // namespace
}  // namespace dfr::apps::hardware_app
