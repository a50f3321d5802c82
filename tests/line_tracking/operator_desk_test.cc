// The operator of a robot at the terminal: what is typed, and what it lets the robot do.
#include "operator_desk.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <string>
#include <string_view>
#include <thread>

#include "tests/robot/fake_robot.h"

namespace dfr::apps::line_tracking {
namespace {

using runtime::HoldReason;
using runtime::RunState;
using test::FakeRobot;
using testing::HasSubstr;

// A pipe whose reading end does not wait.
class Pipe {
 public:
  Pipe() {
    EXPECT_EQ(::pipe(ends_.data()), 0);
    ::fcntl(in(), F_SETFL, O_NONBLOCK);
  }
  ~Pipe() {
    ::close(ends_[0]);
    CloseOut();
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;

  [[nodiscard]] int in() const { return ends_[0]; }
  [[nodiscard]] int out() const { return ends_[1]; }
  void Type(std::string_view text) const {
    EXPECT_EQ(::write(out(), text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }
  void CloseOut() {
    if (ends_[1] >= 0) ::close(ends_[1]);
    ends_[1] = -1;
  }
  [[nodiscard]] std::string Text() const {
    std::string text;
    std::array<char, 1024> part;
    for (ssize_t size = 0; (size = ::read(in(), part.data(), part.size())) > 0;) {
      text.append(part.data(), static_cast<std::size_t>(size));
    }
    return text;
  }

 private:
  std::array<int, 2> ends_{};
};

class OperatorDeskTest : public testing::Test {
 protected:
  // After some periods of waiting at the prompt this is typed there.
  void TypeLater(std::string_view text) {
    robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
    robot_.clock.plan = [this, text] { typed_.Type(text); };
  }
  void HoldFor(HoldReason reason) {
    ASSERT_EQ(robot_.loop.Start(), HoldReason::kNone);
    robot_.loop.Hold(reason, "for the test");
    robot_.loop.Idle(1.0);
  }

  FakeRobot robot_;
  Pipe typed_;
  Pipe shown_;
  runtime::Keyboard keyboard_{typed_.in()};
  Screen screen_{shown_.out()};
  std::atomic<bool> interrupted_ = false;
  OperatorDesk desk_{keyboard_, screen_, interrupted_};
};

TEST_F(OperatorDeskTest, EnterStartsAfterAnEpisodeThatEndedAsEpisodesDo) {
  TypeLater("\n");
  EXPECT_TRUE(desk_.AllowsEpisode(robot_.loop));
  HoldFor(HoldReason::kNotSeen);
  TypeLater("\n");
  EXPECT_TRUE(desk_.AllowsEpisode(robot_.loop));
  TypeLater("q\n");
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
}

TEST_F(OperatorDeskTest, WhatWasTypedWhileItMovedStartsNothing) {
  typed_.Type("\n\nstart\nclear\nhome\n\n");
  HoldFor(HoldReason::kNotSeen);
  TypeLater("q\n");
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
  typed_.Type("start\nstart\n");
  HoldFor(HoldReason::kStateJump);
  TypeLater("q\n");
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
}

TEST_F(OperatorDeskTest, AfterAnyOtherReasonAWordHasToBeTyped) {
  for (int i = 1; i < runtime::kNumHoldReasons; ++i) {
    const auto reason = static_cast<HoldReason>(i);
    if (reason == HoldReason::kControllerHalted || reason == HoldReason::kNotSeen) continue;
    SCOPED_TRACE(runtime::Name(reason));
    HoldFor(reason);
    const bool fault = runtime::IsFault(reason);
    TypeLater("\n\nSTART\n start\nc\n\nq\n");
    EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop)) << "Enter is not a word";
    EXPECT_EQ(robot_.loop.state(), fault ? RunState::kFaulted : RunState::kHolding);
    if (fault) {
      TypeLater("clear\n");
      std::string word;
      ASSERT_TRUE(desk_.Confirms(robot_.loop, "?", "clear"));
      ASSERT_TRUE(robot_.loop.Clear());
    }
    TypeLater("start\n");
    EXPECT_TRUE(desk_.AllowsEpisode(robot_.loop));
  }
}

TEST_F(OperatorDeskTest, AFaultThatLastsIsNotCleared) {
  HoldFor(HoldReason::kArmSilent);
  robot_.arm.found = {HoldReason::kArmSilent, "still"};
  TypeLater("clear\n");
  std::thread later([&] {
    // The second question comes once the first was answered in vain.
    std::string shown;
    while (shown.find("it is still there") == std::string::npos) {
      shown += shown_.Text();
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    typed_.Type("q\n");
  });
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
  later.join();
  EXPECT_EQ(robot_.loop.state(), RunState::kFaulted);
}

TEST_F(OperatorDeskTest, AStopThatWasPressedWhileIdleHasToBeCleared) {
  robot_.loop.Idle(0.5);
  robot_.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot_.loop.Idle(0.5);
  TypeLater("\nq\n");
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
  EXPECT_EQ(robot_.stop.acknowledged, 0);
}

TEST_F(OperatorDeskTest, TheLoopGoesOnAtThePrompt) {
  robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
  robot_.clock.plan = [&] {
    robot_.stop.found = {HoldReason::kEmergencyStop, "pressed"};
    typed_.Type("home\n");
  };
  EXPECT_TRUE(desk_.Confirms(robot_.loop, "?", "home"));
  EXPECT_EQ(robot_.loop.blocking(), HoldReason::kEmergencyStop);
}

TEST_F(OperatorDeskTest, CtrlCAndTheEndOfInputSayNo) {
  interrupted_ = true;
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
  interrupted_ = false;
  typed_.Type("start\n");
  typed_.CloseOut();
  EXPECT_FALSE(desk_.AllowsEpisode(robot_.loop));
}

// -- the screen -----------------------------------------------------------------------------------

TEST(ScreenTest, PrintsAllInOrder) {
  const Pipe shown;
  {
    Screen screen(shown.out());
    for (int i = 0; i < 3; ++i) screen.Say("line %d of %s\n", i, "three");
  }
  EXPECT_EQ(shown.Text(), "line 0 of three\nline 1 of three\nline 2 of three\n");
}

// As a terminal after Ctrl-S.
TEST(ScreenTest, NobodyWaitsForATerminalThatStandsStill) {
  using Clock = std::chrono::steady_clock;
  const Pipe shown;
  ::fcntl(shown.out(), F_SETFL, O_NONBLOCK);
  const std::string much(4096, 'x');
  while (::write(shown.out(), much.data(), much.size()) > 0) {
  }
  ::fcntl(shown.out(), F_SETFL, 0);
  const auto start = Clock::now();
  {
    Screen screen(shown.out());
    for (int i = 0; i < 1000; ++i) screen.Say("line %d\n", i);
    EXPECT_LT(Clock::now() - start, std::chrono::milliseconds(500)) << "the loop waited";
  }
  EXPECT_LT(Clock::now() - start, std::chrono::seconds(5)) << "the program does not end";
}

TEST(ScreenTest, SaysHowMuchIsMissing) {
  const Pipe shown;
  std::string text;
  {
    Screen screen(shown.out());
    for (int i = 0; i < 20'000; ++i) screen.Say("line %d\n", i);
    for (int n = 0; n < 1000 && text.find("not shown") == std::string::npos; ++n) {
      text += shown.Text();
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }
  EXPECT_THAT(text, HasSubstr("line 0\n"));
  EXPECT_THAT(text, HasSubstr("lines were not shown"));
}

}  // namespace
}  // namespace dfr::apps::line_tracking
