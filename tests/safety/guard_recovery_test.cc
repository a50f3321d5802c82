#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "dfr/control/published/switching_controller.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"

namespace dfr::safety {
namespace {

using control::Mode;
using test::Action;
using test::CorridorPlant;
using test::Model;
using testing::HasSubstr;

// Recovers with a constant action.
class Shove final : public control::RecoveryStrategy {
 public:
  explicit Shove(std::vector<double> action) : action_(std::move(action)) {}
  void Reset(std::uint64_t) noexcept override {}
  [[nodiscard]] Mode Next(const control::RecoverySituation&,
                          std::span<double> u) noexcept override {
    std::copy(action_.begin(), action_.end(), u.begin());
    return Mode::kRecovery;
  }

 private:
  std::vector<double> action_;
};

// One wrong measurement, as of a tracker that loses its mark, must not outweigh all correct ones.
// Otherwise a policy that needs no guard to reach the goal leaves the corridor.
TEST(GuardRecoveryTest, OneWrongMeasurementIsNotLearned) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController}) {
    Guard guard(Model(strategy));
    for (const double off : {10.0, 1e3, 1e6, 1e12}) {
      for (int start = -2; start <= 2; ++start) {
        CorridorPlant plant;
        plant.x[2] = 0.05 * start;
        guard.Reset(1);
        std::vector<double> safe(2);
        int t = 0;
        for (; t < 60 && plant.x[1] < 1.8; ++t) {
          std::vector<double> measured = plant.x;
          if (t == 3) measured[2] += off;
          const std::vector<double> action = Action(0.1, -0.3 * plant.x[2]);
          ASSERT_NE(guard.Filter(t, measured, action, safe).mode, Mode::kHalt) << off << ' ' << t;
          plant.Apply(safe);
          ASSERT_LT(std::abs(plant.x[2]), 0.6) << off << ' ' << t;
        }
        EXPECT_LT(t, 60) << off;
      }
    }
  }
}

// Algorithm 1 with the caller's recovery replaces every strategy of the settings.
TEST(GuardRecoveryTest, ARecoveryOfTheCallerTakesOverAtTheBoundary) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kMonitor}) {
    SCOPED_TRACE(Name(strategy));
    const auto model = Model(strategy);
    const std::vector<double> own = Action(0.0, -0.02);
    Guard guard(model, std::make_unique<Shove>(own));
    guard.Reset(1);
    CorridorPlant plant;
    const std::vector<double> action = Action(0.09, 0.04);
    std::vector<double> safe(2);
    int recoveries = 0;
    for (int t = 0; t < 30; ++t) {
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      if (verdict.mode == Mode::kHalt) break;
      // The gate of Algorithm 1 at the current step.
      const auto step =
          std::min<std::size_t>(static_cast<std::size_t>(verdict.step), model->lambda().size() - 1);
      EXPECT_EQ(verdict.g, model->support().Decision(verdict.step, plant.x));
      EXPECT_EQ(verdict.mode == Mode::kPolicy, verdict.g > verdict.threshold);
      EXPECT_NEAR(verdict.threshold, model->lambda()[step] * std::hypot(action[0], action[1]),
                  1e-12);
      if (verdict.mode == Mode::kRecovery) {
        ++recoveries;
        EXPECT_STREQ(verdict.reason(), "recovery");
        EXPECT_EQ(safe, own);
      }
      plant.Apply(safe);
    }
    EXPECT_GT(recoveries, 0);
  }
}

TEST(GuardRecoveryTest, ARecoveryOfTheCallerIsClampedToTheLimit) {
  GuardSettings settings = Model()->settings();
  settings.action_limit = {0.1};
  Guard guard(Model()->With(settings), std::make_unique<Shove>(std::vector{7.0, -0.02}));
  guard.Reset(1);
  // The state is slightly inside. An action of this size can change g by more than the margin.
  const std::vector<double> state = {0.0, 0.08, 0.0};
  std::vector<double> safe(2);
  const Verdict verdict = guard.Filter(0, state, Action(0.09, 0.04), safe);
  ASSERT_EQ(verdict.mode, Mode::kRecovery) << verdict.reason();
  EXPECT_THAT(safe, testing::ElementsAre(0.1, -0.02));
}

