#include "dfr/safety/guard_advice.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/cover_radius.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/all_close.h"

namespace dfr::safety {
namespace {

using testing::HasSubstr;

// Returns a model without warnings, fitted once.
std::shared_ptr<const GuardModel> GoodModel() {
  static const auto kModel =
      GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                      {.features = "tip", .action_limit = {0.2}});
  return kModel;
}

TEST(GuardAdviceTest, NoiseOfSensorsIsNamed) {
  core::Random random(9);
  auto demonstrations = test::CorridorDemonstrations(1, 40);
  for (core::Trajectory& d : demonstrations) {
    for (double& entry : d.states.rightCols(2).reshaped()) entry += 0.15 * random.Normal();
  }
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                     {.features = "tip", .accept_any = true});
  EXPECT_TRUE(model->settings().demonstrated);
  EXPECT_THAT(Warnings(*model),
              testing::Contains(testing::AllOf(HasSubstr("of the change of features"),
                                               HasSubstr("of the rest is sensor noise"))));
}

// Every state without an alarm has a demonstrated state within the clearance, in the state's unit.
TEST(GuardAdviceTest, ClearanceIsADistanceThatNoStateWithoutAlarmExceeds) {
  const auto demonstrations = test::CorridorDemonstrations(1, 30);
  const auto model = test::Model();
  const auto clearances = Clearances(*model);
  ASSERT_EQ(clearances.size(), 1u) << "no feature uses the clock";
  EXPECT_EQ(clearances[0].block, "tip");
  EXPECT_GE(clearances[0].largest, clearances[0].median);
  double furthest = 0.0;
  core::Random random(8);
  for (int i = 0; i < 8000; ++i) {
    const std::vector<double> x = {0.0, random.Uniform(-1.0, 3.0), random.Uniform(-1.0, 1.0)};
    const int t = static_cast<int>(random.Below(20));
    if (model->support().LogDecision(t, x, {}) < -std::max(0.0, model->settings().alarm_level)) {
      continue;
    }
    double nearest = std::numeric_limits<double>::infinity();
    for (const auto& d : demonstrations) {
      for (const auto& row : d.states.rowwise()) {
        nearest = std::min(nearest, std::hypot(row[1] - x[1], row[2] - x[2]));
      }
    }
    furthest = std::max(furthest, nearest);
  }
  EXPECT_GT(furthest, 0.02);
  EXPECT_LE(furthest, clearances[0].largest);
}

// With one feature, the clearance is the radius of the support divided by the feature's scale.
TEST(GuardAdviceTest, ClearanceOfOneFeatureIsTheScaledCoverRadius) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 30),
                                     {.features = "tip[1:2]"});
  const kernel::WhitenedSupport& support = model->task().feature_support();
  const double level = std::max(0.0, model->settings().alarm_level);
  std::vector<double> lengths;
  for (int t = 0; t < support.num_steps(); ++t) {
    const double scale = support.map(t)(0, 0) * model->task().features().scale()(0, 0);
    lengths.push_back(kernel::CoverRadius(support.estimate(t), level) / std::abs(scale));
  }
  ASSERT_EQ(lengths.size(), 21u);
  const auto clearances = Clearances(*model);
  ASSERT_EQ(clearances.size(), 1u);
  EXPECT_EQ(clearances[0].block, "tip");
  const auto largest = std::max_element(lengths.begin(), lengths.end());
  EXPECT_NEAR(clearances[0].largest, *largest, 1e-12 * *largest);
  EXPECT_EQ(clearances[0].step, largest - lengths.begin());
  std::sort(lengths.begin(), lengths.end());
  EXPECT_NEAR(clearances[0].median, lengths[10], 1e-12 * lengths[10]);
}

