#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <numbers>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/constants.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/safety/pictures/picture_corridor.h"
#include "tests/support/message_of.h"

// A fit to pictures chooses a strategy or refuses the pictures.
namespace dfr::safety {
namespace {

using test::FittedModel;
using test::kPixels;
using test::PictureDemonstrations;
using test::PictureLayout;
using test::PointsModel;
using test::Seen;
using test::StateAt;
using testing::HasSubstr;

TEST(ReducedGuardFitTest, IsAMonitorIfItWouldCorrectTheDemonstrator) {
  EXPECT_GT(FittedModel()->summary().ends_outside, 0.12);
  EXPECT_EQ(FittedModel()->settings().strategy, Strategy::kMonitor);
  EXPECT_THAT(Warnings(*FittedModel()),
              testing::Contains(HasSubstr("strategy monitor, not guard")));
  GuardOptions options{.features = "pca:camera"};
  options.accept_any = true;
  const auto any = GuardModel::Fit(PictureLayout(), PictureDemonstrations(1, 12), options);
  EXPECT_EQ(any->settings().strategy, Strategy::kGuard);
  EXPECT_THAT(Warnings(*any), testing::Contains(HasSubstr("can make a good policy fail")));
  // Keeps a strategy without corrections: a monitor would be less cautious.
  const auto stops =
      GuardModel::Fit(PictureLayout(), PictureDemonstrations(1, 24),
                      {.features = "pca:camera", .strategy = Strategy::kEarlyStopping});
  EXPECT_EQ(stops->settings().strategy, Strategy::kEarlyStopping);
}

// Actions lead forward or back by chance.
TEST(ReducedGuardFitTest, IsAMonitorIfNothingExplainsTheActions) {
  core::Random random(3);
  std::vector<core::Trajectory> demonstrations = PictureDemonstrations(1, 12);
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t) {
      if (random.Uniform() < 0.5) d.controls.row(t) *= -1.0;
    }
  }
  const auto model =
      GuardModel::Fit(PictureLayout(), demonstrations, {.features = "pca:camera:2:light=none"});
  EXPECT_LE(model->summary().ends_outside, 0.12);
  EXPECT_LT(model->summary().explained, 0.1);
  EXPECT_EQ(model->settings().strategy, Strategy::kMonitor);
}

// Actions lead along and across the corridor. Pictures explain little of the entry across the
// corridor, whose mean is zero.
TEST(ReducedGuardFitTest, IsAMonitorIfPicturesDoNotExplainTheEntryThatVariesMost) {
  core::Random random(8);
  std::vector<core::Trajectory> demonstrations = PictureDemonstrations(1, 14);
  for (core::Trajectory& d : demonstrations) {
    double x = 0.05 * random.Normal();
    double y = 0.05 * random.Normal();
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      d.states.row(t).head(kPixels) =
          Eigen::Map<const Eigen::RowVectorXd>(Seen(x, y, random).data(), kPixels);
      if (t == d.controls.rows()) break;
      const double dy =
          0.05 * std::cos(0.5 * static_cast<double>(t)) - 0.3 * y + 0.05 * random.Normal();
      const double dx = test::kSpeed * random.Uniform(0.8, 1.2);
      d.controls.row(t) << dx, dy;
      x += dx;
      y += dy;
    }
  }
  const auto model =
      GuardModel::Fit(PictureLayout(), demonstrations, {.features = "points:camera"});
  EXPECT_LE(model->summary().ends_outside, 0.12);
  EXPECT_LT(model->summary().action_error, 0.5);
  EXPECT_GT(model->summary().entry_error, 0.6);
  EXPECT_EQ(model->settings().strategy, Strategy::kMonitor);
  EXPECT_THAT(Warnings(*model), testing::Contains(HasSubstr("corrections need at least 40 %")));
}

TEST(ReducedGuardFitTest, ACallbackStopsTheChoiceOfComponents) {
  const std::vector<core::Trajectory> demonstrations = PictureDemonstrations(1, 12);
  GuardOptions options{.features = "pca:camera"};
  for (int last = 1; last <= 5; ++last) {
    int calls = 0;
    options.progress = [&](std::string_view stage, double) {
      EXPECT_EQ(stage, "choosing components");
      return ++calls != last;
    };
    EXPECT_EQ(GuardModel::Fit(PictureLayout(), demonstrations, options), nullptr);
    EXPECT_EQ(calls, last) << "called again after the stop";
  }
  options.progress = {};
  for (int last = 1; last <= 5; ++last) {
    int calls = 0;
    options.support.svm.progress = [&](const kernel::FitProgress&) { return ++calls != last; };
    EXPECT_EQ(GuardModel::Fit(PictureLayout(), demonstrations, options), nullptr);
    EXPECT_EQ(calls, last) << "called again after the stop";
  }
}

// An angle beside a picture need not be a feature: targets of its axis still take the short way.
TEST(ReducedGuardFitTest, AnAngleBesideAPictureHasAPeriod) {
  core::Random random(4);
  core::StateLayout layout = PictureLayout();
  layout.Add("yaw", 1);
  std::vector<core::Trajectory> demonstrations = PictureDemonstrations(1, 12);
  for (core::Trajectory& d : demonstrations) {
    const Eigen::Index last = d.states.cols();
    d.states.conservativeResize(Eigen::NoChange, last + 1);
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      const double yaw = 2.6 + 0.1 * static_cast<double>(t) + 0.02 * random.Normal();
      d.states(t, last) = std::remainder(yaw, 2.0 * std::numbers::pi);
    }
  }
  const auto model = GuardModel::Fit(layout, demonstrations,
                                     {.features = "pca:camera:2:light=none", .accept_any = true});
  std::vector<double> expected(static_cast<std::size_t>(layout.state_dim()), 0.0);
  expected.back() = 2.0 * std::numbers::pi;
  EXPECT_EQ(model->Periods(), expected);
}

