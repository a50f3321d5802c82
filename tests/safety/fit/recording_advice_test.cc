#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"

namespace dfr::safety {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;

std::vector<std::string> FittedWarnings(const core::StateLayout& layout,
                                        const std::vector<core::Trajectory>& demonstrations) {
  return GuardModel::Fit(layout, demonstrations, {.accept_any = true})->summary().fit_warnings;
}

// A point on a line returns to 0. The action reacts to the measured position.
struct Feedback {
  double noise;  // of the measured position
  double action_noise;
  double effect;  // of an action on the position
};

std::vector<core::Trajectory> FeedbackDemonstrations(const Feedback& feedback) {
  constexpr int kSteps = 40;
  core::Random random(5);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < 30; ++i) {
    core::Trajectory d{core::Matrix(kSteps + 1, 1), core::Matrix(kSteps, 1)};
    double x = 0.3 * random.Normal();
    for (int t = 0;; ++t) {
      d.states(t, 0) = x + feedback.noise * random.Normal();
      if (t == kSteps) break;
      d.controls(t, 0) = -0.8 * d.states(t, 0) + feedback.action_noise * random.Normal();
      x += feedback.effect * d.controls(t, 0);
    }
    demonstrations.push_back(std::move(d));
  }
  return demonstrations;
}

// Pairs each state with the action of the step before.
std::vector<core::Trajectory> Shifted(std::vector<core::Trajectory> demonstrations) {
  for (core::Trajectory& d : demonstrations) {
    const Eigen::Index steps = d.controls.rows() - 1;
    d.states = core::Matrix(d.states.bottomRows(steps + 1));
    d.controls = core::Matrix(d.controls.topRows(steps));
  }
  return demonstrations;
}

TEST(RecordingAdviceTest, AReactionToTheStateIsNoShift) {
  core::StateLayout layout;
  layout.Add("x", 1);
  const auto noisy = FeedbackDemonstrations({.noise = 0.05, .action_noise = 0.01, .effect = 0.1});
  EXPECT_THAT(FittedWarnings(layout, noisy), Not(Contains(HasSubstr("out of step"))));
  const auto exact = FeedbackDemonstrations({.noise = 0.0, .action_noise = 0.05, .effect = 0.3});
  EXPECT_THAT(FittedWarnings(layout, exact), Not(Contains(HasSubstr("out of step"))));
  EXPECT_THAT(FittedWarnings(layout, Shifted(exact)), Contains(HasSubstr("out of step")));
}

// A force jumps at random, and the action reacts to the jump, which one state does not show. The
// position follows the action of the same step.
TEST(RecordingAdviceTest, AReactionToAChangeIsNoShift) {
  constexpr int kSteps = 40;
  core::Random random(6);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < 30; ++i) {
    core::Trajectory d{core::Matrix(kSteps + 1, 2), core::Matrix(kSteps, 1)};
    d.states.row(0) << 0.1 * random.Normal(), random.Normal();
    double jump = 0.0;
    for (int t = 0; t < kSteps; ++t) {
      d.controls(t, 0) = 0.05 + 0.02 * random.Normal() + 0.1 * jump;
      jump = random.Uniform(0.0, 1.0) < 0.2 ? random.Normal() : 0.0;
      d.states.row(t + 1) << d.states(t, 0) + d.controls(t, 0), d.states(t, 1) + jump;
    }
    demonstrations.push_back(std::move(d));
  }
  core::StateLayout layout;
  layout.Add("tip", 1);
  layout.Add("force", 1);
  EXPECT_THAT(FittedWarnings(layout, demonstrations), Not(Contains(HasSubstr("out of step"))));
  EXPECT_THAT(FittedWarnings(layout, Shifted(demonstrations)), Contains(HasSubstr("out of step")));
}

