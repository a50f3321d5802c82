// Bringing up a robot, and the questions to its operator.
#include "dfr/hardware/bring_up.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "tests/robot/fake_robot.h"

namespace dfr::hardware {
namespace {

using runtime::HoldReason;
using test::FakeRobot;

class BringUpTest : public testing::Test {
 protected:
  BringUpTest() { robot_.arm.unhomed = true; }
  // Answers the first `yes` questions with yes.
  [[nodiscard]] Confirms Answers(int yes) {
    return [this, yes](std::string_view question, std::string_view word) {
      robot_.loop.Idle(0.1);
      questions_.emplace_back(question);
      words_.emplace_back(word);
      return static_cast<int>(words_.size()) <= yes;
    };
  }
  // Returns the error of BringUp(), or an empty string after success.
  std::string Refusal(const Confirms& confirms) {
    try {
      BringUp(
          options_, [this](std::string_view text) { said_ += std::string(text) + '\n'; }, confirms);
      return {};
    } catch (const std::runtime_error& e) {
      return e.what();
    }
  }
  // Runs `plan` after this time of the loop.
  void Later(double seconds, std::function<void()> plan) {
    robot_.clock.plan_ns = robot_.clock.now_ns + static_cast<std::int64_t>(1e9 * seconds);
    robot_.clock.plan = std::move(plan);
  }