// Moves the states of a demonstration sideways by 1.
TEST(GuardAdviceTest, AttributionNamesTheEntriesThatPutAStateOutside) {
  const core::Matrix recorded = test::CorridorDemonstrations(1, 40)[3].states;
  const auto model = GoodModel();
  core::Matrix states = recorded;
  const core::Matrix inside = Attribution(*model, states);
  states.rightCols(1).array() += 1.0;
  states.col(0).array() += 100.0;  // The clock, which no feature uses.
  const std::vector<double> levels = model->Levels(states);
  const std::vector<double> own = model->Levels(recorded);
  const core::Matrix attribution = Attribution(*model, states);
  ASSERT_EQ(attribution.rows(), states.rows());
  ASSERT_EQ(attribution.cols(), 3);
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    const double l = levels[static_cast<std::size_t>(i)];
    ASSERT_LT(l, 0.0);
    EXPECT_NEAR(attribution.row(i).sum(), -l, 1e-9 * -l);
    EXPECT_EQ(attribution(i, 0), 0.0);
    EXPECT_GT(attribution(i, 2), 0.6 * -l);
    if (own[static_cast<std::size_t>(i)] >= 0.0) {
      EXPECT_EQ(inside.row(i).cwiseAbs().sum(), 0.0);
    }
  }
}

TEST(GuardAdviceTest, AttributionOfAnImmeasurableStateIsNaN) {
  for (const double y : {1e200, std::numeric_limits<double>::quiet_NaN()}) {
    core::Matrix states = core::Matrix::Zero(1, 3);
    states(0, 2) = y;
    EXPECT_EQ(test::Model()->Levels(states)[0], -std::numeric_limits<double>::infinity());
    EXPECT_TRUE(Attribution(*test::Model(), states).array().isNaN().all());
  }
}

// Compares the same demonstrations with one entry in a unit that is 1024 times smaller.
TEST(GuardAdviceTest, AttributionDoesNotDependOnUnits) {
  std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(1, 40);
  core::Matrix states = demonstrations[0].states;
  states.rightCols(2).array() += 0.7;
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  const core::Matrix attribution = Attribution(*model, states);
  for (core::Trajectory& d : demonstrations) d.states.col(2) *= 1024.0;
  states.col(2) *= 1024.0;
  const auto scaled = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  EXPECT_TRUE(test::AllClose(Attribution(*scaled, states), attribution, 1e-3));
}

TEST(GuardAdviceTest, WarningsNameTheReasonAndTheRemedy) {
  const auto good = GoodModel();
  EXPECT_THAT(Warnings(*good), testing::IsEmpty());
  const auto few = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 4),
                                   {.features = "tip", .action_limit = {0.2}});
  EXPECT_THAT(Warnings(*few), testing::Contains(HasSubstr("4 demonstrations cannot show")));
  GuardSettings settings = good->settings();
  settings.alarm_level = 3.5;
  settings.action_limit = {50.0};
  EXPECT_THAT(Warnings(*good->With(settings)),
              testing::ElementsAre(HasSubstr("alarm is raised only below l = -3.5"),
                                   HasSubstr("entry 0 of an action may reach 50"),
                                   HasSubstr("set an action limit")));
  settings = good->settings();
  settings.action_limit = {test::kSpeed / 2.0, 0.2};
  settings.horizon = 5;
  EXPECT_THAT(Warnings(*good->With(settings)),
              testing::ElementsAre(HasSubstr("entry 0 of an action is limited to 0.05"),
                                   HasSubstr("the guard halts after 5 time steps")));
  // A kernel so narrow that almost no left-out state is inside.
  GuardOptions narrow{.features = "tip", .action_limit = {0.2}, .accept_any = true};
  narrow.support.svm.gamma = 1e3;
  EXPECT_THAT(Warnings(*GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                        narrow)),
              testing::Contains(HasSubstr("of the states of left-out demonstrations are inside")));
}