// A cart drives at constant speed and steers only at first. Then only one entry of the state
// changes.
TEST(RecordingAdviceTest, ADriveAtConstantSpeedIsNoRest) {
  constexpr int kSteps = 40;
  core::Random random(7);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < 20; ++i) {
    core::Trajectory d{core::Matrix(kSteps + 1, 2), core::Matrix(kSteps, 2)};
    d.states.row(0) << 0.1 * random.Normal(), 0.3 * random.Normal();
    for (int t = 0; t < kSteps; ++t) {
      d.controls.row(t) << 0.1 * (1.0 + 0.1 * random.Normal()), -0.3 * d.states(t, 1);
      d.states.row(t + 1) = d.states.row(t) + d.controls.row(t);
    }
    demonstrations.push_back(std::move(d));
  }
  core::StateLayout layout;
  layout.Add("cart", 2);
  EXPECT_THAT(FittedWarnings(layout, demonstrations), Not(Contains(HasSubstr("robot rests"))));
}

// A gear changes once per demonstration, by more than any position.
TEST(RecordingAdviceTest, AFlagIsNoUnexplainedChange) {
  core::Random random(8);
  auto demonstrations = test::IrregularDemonstrations(40, random);
  for (core::Trajectory& d : demonstrations) {
    const auto turn = static_cast<Eigen::Index>(random.Uniform(3.0, 17.0));
    d.states.col(0).head(turn).setConstant(1.0);
    d.states.col(0).tail(d.states.rows() - turn).setConstant(-1.0);
  }
  constexpr const char* kUnexplained = "actions explain only";
  EXPECT_THAT(FittedWarnings(test::CorridorLayout(), demonstrations),
              Not(Contains(HasSubstr(kUnexplained))));
  // An object that moves by itself.
  for (core::Trajectory& d : demonstrations) {
    for (double& x : d.states.col(0)) x = random.Normal();
  }
  EXPECT_THAT(FittedWarnings(test::CorridorLayout(), demonstrations),
              Contains(HasSubstr(kUnexplained)));
}

TEST(RecordingAdviceTest, AnAlarmLevelThatNoDemonstrationReachesHasItsConsequence) {
  const auto warnings = [](int count) {
    const auto model =
        GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, count),
                        {.features = "tip", .action_limit = {0.2}});
    GuardSettings settings = model->settings();
    settings.alarm_level = 3.5;
    return Warnings(*model->With(settings));
  };
  EXPECT_THAT(warnings(12), Contains(HasSubstr("no alarm will be raised. 12 demonstrations are so "
                                               "few that the level is that of the worst one")));
  EXPECT_THAT(warnings(30), Contains(HasSubstr("many failures will raise no alarm. Check for")));
}

// The first entry of the state is a goal.
TEST(RecordingAdviceTest, AGoalIsNotAFeatureToLeaveOut) {
  core::Random random(9);
  auto demonstrations = test::CorridorDemonstrations(1, 40);
  for (core::Trajectory& d : demonstrations) {
    d.states.col(0).setConstant(random.Normal());
    for (double& x : d.states.col(0)) x += 0.01 * random.Normal();
  }
  GuardOptions options{.accept_any = true};
  options.support.svm.gamma = 1e3;
  const auto narrow = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_THAT(Warnings(*narrow), Contains(testing::AllOf(testing::StartsWith("clock[0]: "),
                                                         HasSubstr("like a goal"))));
  EXPECT_THAT(Warnings(*narrow), Not(Contains(HasSubstr("fewer features"))));
  const auto good = GuardModel::Fit(test::CorridorLayout(), demonstrations);
  EXPECT_THAT(Warnings(*good), Not(Contains(HasSubstr("like a goal"))));
}

// What decides the direction of a drive to a turning point and back. Its second action entry
// follows the position across the track.
enum class Decides { kHidden, kFlag, kOdometer };