// For any policy: no state raises an alarm while the robot responds as demonstrated, and the guard
// halts at the first response that differs too much.
TEST(CertifiedGuardTest, RaisesNoAlarmAndHaltsIfItsAssumptionFails) {
  Guard guard(Model(Strategy::kCertified));
  core::Random random(5);
  int certified = 0;
  int steps = 0;
  for (int episode = 0; episode < 15; ++episode) {
    guard.Reset(static_cast<std::uint64_t>(episode));
    CorridorPlant plant;
    std::vector<double> safe(2);
    for (int t = 0; t < 60; ++t) {
      const std::vector<double> action = {0.3 * random.Normal() + 0.05, 0.3 * random.Normal()};
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      ASSERT_NE(verdict.cause, control::HaltCause::kViolated);
      if (verdict.mode == Mode::kHalt) break;
      EXPECT_FALSE(verdict.alarm) << "episode " << episode << ", step " << t;
      ++steps;
      certified += verdict.certified ? 1 : 0;
      plant.Apply(safe);
    }
  }
  EXPECT_GT(steps, 300);
  EXPECT_EQ(certified, steps);

  guard.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(2);
  Verdict verdict = guard.Filter(0, plant.x, Action(test::kSpeed, 0.0), safe);
  ASSERT_TRUE(verdict.certified);
  // The robot moves in the opposite direction.
  for (double& entry : safe) entry = -entry;
  plant.Apply(safe);
  verdict = guard.Filter(1, plant.x, Action(test::kSpeed, 0.0), safe);
  EXPECT_STREQ(verdict.reason(), "assumption-violated");
}

TEST(CertifiedGuardTest, RaisesItsAlarmAgainAfterAStop) {
  Guard guard(Model(Strategy::kCertified));
  guard.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(2);
  ASSERT_TRUE(guard.Filter(0, plant.x, Action(test::kSpeed, 0.0), safe).certified);
  guard.Stop(control::HaltCause::kStopRequested);
  plant.x[2] += 100.0;
  const Verdict verdict = guard.Filter(1, plant.x, Action(test::kSpeed, 0.0), safe);
  EXPECT_EQ(verdict.cause, control::HaltCause::kStopRequested);
  EXPECT_FALSE(verdict.certified);
  EXPECT_TRUE(verdict.alarm);
}

// An alarm can begin inside the support. The certificate then holds the state at that level.
TEST(CertifiedGuardTest, KeepsANegativeAlarmLevel) {
  GuardSettings settings = Model(Strategy::kCertified)->settings();
  settings.alarm_level = -0.02;
  Guard guard(Model()->With(settings));
  core::Random random(5);
  int certified = 0;
  for (int episode = 0; episode < 15; ++episode) {
    guard.Reset(static_cast<std::uint64_t>(episode));
    CorridorPlant plant;
    std::vector<double> safe(2);
    bool promised = false;
    for (int t = 0; t < 60; ++t) {
      const std::vector<double> action = {0.3 * random.Normal() + 0.05, 0.3 * random.Normal()};
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      EXPECT_FALSE(promised && verdict.alarm) << "episode " << episode << ", step " << t;
      if (verdict.mode == Mode::kHalt) break;
      promised = verdict.certified;
      certified += promised ? 1 : 0;
      plant.Apply(safe);
    }
  }
  EXPECT_GT(certified, 50);
}

// The certificate of the last action also covers the state at which the episode ends.
TEST(CertifiedGuardTest, RaisesNoAlarmAtTheEndOfAnEpisode) {
  GuardSettings settings = Model(Strategy::kCertified)->settings();
  settings.alarm_level = -0.01;
  core::Random random(5);
  for (const bool stops : {false, true}) {
    SCOPED_TRACE(stops ? "stopped" : "time up");
    int ends = 0;
    for (int episode = 0; episode < 300; ++episode) {
      settings.horizon = stops ? 100 : 2 + episode % 15;
      Guard guard(Model()->With(settings));
      const GuardModel& model = guard.model();
      guard.Reset(1);
      CorridorPlant plant;
      std::vector<double> safe(2);
      Verdict verdict;
      bool promised = false;
      for (int t = 0; t < 60; ++t) {
        const std::vector<double> action = {0.3 * random.Normal() + 0.05, 0.3 * random.Normal()};
        if (stops && t == 2 + episode % 15) guard.Stop();
        verdict = guard.Filter(t, plant.x, action, safe);
        if (verdict.mode == Mode::kHalt) break;
        promised = verdict.certified;
        plant.Apply(safe);
      }
      if (verdict.mode != Mode::kHalt || !promised) continue;
      ++ends;
      EXPECT_FALSE(verdict.alarm) << "episode " << episode << ": " << verdict.reason();
      verdict = guard.Filter(60, plant.x, Action(0.0, 0.0), safe);
      EXPECT_FALSE(verdict.alarm) << "at rest after episode " << episode;
      EXPECT_EQ(verdict.level,
                model.task().guided_support().LogDecision(verdict.alarm_step, plant.x, {}));
    }
    EXPECT_GT(ends, 100);
  }
}

