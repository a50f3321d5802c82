// The operator of a robot at the terminal: typed input and the motions that it permits.
#include "dfr/robot/operator_prompt.h"

#include <gtest/gtest.h>

#include <atomic>
#include <functional>
#include <string>
#include <string_view>
#include <utility>

#include "tests/robot/fake_robot.h"
#include "tests/runtime/pipe.h"
#include "tests/support/eventually.h"

namespace dfr::robot {
namespace {

using runtime::HoldReason;
using runtime::RunState;
using test::FakeRobot;
using test::Pipe;

class OperatorPromptTest : public testing::Test {
 protected:
  // Types the text after some periods of waiting at the prompt.
  void TypeLater(std::string_view text) {
    robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
    robot_.clock.plan = [this, text] { typed_.Type(text); };
  }
  void HoldFor(HoldReason reason) {
    ASSERT_EQ(robot_.loop.Start(), HoldReason::kNone);
    robot_.loop.Hold(reason, "for the test");
    robot_.loop.Idle(1.0);
  }
  void PressAndRelease() {
    robot_.loop.Idle(0.5);
    robot_.stop.pressed = true;
    robot_.loop.Idle(0.5);
    robot_.stop.pressed = false;
  }
  // During the question, runs `begin`, then `end`, types `word` and, at the next question, q.
  [[nodiscard]] bool AllowsAfter(std::function<void()> begin, std::function<void()> end,
                                 std::string_view word) {
    robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
    robot_.clock.plan = [this, begin = std::move(begin), end = std::move(end), word] {
      begin();
      robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
      robot_.clock.plan = [this, end, word] {
        end();
        typed_.Type(word);
        TypeLater("q\n");
      };
    };
    return Allows();
  }
  [[nodiscard]] bool AllowsIfPressedBefore(std::string_view word) {
    return AllowsAfter([this] { robot_.stop.pressed = true; },
                       [this] { robot_.stop.pressed = false; }, word);
  }
  [[nodiscard]] bool AllowsIfSilentBefore(std::string_view word) {
    return AllowsAfter(
        [this] {
          robot_.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
        },
        [this] { robot_.stop.found = {}; }, word);
  }
  void BeSilent(double seconds) {
    robot_.loop.Idle(0.5);
    robot_.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
    robot_.loop.Idle(seconds);
    robot_.stop.found = {};
    robot_.loop.Idle(1.0);
  }
  // Returns the text shown until the first question.
  [[nodiscard]] std::string Question() {
    std::string text;
    test::Eventually([&] { return (text += shown_.Text()).find("q ends") != std::string::npos; });
    return text;
  }
  [[nodiscard]] bool Allows() { return prompt_.AllowsEpisode(robot_.loop, "Ready the robot"); }