TEST(GuardAdviceTest, AClockWithAnotherStartInEachEpisodeIsNamed) {
  core::Random random(8);
  const auto demonstrations = test::IrregularDemonstrations(40, random);
  const auto warned = [](const std::vector<std::string>& warnings) {
    return std::count_if(warnings.begin(), warnings.end(), [](const std::string& w) {
      return w.find("advances uniformly") != std::string::npos;
    });
  };
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations);
  EXPECT_EQ(warned(FitWarnings(*model, demonstrations)), 0);
  auto begun = demonstrations;
  for (core::Trajectory& d : begun) d.states.col(0).array() += 1e4 * random.Normal();
  EXPECT_THAT(FitWarnings(*model, begun),
              testing::Contains(testing::StartsWith("clock[0]: advances uniformly")));
  // A goal at rest, in units that cause rounding.
  for (core::Trajectory& d : begun) d.states.col(0).setConstant(random.Normal() / 3.0);
  EXPECT_EQ(warned(FitWarnings(*model, begun)), 0);
  // A phase from 0 to 1, which always starts at 0 but has a different rate in each episode.
  for (std::size_t i = 0; i < begun.size(); ++i) {
    core::Trajectory& d = begun[i];
    const Eigen::Index steps = 10 + static_cast<Eigen::Index>(i % 11);
    d.states.conservativeResize(steps + 1, Eigen::NoChange);
    d.controls.conservativeResize(steps, Eigen::NoChange);
    d.states.col(0) = Eigen::VectorXd::LinSpaced(steps + 1, 0.0, 1.0);
  }
  EXPECT_EQ(warned(FitWarnings(*model, begun)), 1);
}

TEST(GuardAdviceTest, DelayedActionsAreNamedWithTheirDelay) {
  const auto demonstrations = test::CorridorDemonstrations(1, 20);
  const auto fit = [&](int later) {
    // The action of step t acts at step t + later.
    auto delayed = demonstrations;
    for (core::Trajectory& d : delayed) {
      const Eigen::Index steps = d.controls.rows() - std::abs(later);
      const Eigen::Index first = std::max(0, -later);
      const Eigen::Index first_action = std::max(0, later);
      d.states = core::Matrix(d.states.middleRows(first, steps + 1));
      d.controls = core::Matrix(d.controls.middleRows(first_action, steps));
    }
    return GuardModel::Fit(test::CorridorLayout(), delayed, {.features = "tip"})
        ->summary()
        .fit_warnings;
  };
  EXPECT_THAT(fit(0), testing::Not(testing::Contains(HasSubstr("later"))));
  EXPECT_THAT(fit(1), testing::Contains(testing::AllOf(HasSubstr("take effect 1 step later"),
                                                       HasSubstr("add the last action to"))));
  EXPECT_THAT(fit(2), testing::Contains(HasSubstr("take effect 2 steps later")));
  EXPECT_THAT(fit(-1), testing::Contains(HasSubstr("recorded one step later")));
}

TEST(GuardAdviceTest, CopiesOfDemonstrationsAreNamed) {
  auto demonstrations = test::CorridorDemonstrations(1, 20);
  const auto warnings = [&] {
    return Warnings(*GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                     {.features = "tip", .action_limit = {0.2}}));
  };
  EXPECT_THAT(warnings(), testing::Each(testing::Not(HasSubstr("repeats"))));
  demonstrations.push_back(demonstrations[3]);
  EXPECT_THAT(warnings(),
              testing::Contains(HasSubstr("demonstration 20 repeats demonstration 3: a copy")));
  demonstrations.push_back(demonstrations[7]);
  demonstrations.push_back(demonstrations[3]);
  EXPECT_THAT(warnings(),
              testing::Contains(HasSubstr(
                  "demonstration 20 repeats demonstration 3, and 2 others are copies, too")));
  // Equal motions under other actions are no copies.
  demonstrations.resize(20);
  demonstrations.push_back(demonstrations[3]);
  demonstrations.back().controls(0, 0) += 1e-9;
  EXPECT_THAT(warnings(), testing::Each(testing::Not(HasSubstr("repeats"))));
}

TEST(GuardAdviceTest, OneWrongValueInARecordingIsNamed) {
  const auto demonstrations = test::CorridorDemonstrations(1, 40);
  const auto model = GoodModel();
  auto wrong = demonstrations;
  wrong[7].controls(3, 1) = 1e6;
  EXPECT_THAT(FitWarnings(*model, wrong),
              testing::Contains(HasSubstr("entry 1 of action 3 of demonstration 7 is 1e+06")));
  wrong = demonstrations;
  wrong[7].states(4, 2) += 10.0;
  EXPECT_THAT(FitWarnings(*model, wrong),
              testing::Contains(testing::ContainsRegex(
                  "tip.1. changes by (10|9.*) at step [34] of demonstration 7")));
}

