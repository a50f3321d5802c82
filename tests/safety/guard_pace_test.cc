#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {
namespace {

using control::Mode;
using Law = std::function<std::vector<double>(const std::vector<double>&)>;

core::StateLayout Layout() {
  core::StateLayout layout;
  layout.Add("tip", 2);
  return layout;
}

// `count` demonstrations of `law` from a start near 0 until x = `goal`, with smooth noise of the
// speed.
std::vector<core::Trajectory> Demonstrate(const Law& law, double goal, double noise, int count,
                                          std::uint64_t seed) {
  core::Random random(seed);
  std::vector<core::Trajectory> demonstrations(static_cast<std::size_t>(count));
  for (core::Trajectory& demonstration : demonstrations) {
    std::vector<double> x = {0.3 * random.Normal() * noise, random.Normal() * noise};
    std::vector<std::vector<double>> states = {x};
    std::vector<std::vector<double>> controls;
    std::vector<double> slow = {0.0, 0.0};
    while (x[0] < goal) {
      std::vector<double> u = law(x);
      for (int k = 0; k < 2; ++k) {
        slow[k] = 0.8 * slow[k] + 0.6 * 0.16 * noise * random.Normal();
        u[k] += slow[k];
        x[k] += u[k];
      }
      controls.push_back(u);
      states.push_back(x);
    }
    demonstration.states.resize(std::ssize(states), 2);
    demonstration.controls.resize(std::ssize(controls), 2);
    for (Eigen::Index t = 0; t < std::ssize(states); ++t) {
      for (int k = 0; k < 2; ++k) {
        demonstration.states(t, k) = states[static_cast<std::size_t>(t)][k];
        if (t < std::ssize(controls)) {
          demonstration.controls(t, k) = controls[static_cast<std::size_t>(t)][k];
        }
      }
    }
  }
  return demonstrations;
}

// Demonstrations end in motion at x = 1. Near the end, a push moves the robot aside. The policy
// first returns to the line and then stops at x = 1. Nearby demonstrations only move on.
TEST(GuardPaceTest, LetsAPolicyReturnAfterAPushNearTheEnd) {
  const Law law = [](const std::vector<double>& x) {
    return std::vector{0.04, std::clamp(-0.3 * x[1], -0.04, 0.04)};
  };
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const auto model =
        GuardModel::Fit(Layout(), Demonstrate(law, 1.0, 0.05, 45, seed), {.features = "tip"});
    Guard guard(model);
    for (const double push : {0.2, 0.3}) {
      SCOPED_TRACE(testing::Message() << "push " << push << ", seed " << seed);
      guard.Reset(1);
      std::vector<double> x = {0.0, 0.0};
      std::vector<double> safe(2);
      bool pushed = false;
      for (int t = 0; t < 80; ++t) {
        if (x[0] > 0.93 && !pushed) {
          x[1] += push;
          pushed = true;
        }
        std::vector<double> action = law(x);
        if (pushed) {
          action[0] = std::abs(x[1]) < 0.1 ? std::clamp(1.0 - x[0], -0.04, 0.04)
                                           : std::clamp(0.9 - x[0], -0.04, 0.0);
        }
        const Verdict verdict = guard.Filter(t, x, action, safe);
        ASSERT_NE(verdict.mode, Mode::kHalt) << verdict.reason() << ", step " << t;
        for (int k = 0; k < 2; ++k) x[k] += safe[k];
        ASSERT_LT(x[0], 1.15) << "step " << t;
        if (pushed && std::abs(x[1]) < 0.1) break;
      }
      EXPECT_LT(std::abs(x[1]), 0.1);
    }
  }
}

// In a zone, demonstrations halve their speed. A policy that is a tenth slower everywhere must not
// be corrected to the speed outside of the zone.
TEST(GuardPaceTest, DoesNotHurryASlowPolicy) {
  const auto in_zone = [](double x) { return x >= 2.0 && x < 3.5; };
  const Law law = [&](const std::vector<double>& x) {
    return std::vector{in_zone(x[0]) ? 0.05 : 0.1, std::clamp(-0.3 * x[1], -0.05, 0.05)};
  };
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    const std::vector<core::Trajectory> demonstrations = Demonstrate(law, 4.5, 0.04, 25, seed);
    Guard guard(GuardModel::Fit(Layout(), demonstrations, {.features = "tip"}));
    guard.Reset(1);
    std::vector<double> x = {0.0, 0.0};
    std::vector<double> safe(2);
    int steps = 0;
    int passed = 0;
    for (int t = 0; t < 120 && x[0] < 4.5; ++t, ++steps) {
      std::vector<double> action = law(x);
      action[0] *= 0.9;
      const Verdict verdict = guard.Filter(t, x, action, safe);
      ASSERT_NE(verdict.mode, Mode::kHalt) << "step " << t;
      passed += verdict.changed ? 0 : 1;
      ASSERT_LT(safe[0], in_zone(x[0]) ? 0.08 : 0.2) << "x = " << x[0];
      for (int k = 0; k < 2; ++k) x[k] += safe[k];
    }
    EXPECT_GE(x[0], 4.5);
    EXPECT_GT(passed, 0.9 * steps);
  }
}

}  // namespace
}  // namespace dfr::safety
