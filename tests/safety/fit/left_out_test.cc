#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::safety {
namespace {

using testing::Contains;
using testing::HasSubstr;

// The corridor. Each action leads forward or back by chance, which no feature shows.
std::vector<core::Trajectory> Undecided(std::uint64_t seed, int count) {
  core::Random random(seed);
  auto demonstrations = test::CorridorDemonstrations(seed, count);
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t) {
      const double dx = random.Uniform() < 0.5 ? -test::kSpeed : test::kSpeed;
      const double dy = -0.3 * d.states(t, 2) + 0.02 * random.Normal();
      d.controls.row(t) = test::ActionFor(dx, dy).transpose();
      d.states.row(t + 1) << t + 1.0, d.states(t, 1) + dx, d.states(t, 2) + dy;
    }
  }
  return demonstrations;
}

// `copies` noisy readings of 14 quantities, and 14 action entries that move them.
std::vector<core::Trajectory> Redundant(int count, int copies, double noise) {
  constexpr int kHidden = 14;
  constexpr int kSteps = 15;
  core::Random random(4);
  core::Matrix mix(copies, kHidden);
  for (Eigen::Index i = 0; i < mix.size(); ++i) mix.data()[i] = random.Normal();
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < count; ++d) {
    core::Trajectory demonstration;
    demonstration.states.resize(kSteps + 1, copies + 2);
    demonstration.controls.resize(kSteps, kHidden);
    Eigen::VectorXd x(kHidden);
    for (double& entry : x) entry = random.Normal();
    for (int t = 0; t <= kSteps; ++t) {
      Eigen::VectorXd readings = mix * x;
      for (double& entry : readings) entry += noise * random.Normal();
      demonstration.states.row(t).head(copies) = readings.transpose();
      demonstration.states.row(t).tail(2) = x.head(2).transpose();
      if (t == kSteps) break;
      for (int k = 0; k < kHidden; ++k) {
        demonstration.controls(t, k) = -0.1 * x[k] + 0.1 * random.Normal();
      }
      x += demonstration.controls.row(t).transpose();
    }
    demonstrations.push_back(demonstration);
  }
  return demonstrations;
}

core::StateLayout RedundantLayout(int copies) {
  core::StateLayout layout;
  layout.Add("arms", copies);
  layout.Add("object", 2);
  return layout;
}

// A plant that follows the actions exactly, and one that adds noise to them.
TEST(LeftOutTest, PredictionErrorsAreThoseOfThePlant) {
  for (const bool noisy : {false, true}) {
    core::Random random(7);
    auto demonstrations = test::CorridorDemonstrations(3, 30);
    for (core::Trajectory& d : demonstrations) {
      for (Eigen::Index t = 0; t < d.controls.rows(); ++t) {
        const double dy = -0.3 * d.states(t, 2) + 0.02 * random.Normal();
        const double noise = noisy ? 0.02 * random.Normal() : 0.0;
        d.controls.row(t) = test::ActionFor(test::kSpeed, dy).transpose();
        d.states.row(t + 1) << t + 1.0, d.states(t, 1) + test::kSpeed, d.states(t, 2) + dy + noise;
      }
    }
    const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations);
    const double error = model->task().levels().prediction_error();
    if (noisy) {
      EXPECT_GT(error, 0.05);
      EXPECT_LT(error, 1.0);
    } else {
      EXPECT_LT(error, 0.01);
    }
  }
}

// Few demonstrations of noisy states: the guard passes most actions that are predicted to end
// outside.
TEST(LeftOutTest, AGuardChangesTheEstimatedFractionOfFurtherActions) {
  const auto noisy = [](std::uint64_t seed, int count) {
    core::Random random(seed);
    auto demonstrations = test::CorridorDemonstrations(seed, count);
    for (core::Trajectory& d : demonstrations) {
      for (double& x : d.states.rightCols(2).reshaped()) x += 0.1 * random.Normal();
    }
    return demonstrations;
  };
  const auto model = GuardModel::Fit(test::CorridorLayout(), noisy(3, 12));
  Guard guard(model);
  int actions = 0;
  int changed = 0;
  for (const core::Trajectory& d : noisy(4, 60)) {
    guard.Reset(1);
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t, ++actions) {
      std::vector<double> applied(2);
      const std::span<const double> action = core::Row(d.controls, t);
      const Verdict verdict =
          guard.Filter(static_cast<int>(t), core::Row(d.states, t), action, applied);
      changed += verdict.changed ? 1 : 0;
      guard.Applied(action);
    }
  }
  EXPECT_GT(model->summary().below_pass, model->summary().changed + 0.05);
  EXPECT_NEAR(model->summary().changed, static_cast<double>(changed) / actions, 0.03);
}