TEST(ReducedGuardFitTest, PointsAreFeaturesOfAGuard) {
  const auto model = PointsModel();
  // The demonstrator's noise is not a function of the pictures.
  EXPECT_LT(model->summary().explained, 0.8);
  EXPECT_LE(model->summary().ends_outside, 0.12);
  EXPECT_EQ(model->settings().strategy, Strategy::kGuard);
  EXPECT_THAT(Warnings(*model), testing::Contains(HasSubstr("save few failures below 80 %")));
  EXPECT_LE(model->task_layout().state_dim(), 8);
  EXPECT_GE(model->summary().acceptance, 0.85);
  core::Random random(6);
  const std::vector<double> outside = StateAt(1.0, 0.3, random);
  core::Matrix states(1, kPixels + 1);
  states.row(0) = core::AsVector(outside).transpose();
  const double l = model->Levels(states)[0];
  ASSERT_LT(l, -0.5);
  EXPECT_NEAR(Attribution(*model, states).sum(), -l, 1e-6 * -l);
}

TEST(ReducedGuardFitTest, RefusesPicturesThatDoNotShowTheTask) {
  std::vector<core::Trajectory> demonstrations = PictureDemonstrations(2, 12);
  core::Random random(8);
  for (core::Trajectory& d : demonstrations) {
    for (double& value : d.states.reshaped()) value = std::floor(random.Uniform(0.0, 255.0));
    for (double& value : d.controls.reshaped()) value = random.Normal();
  }
  const std::string message = test::MessageOf([&] {
    static_cast<void>(GuardModel::Fit(PictureLayout(), demonstrations, {.features = "pca:camera"}));
  });
  EXPECT_THAT(message, HasSubstr("pca:camera"));
  EXPECT_THAT(message, HasSubstr("do not explain the actions"));
}

TEST(ReducedGuardFitTest, RefusesAGuardThatWouldStopTheDemonstrator) {
  // Forty components of 12 demonstrations contain mostly light and noise.
  const auto fit = [](bool accept_any) {
    return GuardModel::Fit(PictureLayout(), PictureDemonstrations(3, 12),
                           {.features = "pca:camera:40:light=none", .accept_any = accept_any});
  };
  const std::string message = test::MessageOf([&] { static_cast<void>(fit(false)); });
  EXPECT_THAT(message, HasSubstr("end at too low a level to pass"));
  EXPECT_THAT(message, HasSubstr("Record more demonstrations"));
  EXPECT_THAT(message, HasSubstr("light=standard"));
  EXPECT_NE(fit(true), nullptr);
}

// The corridor's tip in a block of 8 entries, beside nuisances that are constant in each episode
// and have most of the variance.
std::vector<core::Trajectory> EmbeddedDemonstrations(std::uint64_t seed, int count,
                                                     const core::Matrix& mixing) {
  core::Random random(seed);
  std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(seed, count);
  for (core::Trajectory& d : demonstrations) {
    Eigen::RowVectorXd source(8);
    for (double& value : source) value = random.Uniform(-3.0, 3.0);
    core::Matrix seen(d.states.rows(), 8);
    for (Eigen::Index t = 0; t < seen.rows(); ++t) {
      source.head(2) = d.states.row(t).tail(2);
      Eigen::RowVectorXd noisy = source;
      for (double& value : noisy) value += 0.01 * random.Normal();
      seen.row(t) = noisy * mixing.transpose();
    }
    d.states = seen;
  }
  return demonstrations;
}

TEST(ReducedGuardFitTest, PrefersComponentsThatActionsDependOnToSlowNuisances) {
  core::Random random(14);
  core::Matrix mixing(8, 8);
  for (double& value : mixing.reshaped()) value = random.Normal();
  core::StateLayout layout;
  layout.Add("code", 8);
  const std::vector<core::Trajectory> demonstrations = EmbeddedDemonstrations(15, 28, mixing);
  for (const char* const features : {"pca:code", "slow:code"}) {
    const auto model = GuardModel::Fit(layout, demonstrations, {.features = features});
    const GuardSummary& summary = model->summary();
    EXPECT_LE(model->reduction()->reduced_dim(), 3) << features;
    EXPECT_THAT(summary.components_reason, HasSubstr("components that actions depend on explain"));
    EXPECT_GE(summary.acceptance, fit::kLeastInsideReduced);
    // States of new episodes are inside, regardless of their nuisances.
    double inside = 0.0;
    double states = 0.0;
    Guard guard(model);
    for (const core::Trajectory& d : EmbeddedDemonstrations(16, 20, mixing)) {
      guard.Reset(1);
      for (Eigen::Index t = 0; t < d.controls.rows(); ++t, states += 1.0) {
        const Eigen::RowVectorXd wish = d.controls.row(t);
        std::vector<double> action(wish.begin(), wish.end());
        const Verdict verdict =
            guard.Filter(static_cast<int>(t), core::Row(d.states, t), action, action);
        inside += verdict.g >= 0.0 ? 1.0 : 0.0;
      }
    }
    EXPECT_GT(inside / states, 0.85);
  }
}

}  // namespace
}  // namespace dfr::safety
