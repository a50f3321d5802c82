#include "dfr/study/supports.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <utility>
#include <vector>

#include "apps/study/task.h"
#include "dfr/core/random.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::study {
namespace {

const LearnedModel& Corridor() {
  static const LearnedModel model = MakeTask("planar-corridor").learn(30, 5);
  return model;
}

// Fits each estimate once.
const SupportModel& Fitted(std::string_view name) {
  static std::map<std::string_view, SupportModel> models;
  return models
      .try_emplace(name, name, Corridor().fit(), Corridor().demonstrations().layout,
                   Corridor().demonstrations().trajectories)
      .first->second;
}

// Each estimate leaves a fraction of about nu of the demonstrated states outside.
TEST(SupportsTest, DemonstratedStatesAreInside) {
  for (const std::string_view name : kSupports) {
    const SupportModel& support = Fitted(name);
    int states = 0;
    int inside = 0;
    for (const core::Trajectory& d : Corridor().demonstrations().trajectories) {
      for (int t = 0; t < d.num_steps(); ++t) {
        ++states;
        inside += support.decision().Decision(t, core::Row(d.states, t)) >= 0.0 ? 1 : 0;
      }
    }
    EXPECT_GT(inside, 0.88 * states) << name;
    EXPECT_LT(support.decision().Decision(3, std::vector<double>{50.0, 50.0}), 0.0) << name;
  }
}

// Returns the features of a demonstrated state, moved by `spread`, and its time step.
std::pair<std::vector<double>, int> NearbyFeatures(const SupportModel& support, double spread,
                                                   core::Random& random) {
  const core::Trajectory& d = Corridor().demonstrations().trajectories[random.Below(30)];
  const int t = static_cast<int>(random.Below(static_cast<std::uint64_t>(d.num_steps())));
  std::vector<double> z(static_cast<std::size_t>(support.view().support().state_dim()));
  support.view().features().Apply(core::Row(d.states, t), z);
  for (double& entry : z) entry += spread * random.Normal();
  return {z, t};
}

TEST(SupportsTest, GradientsAreDerivatives) {
  core::Random random(4);
  for (const std::string_view name : kSupports) {
    const SupportModel& support = Fitted(name);
    const auto& l = support.view().support();
    for (int i = 0; i < 20; ++i) {
      const auto [z, t] = NearbyFeatures(support, 0.3, random);
      std::vector<double> slope(z.size());
      const double level = l.LogDecision(t, z, slope);
      EXPECT_EQ(level, l.LogDecision(t, z, {})) << name;
      for (std::size_t k = 0; k < z.size(); ++k) {
        constexpr double kStep = 1e-6;
        std::vector<double> there = z;
        there[k] += kStep;
        // If one neighbour replaces another within the step, the slope changes slightly.
        EXPECT_NEAR((l.LogDecision(t, there, {}) - level) / kStep, slope[k],
                    1e-3 * (1.0 + std::abs(slope[k])))
            << name;
      }
    }
  }
}

// The filter and the certificates rest on this bound.
TEST(SupportsTest, CurvatureBoundsHold) {
  core::Random random(5);
  for (const std::string_view name : kSupports) {
    const SupportModel& support = Fitted(name);
    const auto& l = support.view().support();
    for (int i = 0; i < 500; ++i) {
      const auto [z, t] = NearbyFeatures(support, 0.5, random);
      std::vector<double> there = z;
      std::vector<double> slope(z.size());
      const double level = l.LogDecision(t, z, slope);
      double bound = level;
      double square = 0.0;
      for (std::size_t k = 0; k < z.size(); ++k) {
        const double step = random.Normal();
        there[k] += step;
        bound += slope[k] * step;
        square += step * step;
      }
      bound -= l.curvature_bound(t) * square;
      EXPECT_GE(l.LogDecision(t, there, {}), bound - 1e-9 * (1.0 + std::abs(bound))) << name;
    }
  }
}

// The squares of their distances overflow.
TEST(SupportsTest, VeryFarStatesAreOutside) {
  for (const std::string_view name : {"knn-distance", "density", "mahalanobis"}) {
    const std::vector<double> far = {1e200, -1e200};
    std::vector<double> gradient(2, 1.0);
    EXPECT_EQ(Fitted(name).view().support().LogDecision(0, far, gradient),
              -std::numeric_limits<double>::infinity())
        << name;
    EXPECT_EQ(gradient, std::vector<double>(2, 0.0)) << name;
  }
}

TEST(SupportsTest, BrokenStatesAreOutsideAndNothingIsAllocated) {
  for (const std::string_view name : kSupports) {
    const SupportModel& support = Fitted(name);
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::vector<double> broken = {nan, 0.0};
    const std::vector<double> whole = {0.1, 0.0};
    std::vector<double> gradient(2);
    const test::NoAlloc guard;
    EXPECT_EQ(support.decision().Decision(0, broken), -std::numeric_limits<double>::infinity());
    EXPECT_TRUE(std::isfinite(support.decision().Gradient(0, whole, gradient)));
  }
}

TEST(SupportsTest, UnknownNamesAreReportedWithTheValidOnes) {
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { static_cast<void>(Fitted("magic")); }),
      testing::HasSubstr("mahalanobis"));
}

}  // namespace
}  // namespace dfr::study