// Explanations use the certificate, which has no gate.
TEST(CertifiedGuardTest, ExplainsWhyAnActionDoesNotPass) {
  const auto model = Model(Strategy::kCertified);
  Guard guard(model);
  core::Random random(5);
  int refused = 0;
  int shallow = 0;
  for (int episode = 0; episode < 10; ++episode) {
    guard.Reset(static_cast<std::uint64_t>(episode));
    CorridorPlant plant;
    std::vector<double> safe(2);
    for (int t = 0; t < 20; ++t) {
      const std::vector<double> action = Action(0.1, 0.05 * random.Normal());
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      if (verdict.mode == Mode::kHalt) break;
      const std::string why = Explain(*model, verdict, plant.x, action);
      EXPECT_EQ(why.empty(), !verdict.changed);
      EXPECT_THAT(why, testing::Not(HasSubstr("passes above")));
      refused += why.find("not certified to end without an alarm: l at step") < why.size() ? 1 : 0;
      shallow += why.find("from which on it passes unchanged") < why.size() ? 1 : 0;
      plant.Apply(safe);
    }
  }
  EXPECT_GT(refused, 0);
  EXPECT_GT(shallow, 0);
}

TEST(CertifiedGuardTest, ExplainsTheViolationOfItsAssumption) {
  const auto model = Model(Strategy::kCertified);
  const double allowed = model->settings().direction_error;
  Guard guard(model);
  guard.Reset(1);
  CorridorPlant plant;
  const std::vector<double> action = Action(test::kSpeed, 0.0);
  std::vector<double> safe(2);
  Verdict verdict = guard.Filter(0, plant.x, action, safe);
  ASSERT_TRUE(verdict.certified);
  EXPECT_TRUE(std::isnan(verdict.observed_error));
  plant.x[1] -= test::kSpeed;
  verdict = guard.Filter(1, plant.x, action, safe);
  EXPECT_EQ(verdict.cause, control::HaltCause::kViolated);
  EXPECT_GT(verdict.observed_error, allowed);
  EXPECT_THAT(Explain(*model, verdict, plant.x, action),
              testing::AllOf(HasSubstr(core::Format("by %.3g per unit", verdict.observed_error)),
                             HasSubstr(core::Format("allows %.3g", allowed))));
  verdict.observed_error = std::numeric_limits<double>::infinity();
  EXPECT_THAT(Explain(*model, verdict, plant.x, action),
              HasSubstr("although the last action was zero"));
}

// The error of the response is known only for demonstrated actions.
TEST(CertifiedGuardTest, ACorrectionStaysWithinDemonstratedActions) {
  const auto model = Model(Strategy::kCertified);
  const std::vector<double> demonstrated = model->actions().Limits(1.0);
  Guard guard(model);
  core::Random random(5);
  int changed = 0;
  for (int episode = 0; episode < 30; ++episode) {
    guard.Reset(static_cast<std::uint64_t>(episode));
    CorridorPlant plant;
    plant.x[2] = 0.1 * random.Normal();
    std::vector<double> safe(2);
    for (int t = 0; t < 20; ++t) {
      const std::vector<double> action = Action(0.1, 0.1 * random.Normal());
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      if (verdict.mode == Mode::kHalt) break;
      changed += verdict.changed ? 1 : 0;
      for (std::size_t i = 0; i < 2; ++i) {
        EXPECT_LE(std::abs(safe[i]), std::max(demonstrated[i], std::abs(action[i])) + 1e-12);
      }
      plant.Apply(safe);
    }
  }
  EXPECT_GT(changed, 50);
}

}  // namespace
}  // namespace dfr::safety