TEST(LeftOutTest, AGoodFitChangesFewActionsAndExplainsThem) {
  const auto model = test::Model();
  EXPECT_LT(model->summary().changed, 0.15);
  EXPECT_LE(model->summary().ends_outside, model->summary().below_pass);
  EXPECT_LE(model->summary().changed, model->summary().below_pass);
  EXPECT_TRUE(model->settings().demonstrated);
  // If all demonstrations take the same path, noise is most of the variance, but a small part of
  // the action.
  EXPECT_LT(model->summary().action_error, 0.4);
}

TEST(LeftOutTest, NominalActionsThatFeaturesDoNotExplainAreNotUsed) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), Undecided(1, 40), {.features = "tip"});
  EXPECT_LT(model->summary().explained, 0.2);
  EXPECT_GT(model->summary().action_error, 0.5);
  EXPECT_FALSE(model->settings().demonstrated);
  EXPECT_THAT(Warnings(*model), Contains(HasSubstr("the features explain only")));
  // Far outside, the guard applies the nominal action only if `demonstrated` is true.
  const auto sources = [&](bool demonstrated) {
    GuardSettings settings = model->settings();
    settings.demonstrated = demonstrated;
    Guard guard(model->With(settings));
    guard.Reset(1);
    test::CorridorPlant plant;
    plant.x = {0.0, 0.0, 0.35};
    int demonstrations = 0;
    std::vector<double> safe(2);
    const Eigen::Vector2d up = test::ActionFor(0.0, 0.2);
    for (int t = 0; t < 10; ++t) {
      const Verdict verdict = guard.Filter(t, plant.x, std::vector{up[0], up[1]}, safe);
      demonstrations += verdict.source == Source::kDemonstrations ? 1 : 0;
      plant.Apply(safe);
    }
    return demonstrations;
  };
  EXPECT_GT(sources(true), 0);
  EXPECT_EQ(sources(false), 0);
}

TEST(LeftOutTest, RedundantFeaturesAreRefusedAndBetterOnesNamed) {
  const auto demonstrations = Redundant(14, 28, 0.05);
  const auto layout = RedundantLayout(28);
  const std::string refusal = test::MessageOf<std::invalid_argument>(
      [&] { static_cast<void>(GuardModel::Fit(layout, demonstrations)); });
  EXPECT_THAT(refusal, HasSubstr("of the states of left-out demonstrations are inside"));
  EXPECT_THAT(refusal, HasSubstr("The 30 features"));
  EXPECT_THAT(refusal, HasSubstr("object ("));
  EXPECT_THAT(refusal, HasSubstr("accept_any"));
  const auto model = GuardModel::Fit(layout, demonstrations, {.accept_any = true});
  EXPECT_THAT(Warnings(*model), Contains(HasSubstr("the guard would change")));
  const auto chosen = GuardModel::Fit(layout, demonstrations, {.features = "object"});
  EXPECT_GT(chosen->summary().acceptance, 0.5);
}

core::StateLayout GrippingLayout() {
  core::StateLayout layout;
  layout.Add("tip", 2);
  layout.Add("closed", 1);
  return layout;
}

// A tip in the plane moves right. The gripper closes at a time that the demonstrator chooses, by a
// quarter of its range per step. The demonstrator then moves back if `returns`.
std::vector<core::Trajectory> Gripping(int count, bool returns = false) {
  constexpr int kSteps = 30;
  core::Random random(6);
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < count; ++d) {
    core::Trajectory demonstration;
    demonstration.states = core::Matrix::Zero(kSteps + 1, 3);
    demonstration.controls = core::Matrix::Zero(kSteps, 3);
    demonstration.states(0, 1) = 0.1 * random.Normal();
    const double decides = random.Uniform(8.0, 20.0);
    for (int t = 0; t < kSteps; ++t) {
      auto x = demonstration.states.row(t);
      auto u = demonstration.controls.row(t);
      const double forth = returns && t >= decides ? -0.02 : 0.02;
      u << forth + (returns ? 0.015 : 0.003) * random.Normal(),
          -0.2 * x[1] + 0.003 * random.Normal(), t >= decides ? 1.0 : -1.0;
      demonstration.states.row(t + 1) << x[0] + u[0], x[1] + u[1],
          std::clamp(x[2] + 0.25 * u[2], 0.0, 1.0);
    }
    demonstrations.push_back(demonstration);
  }
  return demonstrations;
}