// An arm of one joint moves from random start angles to .6 rad and rests there.
std::vector<core::Trajectory> ArmDemonstrations(bool torques) {
  constexpr int kSteps = 80;
  constexpr double kPeriod = 0.05;
  constexpr double kGravity = 4.0;
  core::Random random(3);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < 20; ++i) {
    core::Trajectory d{core::Matrix(kSteps + 1, 2), core::Matrix(kSteps, 1)};
    double angle = random.Uniform(-0.6, 0.0);
    double rate = 0.0;
    d.states.row(0) << angle, rate;
    for (int t = 0; t < kSteps; ++t) {
      const double wanted = 4.0 * (0.6 - angle);
      if (torques) {
        d.controls(t, 0) = 4.0 * wanted - 8.0 * rate + kGravity * std::cos(angle);
        rate += kPeriod * (d.controls(t, 0) - kGravity * std::cos(angle));
      } else {
        d.controls(t, 0) = rate = wanted;
      }
      angle += kPeriod * rate;
      d.states.row(t + 1) << angle, rate;
    }
    demonstrations.push_back(std::move(d));
  }
  return demonstrations;
}

TEST(GuardAdviceTest, AnArmThatRestsUnderTorquesIsNamed) {
  core::StateLayout layout;
  layout.Add("arm", 2);
  const auto warnings = [&](bool torques) {
    const auto demonstrations = ArmDemonstrations(torques);
    const auto model = GuardModel::Fit(layout, demonstrations, {.accept_any = true});
    return FitWarnings(*model, demonstrations);
  };
  EXPECT_THAT(warnings(true), testing::Contains(HasSubstr("a zero action does not hold it")));
  EXPECT_THAT(warnings(false), testing::Not(testing::Contains(HasSubstr("zero action"))));
}

// A joint that turns at a nearly constant rate, and one that also varies. The second angle wraps.
TEST(GuardAdviceTest, AJointThatTurnsThroughoutDoesNotRest) {
  for (const double spread : {0.01, 0.03}) {
    SCOPED_TRACE(spread);
    core::Random random(7);
    std::vector<core::Trajectory> demonstrations;
    for (int i = 0; i < 20; ++i) {
      core::Trajectory d{core::Matrix(91, 1), core::Matrix(90, 1)};
      d.states(0, 0) = 2.0 + 0.1 * random.Normal();
      for (int t = 0; t < 90; ++t) {
        d.controls(t, 0) = 0.05 + spread * random.Normal();
        d.states(t + 1, 0) =
            std::remainder(d.states(t, 0) + d.controls(t, 0), 2.0 * std::numbers::pi);
      }
      demonstrations.push_back(std::move(d));
    }
    core::StateLayout layout;
    layout.Add("yaw", 1);
    const auto model = GuardModel::Fit(layout, demonstrations, {.accept_any = true});
    EXPECT_THAT(model->summary().fit_warnings, testing::Not(testing::Contains(HasSubstr("rests"))));
  }
}

TEST(GuardAdviceTest, AClockIsFoundInAnyUnitAndAConstantIsNoClock) {
  constexpr const char* kClock = "the same in all demonstrations";
  const auto demonstrations = test::CorridorDemonstrations(1, 40);
  const auto whole = GuardModel::Fit(test::CorridorLayout(), demonstrations);
  auto slow = demonstrations;
  for (core::Trajectory& d : slow) d.states.col(0) *= 1e-6;
  EXPECT_THAT(FitWarnings(*whole, slow),
              testing::Contains(testing::StartsWith("clock[0]: the same")));
  auto still = demonstrations;
  for (core::Trajectory& d : still) d.states.col(0).setConstant(3.0);
  EXPECT_THAT(FitWarnings(*whole, still), testing::Not(testing::Contains(HasSubstr(kClock))));
  // The last part of the longest demonstration has no other demonstration to compare with.
  const auto tip = GoodModel();
  EXPECT_THAT(FitWarnings(*tip, demonstrations), testing::IsEmpty());
  auto longer = test::CorridorDemonstrations(1, 40);
  longer.push_back(test::CorridorDemonstrations(2, 1, 25)[0]);
  longer.back().states.bottomRows(5).array() += 1e6;
  EXPECT_THAT(FitWarnings(*tip, longer), testing::Not(testing::Contains(HasSubstr(kClock))));
}