  FakeRobot robot_;
  Pipe typed_;
  Pipe shown_;
  runtime::Keyboard keyboard_{typed_.in()};
  runtime::AsyncPrinter printer_{shown_.out()};
  std::atomic<bool> interrupted_ = false;
  OperatorPrompt prompt_{keyboard_, printer_, interrupted_};
};

TEST_F(OperatorPromptTest, EnterStartsAfterARegularEnd) {
  TypeLater("\n");
  EXPECT_TRUE(Allows());
  HoldFor(HoldReason::kNotSeen);
  TypeLater("\n");
  EXPECT_TRUE(Allows());
  TypeLater("q\n");
  EXPECT_FALSE(Allows());
}

TEST_F(OperatorPromptTest, InputTypedDuringMotionIsIgnored) {
  typed_.Type("\n\nstart\nclear\nhome\n\n");
  HoldFor(HoldReason::kNotSeen);
  TypeLater("q\n");
  EXPECT_FALSE(Allows());
  typed_.Type("start\nstart\n");
  HoldFor(HoldReason::kStateJump);
  TypeLater("q\n");
  EXPECT_FALSE(Allows());
}

TEST_F(OperatorPromptTest, AfterAnyOtherReasonAWordHasToBeTyped) {
  for (int i = 1; i < runtime::kNumHoldReasons; ++i) {
    const auto reason = static_cast<HoldReason>(i);
    if (reason == HoldReason::kControllerHalted || reason == HoldReason::kNotSeen) continue;
    SCOPED_TRACE(runtime::Name(reason));
    HoldFor(reason);
    const bool fault = runtime::IsFault(reason);
    TypeLater("\n\nSTART\n start\nc\n\nq\n");
    EXPECT_FALSE(Allows()) << "Enter is not a word";
    EXPECT_EQ(robot_.loop.state(), fault ? RunState::kFaulted : RunState::kHolding);
    if (fault) {
      TypeLater("clear\n");
      ASSERT_TRUE(prompt_.Confirms(robot_.loop, "?", "clear"));
      ASSERT_TRUE(robot_.loop.Clear());
    }
    TypeLater("start\n");
    EXPECT_TRUE(Allows());
  }
}

TEST_F(OperatorPromptTest, AFaultThatLastsIsNotCleared) {
  HoldFor(HoldReason::kArmSilent);
  robot_.arm.found = {HoldReason::kArmSilent, "still"};
  robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
  robot_.clock.plan = [this] {
    typed_.Type("clear\n");
    TypeLater("q\n");  // at the second question
  };
  EXPECT_FALSE(Allows());
  EXPECT_EQ(robot_.loop.state(), RunState::kFaulted);
}

TEST_F(OperatorPromptTest, AStopThatWasPressedWhileIdleHasToBeCleared) {
  robot_.loop.Idle(0.5);
  robot_.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot_.loop.Idle(0.5);
  TypeLater("\nq\n");
  EXPECT_FALSE(Allows());
  EXPECT_EQ(robot_.stop.acknowledged, 0);
}

TEST_F(OperatorPromptTest, AfterAStopWhileIdleAWordStartsTheEpisode) {
  PressAndRelease();
  robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
  robot_.clock.plan = [this] {
    typed_.Type("clear\n");
    TypeLater("\nq\n");
  };
  EXPECT_FALSE(Allows()) << "Enter is not a word";
  EXPECT_EQ(robot_.stop.acknowledged, 1);
  EXPECT_EQ(robot_.loop.blocking(), HoldReason::kNone);
}

// An operator who has not been told of a press cannot confirm it.
TEST_F(OperatorPromptTest, NamesAPressThatAnotherFaultHides) {
  HoldFor(HoldReason::kArmSilent);
  robot_.camera.found = {HoldReason::kImageSilent, "for the test"};
  PressAndRelease();
  TypeLater("q\n");
  EXPECT_FALSE(Allows());
  const std::string text = Question();
  EXPECT_NE(text.find("faulted: arm-silent"), std::string::npos) << text;
  EXPECT_NE(text.find("emergency-stop: pressed"), std::string::npos) << text;
}

TEST_F(OperatorPromptTest, AsksForClearAgainAfterAPressDuringTheQuestion) {
  HoldFor(HoldReason::kArmSilent);
  EXPECT_FALSE(AllowsIfPressedBefore("clear\n"));
  EXPECT_EQ(robot_.stop.acknowledged, 0);
}

TEST_F(OperatorPromptTest, APressDuringTheQuestionVoidsTheAnswer) {
  EXPECT_FALSE(AllowsIfPressedBefore("\n"));
  ASSERT_TRUE(robot_.loop.Clear());
  HoldFor(HoldReason::kStateJump);
  EXPECT_FALSE(AllowsIfPressedBefore("start\n"));
  EXPECT_EQ(robot_.loop.state(), RunState::kFaulted);
}

// Nobody could have stopped the robot during the silence, even if the stop is heard again.
TEST_F(OperatorPromptTest, AStopThatWasSilentWhileIdleHasToBeCleared) {
  BeSilent(1.5);
  TypeLater("\nstart\nq\n");
  EXPECT_FALSE(Allows());
  EXPECT_EQ(robot_.stop.acknowledged, 0);
  const std::string text = Question();
  EXPECT_NE(
      text.find("emergency-stop-silent: its messages were overdue for 1.50 s. Correct it, then "
                "type clear"),
      std::string::npos)
      << text;
  robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
  robot_.clock.plan = [this] {
    typed_.Type("clear\n");
    TypeLater("\nstart\n");
  };
  EXPECT_TRUE(Allows());
  EXPECT_EQ(robot_.stop.acknowledged, 1);
}

TEST_F(OperatorPromptTest, NamesASilenceThatAnotherFaultHides) {
  HoldFor(HoldReason::kArmSilent);
  BeSilent(0.25);
  TypeLater("q\n");
  EXPECT_FALSE(Allows());
  const std::string text = Question();
  EXPECT_NE(text.find("faulted: arm-silent: for the test; emergency-stop-silent: its messages were "
                      "overdue for 0.25 s"),
            std::string::npos)
      << text;
}

TEST_F(OperatorPromptTest, ASilenceDuringTheQuestionVoidsTheAnswer) {
  EXPECT_FALSE(AllowsIfSilentBefore("\n"));
  ASSERT_TRUE(robot_.loop.Clear());
  HoldFor(HoldReason::kArmSilent);
  EXPECT_FALSE(AllowsIfSilentBefore("clear\n"));
  EXPECT_EQ(robot_.stop.acknowledged, 1) << "only by the test";
}

TEST_F(OperatorPromptTest, TheLoopKeepsRunningAtThePrompt) {
  robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
  robot_.clock.plan = [&] {
    robot_.stop.found = {HoldReason::kEmergencyStop, "pressed"};
    typed_.Type("home\n");
  };
  EXPECT_TRUE(prompt_.Confirms(robot_.loop, "?", "home"));
  EXPECT_EQ(robot_.loop.blocking(), HoldReason::kEmergencyStop);
}

TEST_F(OperatorPromptTest, TheQuestionIsRepeatedBelowOtherOutput) {
  robot_.clock.plan_ns = robot_.clock.now_ns + 500'000'000;
  robot_.clock.plan = [this] {
    for (int i = 0; i < 15; ++i) printer_.Say("  message from the console (status): %d\n", i);
    robot_.clock.plan_ns = robot_.clock.now_ns + 5'000'000'000;
    robot_.clock.plan = [this] { typed_.Type("home\n"); };
  };
  EXPECT_TRUE(prompt_.Confirms(robot_.loop, "the question", "home"));
  std::string text;
  test::Eventually([&] {
    text += shown_.Text();
    const std::size_t last = text.find("(status): 14\n");
    return last != std::string::npos && text.find("the question; q ends\n", last) < text.size();
  });
  EXPECT_EQ(printer_.said(), 17) << "once again, not every second";
}

TEST_F(OperatorPromptTest, CtrlCAndTheEndOfInputRefuse) {
  interrupted_ = true;
  EXPECT_FALSE(Allows());
  interrupted_ = false;
  typed_.Type("start\n");
  typed_.CloseOut();
  EXPECT_FALSE(Allows());
}

}  // namespace
}  // namespace dfr::robot