TEST(LeftOutTest, AFeatureThatOnlyUnsteeredEntriesMoveIsOmittedAndNamed) {
  auto demonstrations = Gripping(20);
  const core::StateLayout layout = GrippingLayout();
  const auto model = GuardModel::Fit(layout, demonstrations);
  EXPECT_EQ(model->task().features().selection().indices(), (std::vector{0, 1}));
  EXPECT_THAT(Warnings(*model), Contains(HasSubstr("closed[0]: moved by entries")));
  // Steered entries that change at the same time partly explain the gripper's motion.
  const auto returning = GuardModel::Fit(layout, Gripping(20, true));
  EXPECT_EQ(returning->task().features().selection().indices(), (std::vector{0, 1}));
  EXPECT_NE(model->context(), nullptr);
  // With many different values, the gripper's entry is steered, and its feature stays.
  for (core::Trajectory& d : demonstrations) {
    core::Random random(static_cast<std::uint64_t>(d.states.sum() * 1e6));
    for (double& grip : d.controls.col(2)) grip *= random.Uniform(0.9, 1.0);
  }
  const auto steered = GuardModel::Fit(layout, demonstrations);
  EXPECT_EQ(steered->task().features().selection().num_features(), 3);
  // The gripper is the only feature.
  const auto alone = GuardModel::Fit(layout, Gripping(20), {.features = "closed"});
  EXPECT_EQ(alone->task().features().selection().num_features(), 1);
  EXPECT_EQ(alone->context(), nullptr);
}

// At the same place and time, demonstrators move back with a closed gripper and forward with an
// open one.
TEST(LeftOutTest, AnOmittedFeatureDistinguishesDemonstrations) {
  const auto path = dfr::test::ProcessFolder() / "context.guard";
  const auto fitted =
      GuardModel::Fit(GrippingLayout(), Gripping(40, true), {.strategy = Strategy::kController});
  fitted->Save(path);
  const auto loaded = GuardModel::Load(path);
  std::filesystem::remove(path);
  std::vector<double> ends;
  for (const auto& model : {fitted, loaded}) {
    for (const int closes : {10, 30}) {
      Guard guard(model);
      guard.Reset(1);
      std::vector<double> state = {0.0, 0.0, 0.0};
      std::vector<double> action(3);
      for (int t = 0; t < 18; ++t) {
        const double gripper = t >= closes ? 1.0 : -1.0;
        // The policy leaves the support sideways.
        static_cast<void>(guard.Filter(t, state, std::vector{0.0, 0.04, gripper}, action));
        ASSERT_EQ(action[2], gripper);
        state = {state[0] + action[0], state[1] + action[1],
                 std::clamp(state[2] + 0.25 * gripper, 0.0, 1.0)};
      }
      ends.push_back(state[0]);
    }
  }
  EXPECT_GT(ends[1], ends[0] + 0.05);
  EXPECT_EQ(ends[2], ends[0]);
  EXPECT_EQ(ends[3], ends[1]);
}

// The policy's action leaves the support, and no change of it passes without an ascent.
TEST(LeftOutTest, AnOmittedFeatureDistinguishesDemonstrationsOfACertifiedGuard) {
  const auto fitted =
      GuardModel::Fit(GrippingLayout(), Gripping(40, true),
                      {.strategy = Strategy::kCertified, .action_limit = {1.0, 1.0, 1.0}});
  GuardSettings settings = fitted->settings();
  settings.direction_error = 0.5;
  const auto model = fitted->With(settings);
  const auto forth = [&](double closed) {
    Guard guard(model);
    guard.Reset(1);
    std::vector<double> state = {0.0, 0.0, 0.0};
    std::vector<double> action(3);
    // The robot follows demonstrations up to the time at which some grippers are closed.
    int t = 0;
    for (; t < 12; ++t) {
      const Verdict verdict = guard.Filter(t, state, std::vector{0.02, 0.0, -1.0}, action);
      EXPECT_NE(verdict.mode, control::Mode::kHalt) << t << ": " << verdict.reason();
      state[0] += action[0];
      state[1] += action[1];
    }
    state[2] = closed;
    const Verdict verdict = guard.Filter(t, state, std::vector{0.0, 1.0, 1.0}, action);
    EXPECT_EQ(verdict.source, Source::kDemonstrations) << verdict.reason();
    return action[0];
  };
  EXPECT_GT(forth(0.0), forth(1.0) + 0.01);
}

}  // namespace
}  // namespace dfr::safety