// An object settles while the robot pauses.
TEST(GuardAdviceTest, MotionUnderAZeroActionIsNamedForACertificate) {
  for (const double drift : {0.0, 0.01}) {
    auto demonstrations = test::CorridorDemonstrations(1, 30);
    for (core::Trajectory& d : demonstrations) {
      for (Eigen::Index t = 8; t < 12; ++t) {
        const Eigen::RowVector3d step = d.states.row(t + 1) - d.states.row(t);
        d.states.bottomRows(d.states.rows() - t - 1).rightCols(2).rowwise() -= step.tail(2);
        d.states.bottomRows(d.states.rows() - t - 1).col(2).array() += drift;
        d.controls.row(t).setZero();
      }
    }
    for (const Strategy strategy : {Strategy::kGuard, Strategy::kCertified}) {
      const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                         {.features = "tip", .strategy = strategy});
      EXPECT_EQ(testing::Value(Warnings(*model),
                               testing::Contains(HasSubstr("in steps with a zero action"))),
                drift > 0.0 && strategy == Strategy::kCertified);
    }
  }
}

TEST(GuardAdviceTest, ErrorsAsLargeAsTheEffectsAreNamedForACertificate) {
  const auto model = GoodModel();
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kCertified}) {
    for (const double share : {0.99, 1.0}) {
      GuardSettings settings = model->settings();
      settings.strategy = strategy;
      settings.direction_error = share * model->summary().gain.value;
      EXPECT_EQ(testing::Value(Warnings(*model->With(settings)),
                               testing::Contains(HasSubstr("can certify almost no action"))),
                strategy == Strategy::kCertified && share == 1.0);
    }
  }
}

// Warnings judge every third transition. In one order these would be the contradictory ones.
TEST(GuardAdviceTest, WarningsDoNotDependOnTheOrderOfDemonstrations) {
  const auto model = GoodModel();
  auto demonstrations = test::CorridorDemonstrations(1, 60);
  ASSERT_EQ(demonstrations[0].controls.rows() % 3, 2);
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    core::Matrix& controls = demonstrations[d].controls;
    for (auto t = static_cast<Eigen::Index>(d % 3); t < controls.rows(); t += 3) {
      controls.row(t) *= 0.2;
    }
  }
  const std::vector<core::Trajectory> reversed(demonstrations.rbegin(), demonstrations.rend());
  EXPECT_EQ(FitWarnings(*model, demonstrations), FitWarnings(*model, reversed));
}

TEST(GuardAdviceTest, ActionsThatContradictTheMotionExplainNothing) {
  const auto model = GoodModel();
  // Moves slightly backwards, although the demonstrated action moves forwards.
  core::Trajectory back;
  back.states.resize(2, 3);
  back.states << 0.0, 0.0, 0.0, 1.0, -0.02, 0.0;
  back.controls = test::ActionFor(test::kSpeed, 0.0).transpose();
  EXPECT_THAT(FitWarnings(*model, std::vector{back}),
              testing::Contains(testing::StartsWith("actions explain only 0 % of")));
  // Constant states give no warning.
  back.states.row(1) = back.states.row(0);
  EXPECT_THAT(FitWarnings(*model, std::vector{back}), testing::IsEmpty());
}

TEST(GuardAdviceTest, TheGuaranteeNamesItsFitsAndItsDemonstrations) {
  GuardSummary summary;
  EXPECT_EQ(DescribeGuarantee(summary), "on average over fits, approximately, by cross-validation");
  summary.held_out = 12;
  EXPECT_EQ(DescribeGuarantee(summary), "on average over fits, by 12 held-out demonstrations");
  summary.confidence = 0.95;
  EXPECT_EQ(DescribeGuarantee(summary),
            "with 95 % confidence for this fit, by 12 held-out demonstrations");
}

}  // namespace
}  // namespace dfr::safety