std::vector<core::Trajectory> DrivesThereAndBack(Decides decides) {
  constexpr int kSteps = 60;
  core::Random random(11);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < 40; ++i) {
    core::Trajectory d{core::Matrix::Zero(kSteps + 1, 3), core::Matrix(kSteps, 2)};
    const double pace = 0.08 * random.Uniform(0.85, 1.15);
    const double turn = decides == Decides::kOdometer ? 2.0 : 2.0 + 0.2 * random.Normal();
    d.states.row(0) << 0.2 * random.Normal(), 0.2 * random.Normal(), 0.0;
    bool back = false;
    for (int t = 0; t < kSteps; ++t) {
      const double odometer = d.states(t, 2);
      back = back || (decides == Decides::kOdometer ? odometer : d.states(t, 0)) > turn;
      if (decides == Decides::kFlag) d.states(t, 2) = back ? 1.0 : 0.0;
      d.controls.row(t) << (back ? -pace : pace) * (1.0 + 0.05 * random.Normal()),
          -0.1 * d.states(t, 1) + 0.01 * random.Normal();
      d.states.row(t + 1) = d.states.row(t);
      d.states.row(t + 1).head(2) += d.controls.row(t);
      if (decides == Decides::kOdometer) d.states(t + 1, 2) += std::abs(d.controls(t, 0));
    }
    // Without a decisive entry the third one is noise.
    if (decides == Decides::kHidden) {
      for (double& x : d.states.col(2)) x = random.Normal();
    }
    demonstrations.push_back(std::move(d));
  }
  return demonstrations;
}

TEST(RecordingAdviceTest, OppositeActionsAtOnePlaceNeedTheEntryThatDecides) {
  core::StateLayout layout;
  layout.Add("tip", 2);
  layout.Add("other", 1);
  const auto warnings = FittedWarnings(layout, DrivesThereAndBack(Decides::kHidden));
  EXPECT_THAT(warnings, Contains(testing::MatchesRegex(
                            "near steps [12][0-9] to [23][0-9] demonstrations act oppositely in "
                            "entry 0 of an action at the same place \\([123][0-9] %\\): add .*")));
  for (const Decides decides : {Decides::kFlag, Decides::kOdometer}) {
    EXPECT_THAT(FittedWarnings(layout, DrivesThereAndBack(decides)),
                Not(Contains(HasSubstr("act oppositely"))));
  }
}

// Many noisy entries each show a little of what decides. Near states then mix both directions, and
// only a regression separates them.
TEST(RecordingAdviceTest, ManyNoisyEntriesExplainOppositeActions) {
  constexpr int kOthers = 16;
  core::Random random(12);
  core::StateLayout layout;
  layout.Add("tip", 2);
  layout.Add("other", kOthers);
  for (const double signal : {0.0, 0.4}) {
    auto demonstrations = DrivesThereAndBack(Decides::kFlag);
    for (core::Trajectory& d : demonstrations) {
      const Eigen::VectorXd flag = d.states.col(2);
      d.states.conservativeResize(Eigen::NoChange, 2 + kOthers);
      for (Eigen::Index t = 0; t < flag.size(); ++t) {
        for (double& x : d.states.row(t).tail(kOthers)) {
          x = signal * (2.0 * flag[t] - 1.0) + random.Normal();
        }
      }
    }
    const auto opposite = Contains(HasSubstr("act oppositely in entry 0"));
    const auto warnings = FittedWarnings(layout, demonstrations);
    if (signal == 0.0) {
      EXPECT_THAT(warnings, opposite);
    } else {
      EXPECT_THAT(warnings, Not(opposite));
    }
  }
}

// Demonstrations pass a pillar on either side, half of them each, and differ in noise.
TEST(RecordingAdviceTest, AChoiceBetweenWaysIsNoOppositeAction) {
  constexpr int kSteps = 60;
  core::Random random(13);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < 40; ++i) {
    core::Trajectory d{core::Matrix(kSteps + 1, 2), core::Matrix(kSteps, 3)};
    const double side = i % 2 == 0 ? 1.0 : -1.0;
    d.states.row(0) << 0.1 * random.Normal(), 0.2 * random.Normal();
    for (int t = 0; t < kSteps; ++t) {
      const double dy = side * 0.1 * (t < kSteps / 2 ? 1.0 : -1.0);
      d.controls.row(t) << 0.1, dy + 0.02 * random.Normal(), random.Normal();
      d.states.row(t + 1) = d.states.row(t) + d.controls.row(t).head(2);
    }
    demonstrations.push_back(std::move(d));
  }
  core::StateLayout layout;
  layout.Add("tip", 2);
  EXPECT_THAT(FittedWarnings(layout, demonstrations), Not(Contains(HasSubstr("act oppositely"))));
}

}  // namespace
}  // namespace dfr::safety