  FakeRobot robot_;
  BringUpOptions options_{.loop = &robot_.loop, .arm = &robot_.arm};
  std::vector<std::string> questions_;
  std::vector<std::string> words_;
  std::string said_;
};

TEST_F(BringUpTest, PowersUpOnlyOnTheOperatorsRequest) {
  EXPECT_EQ(Refusal({}), "PSM1 is not homed, and the operator did not confirm homing");
  EXPECT_EQ(Refusal(Answers(0)), "PSM1 is not homed, and the operator did not confirm homing");
  EXPECT_EQ(words_, std::vector<std::string>{"home"});
  EXPECT_EQ(robot_.arm.homings, 0);
  words_.clear();
  EXPECT_EQ(Refusal(Answers(1)), "");
  EXPECT_EQ(robot_.arm.homings, 1);
  EXPECT_EQ(said_, "PSM1: homing\n");
  words_.clear();
  EXPECT_EQ(Refusal(Answers(1)), "");
  EXPECT_EQ(words_, std::vector<std::string>()) << "it is homed already";
}

TEST_F(BringUpTest, ASimulatedArmIsHomedWithoutBeingAsked) {
  options_.simulated = true;
  EXPECT_EQ(Refusal({}), "");
  EXPECT_EQ(robot_.arm.homings, 1);
}

TEST_F(BringUpTest, AStopOrCtrlCEndsHomingAndCtrlCEndsWaiting) {
  const auto during = [this](std::function<void()> found) -> Confirms {
    return [this, found](std::string_view, std::string_view) {
      Later(1.0, found);
      return true;
    };
  };
  const auto press = [this] { robot_.stop.found = {HoldReason::kEmergencyStop, "pressed"}; };
  EXPECT_EQ(Refusal(during(press)), "PSM1 was not homed: emergency-stop: pressed");
  EXPECT_EQ(robot_.arm.disabled_ns, robot_.clock.now_ns) << "in the same period";
  robot_.stop.found = {};
  const auto interrupt = [this] { robot_.interrupted = true; };
  EXPECT_EQ(Refusal(during(interrupt)), "PSM1 was not homed: operator: interrupted");
  EXPECT_TRUE(robot_.arm.unhomed);
  const std::int64_t start_ns = robot_.clock.now_ns;
  EXPECT_EQ(Refusal(during(interrupt)), "the robot is not ready: operator: interrupted");
  EXPECT_LT(robot_.clock.now_ns - start_ns, 500'000'000) << "waiting ends at once";
}

TEST_F(BringUpTest, APressedOrSilentStopMustEndAndBeCleared) {
  for (const HoldReason reason : {HoldReason::kEmergencyStop, HoldReason::kEmergencyStopSilent}) {
    words_.clear();
    robot_.stop.found = {reason, "so"};
    EXPECT_EQ(Refusal(Answers(1)),
              std::string("the robot is not ready: ") + runtime::Name(reason) + ": so");
    EXPECT_EQ(words_, (std::vector<std::string>{"clear", "clear"})) << "nothing has changed";
    EXPECT_EQ(robot_.arm.homings, 0);
  }
  words_.clear();
  const Confirms releases = [this](std::string_view, std::string_view word) {
    words_.emplace_back(word);
    robot_.stop.found = {};
    return true;
  };
  EXPECT_EQ(Refusal(releases), "");
  EXPECT_EQ(words_, (std::vector<std::string>{"clear", "home"}));
}

TEST_F(BringUpTest, APressDuringTheQuestionAboutASilentStopIsAskedAbout) {
  robot_.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
  const Confirms confirms = [&](std::string_view question, std::string_view word) {
    questions_.emplace_back(question);
    words_.emplace_back(word);
    robot_.stop.found = {};
    if (words_.size() == 1) {
      robot_.stop.pressed = true;
      robot_.loop.Idle(0.1);
      robot_.stop.pressed = false;
    }
    return true;
  };
  EXPECT_EQ(Refusal(confirms), "");
  EXPECT_EQ(words_, (std::vector<std::string>{"clear", "clear", "home"}));
  EXPECT_NE(questions_.at(1).find("emergency-stop: pressed"), std::string::npos);
  EXPECT_EQ(robot_.stop.acknowledged, 1);
}

// The operator may have pressed the stop because the arm must not move.
TEST_F(BringUpTest, AStopPressedDuringTheQuestionMustBeClearedBeforeTheNextQuestion) {
  bool presses = true;
  const Confirms confirms = [&](std::string_view, std::string_view word) {
    EXPECT_EQ(robot_.arm.homings, 0);
    words_.emplace_back(word);
    if (word == "home" && std::exchange(presses, false)) {
      robot_.stop.pressed = true;
      robot_.loop.Idle(0.1);
      robot_.stop.pressed = false;
    }
    robot_.loop.Idle(3.0);
    return word == "home" || words_.size() < 5;
  };
  EXPECT_EQ(Refusal(confirms), "");
  EXPECT_EQ(words_, (std::vector<std::string>{"home", "clear", "home"}));
  EXPECT_EQ(robot_.arm.homings, 1);
}

TEST_F(BringUpTest, ASilenceOfTheStopDuringAQuestionMustBeCleared) {
  bool silences = true;
  const Confirms confirms = [&](std::string_view question, std::string_view word) {
    EXPECT_EQ(robot_.arm.homings, 0);
    questions_.emplace_back(question);
    words_.emplace_back(word);
    if (std::exchange(silences, false)) {
      robot_.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
      robot_.loop.Idle(0.5);
      robot_.stop.found = {};
    }
    robot_.loop.Idle(3.0);
    return words_.size() < 5;
  };
  EXPECT_EQ(Refusal(confirms), "");
  EXPECT_EQ(words_, (std::vector<std::string>{"home", "clear", "home"}));
  EXPECT_NE(questions_.at(1).find("overdue for 0.50 s"), std::string::npos) << questions_.at(1);
  EXPECT_EQ(robot_.arm.homings, 1);
}

TEST_F(BringUpTest, ASimulatedRobotGoesOnAfterASilenceOfTheStop) {
  options_.simulated = true;
  robot_.loop.Idle(0.5);
  robot_.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
  Later(1.0, [this] { robot_.stop.found = {}; });
  EXPECT_EQ(Refusal({}), "");
  EXPECT_EQ(robot_.arm.homings, 1);
  robot_.arm.unhomed = true;
  robot_.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
  Later(1.0, [this] {
    robot_.stop.found = {};
    robot_.stop.pressed = true;
  });
  EXPECT_EQ(Refusal({}), "the robot is not ready: emergency-stop: pressed");
  EXPECT_EQ(robot_.arm.homings, 1);
}

TEST_F(BringUpTest, ATimeoutNamesTheReasonAndItsRemedy) {
  robot_.arm.found = {HoldReason::kArmSilent, "no console"};
  options_.patience_s = 3.0;
  options_.remedy = [] { return std::string("; start it"); };
  EXPECT_EQ(Refusal(Answers(9)), "the robot is not ready: arm-silent: no console; start it");
  EXPECT_EQ(words_, std::vector<std::string>());
  EXPECT_EQ(said_, "waiting: arm-silent: no console\n");
}

TEST_F(BringUpTest, AnArmThatIsHomedElsewhereIsNotHomed) {
  robot_.arm.unhomed = false;
  options_.homed = true;
  EXPECT_EQ(Refusal({}), "");
  EXPECT_EQ(robot_.arm.homings, 0);
}

TEST_F(BringUpTest, PowersUpOnlyAfterOthersAreAccepted) {
  options_.accepts_others = [] { return false; };
  EXPECT_EQ(Refusal(Answers(9)),
            "other participants can command PSM1, and the operator did not accept them");
  EXPECT_EQ(words_, std::vector<std::string>());
  EXPECT_EQ(robot_.arm.homings, 0);
}

// A participant that joins during the question about homing must be accepted before the arm homes.
TEST_F(BringUpTest, WhoeverJoinsDuringTheQuestionMustBeAcceptedToo) {
  int present = 0;
  int accepted = 0;
  options_.knows_others = [&] { return accepted == present; };
  options_.accepts_others = [&] {
    if (accepted != present) words_.emplace_back("together");
    accepted = present;
    return true;
  };
  const Confirms joins = [&](std::string_view, std::string_view word) {
    if (std::ranges::count(words_, "home") < 2) ++present;
    words_.emplace_back(word);
    robot_.loop.Idle(0.1);
    return true;
  };
  EXPECT_EQ(Refusal(joins), "");
  EXPECT_EQ(words_, (std::vector<std::string>{"home", "together", "home", "together", "home"}));
  EXPECT_EQ(robot_.arm.homings, 1);
  // The operator may also decline.
  robot_.arm.unhomed = true;
  options_.accepts_others = [&] { return accepted == present; };
  words_.clear();
  EXPECT_EQ(Refusal(joins),
            "other participants can command PSM1, and the operator did not accept them");
  EXPECT_EQ(robot_.arm.homings, 1);
}

// The program lists earlier participants, and asks about each of them once.
TEST_F(BringUpTest, TheOperatorAcceptsEarlierParticipants) {
  Company company;
  const Say say = [this](std::string_view text) { said_ += std::string(text) + '\n'; };
  const dds::Newcomer window{
      .number = 1, .origin = {1}, .name = "window", .address = "10.0.0.1", .topic = "/PSM1/hold"};
  const dds::Newcomer script{
      .number = 2, .origin = {2}, .name = "script", .address = "10.0.0.2", .topic = "/PSM1/free"};
  EXPECT_TRUE(company.Accepts({}, false, say, Answers(0)));
  EXPECT_FALSE(company.Accepts({window}, false, say, Answers(0)));
  EXPECT_FALSE(company.Accepts({window}, false, say, {}));
  EXPECT_FALSE(company.Knows({window}));
  words_.clear();
  said_.clear();
  EXPECT_TRUE(company.Accepts({window}, false, say, Answers(1)));
  EXPECT_EQ(said_, "also present: 'window' at 10.0.0.1 publishes /PSM1/hold\n");
  EXPECT_EQ(words_, std::vector<std::string>{"together"});
  for (int episode = 0; episode < 20; ++episode) {
    EXPECT_TRUE(company.Accepts({window}, false, say, Answers(0)));
  }
  EXPECT_FALSE(company.Knows({window, script}));
  said_.clear();
  words_.clear();
  EXPECT_TRUE(company.Accepts({window, script}, false, say, Answers(1)));
  EXPECT_EQ(said_, "also present: 'script' at 10.0.0.2 publishes /PSM1/free\n");
  EXPECT_TRUE(Company().Accepts({window, script}, true, say, {})) << "in a simulation";
}

TEST_F(BringUpTest, ThePlatformNeedsASeparateConfirmation) {
  options_.platform_home_s = 1.5;
  EXPECT_EQ(Refusal(Answers(1)),
            "the platform is not at home, and the operator did not confirm homing");
  EXPECT_EQ(words_, (std::vector<std::string>{"home", "platform"}));
  EXPECT_EQ(robot_.platform.homings, 0);
  words_.clear();
  const std::int64_t start_ns = robot_.clock.now_ns;
  EXPECT_EQ(Refusal(Answers(1)), "");
  EXPECT_EQ(robot_.platform.homings, 1);
  EXPECT_GE(robot_.clock.now_ns - start_ns, 1'500'000'000);
  robot_.platform.refuses = {HoldReason::kPlatform, "its port failed"};
  words_.clear();
  EXPECT_EQ(Refusal(Answers(1)),
            "the platform was not homed: platform: its port failed; if it moves, only cutting its "
            "power stops it before it is at home");
}

}  // namespace
}  // namespace dfr::hardware
