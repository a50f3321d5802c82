#include "dfr/control/certified/certifier.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/control/phase_tracker.h"
#include "tests/control/analytic.h"
#include "tests/control/known_jacobian.h"
#include "tests/support/message_of.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

constexpr double kUnit = 0.25;
constexpr double kSpeed = 0.3;

// Supports of radius about 0.83 around (0.3 t, 0.15). With two Gaussians, the ball of a certificate
// is only a part of the support.
test::GaussianSupport Moving() { return {{{0.0, 0.0}, {0.0, 0.3}}, 1.0, 0.5, {kSpeed, 0.0}, 12}; }

Eigen::Matrix2d Jacobian() {
  Eigen::Matrix2d j;
  j << 0.8, -0.3, 0.4, 0.6;
  return j;
}

double Deepest(const test::GaussianSupport& support, int phase, std::span<const double> z) {
  double best = -std::numeric_limits<double>::infinity();
  for (int q = phase - PhaseTracker::kWindow; q <= phase + PhaseTracker::kWindow; ++q) {
    if (q >= 0) best = std::max(best, support.LogDecision(q, z, {}));
  }
  return best;
}

class CertifierTest : public testing::Test {
 protected:
  const test::GaussianSupport support = Moving();
  LocalFit fit = test::KnownJacobian(Jacobian());
};

// Brute force: for every allowed error and every true state within the observation error, the
// certified part of the control ends inside some B_q of the window.
TEST_F(CertifierTest, EveryStateThatTheAssumptionAllowsIsInsideSomeSupport) {
  constexpr double kError = 0.3;
  for (const auto& [level, state_error] :
       {std::pair(0.0, 0.0), std::pair(0.1, 0.1), std::pair(-0.1, 0.0)}) {
    SCOPED_TRACE(state_error);
    Certifier certifier({kError, level, state_error}, 2, 2, kUnit);
    core::Random random(1);
    int shrunk = 0;
    for (int i = 0; i < 300; ++i) {
      const int phase = i % 10;
      const std::vector<double> z = {phase * kSpeed + 0.6 * random.Normal(), 0.6 * random.Normal()};
      const Eigen::VectorXd v = 4.0 * Eigen::Vector2d(random.Normal(), random.Normal());
      const double share = certifier.StepFraction({support, fit, z}, phase, v);
      ASSERT_GE(share, 0.0);
      ASSERT_LE(share, 1.0);
      if (share == 0.0) continue;
      shrunk += share > 0.01 && share < 1.0 ? 1 : 0;
      const Eigen::Vector2d centre = Eigen::Vector2d(z[0], z[1]) + share * (Jacobian() * v);
      const double radius = kError * share * v.norm() * kUnit + state_error;
      for (int angle = 0; angle < 32; ++angle) {
        const double a = 2.0 * M_PI * angle / 32.0;
        const std::vector<double> there = {centre[0] + radius * std::cos(a),
                                           centre[1] + radius * std::sin(a)};
        ASSERT_GE(Deepest(support, phase, there), -level - 1e-7);
      }
    }
    EXPECT_GT(shrunk, 60);
  }
}

// The support l = log 2 - |x|^2 is exactly the ball of radius sqrt(log 2). The fraction is
// therefore maximal: a slightly larger one could end outside.
TEST_F(CertifierTest, IsExactForASingleGaussian) {
  const test::GaussianSupport disk({{0.0, 0.0}}, 1.0, 0.5);
  const LocalFit identity = test::KnownJacobian(Eigen::Matrix2d::Identity());
  const std::vector<double> z = {0.5, 0.0};
  const double radius = std::sqrt(std::log(2.0));
  const Eigen::VectorXd outwards = Eigen::Vector2d(3.0, 0.0);
  Certifier certifier({0.4}, 2, 2, kUnit);
  // |J v| + eps |u| = 3 + 0.4 * 3 * 0.25
  EXPECT_NEAR(certifier.StepFraction({disk, identity, z}, 0, outwards), (radius - 0.5) / 3.3, 1e-8);
  // The step leads inwards, through the centre to the far side.
  EXPECT_NEAR(certifier.StepFraction({disk, identity, z}, 0, -outwards), (radius + 0.5) / 3.3,
              1e-8);
}

// The fraction is at least the fraction that the ball at z allows. Larger fractions are 1, 1/2 or
// 1/4, if they provably end inside a ball at the predicted state.
TEST_F(CertifierTest, TheFractionIsTheLargerOfBothBalls) {
  constexpr double kError = 0.3;
  for (const double level : {-0.1, 0.0, 0.4}) {
    Certifier certifier({.direction_error = kError, .level = level}, 2, 2, kUnit);
    core::Random random(2);
    int gained = 0;
    for (int i = 0; i < 600; ++i) {
      const int phase = i % 12;
      const std::vector<double> z = {phase * kSpeed + random.Normal(), 0.5 * random.Normal()};
      const Eigen::VectorXd v = 3.0 * Eigen::Vector2d(random.Normal(), random.Normal());
      const Eigen::VectorXd effect = fit.jacobian() * v;
      double by_ball = 0.0;
      std::vector<double> shift(2);
      const auto ends_inside = [&](double share, int first, int last) {
        const double error = kError * share * v.norm() * kUnit;
        const Eigen::Vector2d there = core::AsVector(std::span<const double>(z)) + share * effect;
        for (int q = std::max(0, first); q <= last; ++q) {
          const SafeBall ball = ComputeSafeBall(support, q, core::AsSpan(there), shift, level);
          if (ball.radius - ball.shift_norm >= error + 1e-9) return true;
        }
        return false;
      };
      for (int q = std::max(0, phase - 3); q <= phase + 3; ++q) {
        const SafeBall ball = ComputeSafeBall(support, q, z, shift, level);
        by_ball = std::max(
            by_ball, LargestShare(ball, shift, core::AsSpan(effect), kError * v.norm() * kUnit));
      }
      double expected = by_ball;
      for (const double share : {0.25, 0.5, 1.0}) {
        const bool whole = share == 1.0;
        if (share > expected &&
            ends_inside(share, whole ? phase - 3 : phase + 1, whole ? phase + 3 : phase + 1)) {
          expected = share;
        }
      }
      gained += expected > by_ball + 0.05 ? 1 : 0;
      ASSERT_NEAR(certifier.StepFraction({support, fit, z}, phase, v), expected, 1e-9) << i;
    }
    EXPECT_GT(gained, 20) << "the ball at the predicted state must help";
  }
}

// The level returned by Predict() suffices, and Predict() finds a phase if inequality (2) of
// docs/certificates.md holds for any phase.
TEST_F(CertifierTest, PredictReturnsTheRequiredLevel) {
  const Certificate certificate{.direction_error = 0.4, .level = 0.2, .state_error = 0.05};
  Certifier certifier(certificate, 2, 2, kUnit);
  core::Random random(4);
  int met = 0;
  for (int i = 0; i < 500; ++i) {
    const int phase = i % 9;
    const std::vector<double> z = {phase * kSpeed + 0.5 * random.Normal(), 0.5 * random.Normal()};
    const Eigen::VectorXd v = 2.0 * Eigen::Vector2d(random.Normal(), random.Normal());
    const LocalModel local{support, fit, z};
    const Certifier::RequiredLevel need = certifier.Predict(local, phase, v);
    EXPECT_EQ(need.met(), local.Level(need.phase, v) >= need.level + 1e-12);
    EXPECT_LE(std::abs(need.phase - phase), PhaseTracker::kWindow);
    const double radius = 0.4 * v.norm() * kUnit + 0.05;
    const Eigen::Vector2d centre = core::AsVector(std::span<const double>(z)) + Jacobian() * v;
    double most = -std::numeric_limits<double>::infinity();
    Eigen::VectorXd slope(2);
    for (int q = std::max(0, phase - 3); q <= phase + 3; ++q) {
      const double l = support.LogDecision(q, core::AsSpan(centre), core::AsSpan(slope));
      const double needed =
          slope.norm() * radius + support.curvature_bound(q) * radius * radius - 0.2;
      most = std::max(most, l - needed);
    }
    ASSERT_EQ(need.met(), most >= 1e-12) << i << ", by " << most;
    if (!need.met()) {
      EXPECT_NEAR(need.missing, -most, 1e-6) << i;
      continue;
    }
    ++met;
    for (int angle = 0; angle < 64; ++angle) {
      const double a = 2.0 * M_PI * angle / 64.0;
      const std::vector<double> there = {centre[0] + radius * std::cos(a),
                                         centre[1] + radius * std::sin(a)};
      ASSERT_GE(support.LogDecision(need.phase, there, {}), -0.2 - 1e-12);
    }
  }
  EXPECT_GT(met, 50);
  EXPECT_LT(met, 450);
}

TEST_F(CertifierTest, SearchesOnlyTheWindow) {
  // Disks of radius 0.83 around (2 t, 0): they do not overlap.
  const test::GaussianSupport disks({{0.0, 0.0}}, 1.0, 0.5, {2.0, 0.0}, 12);
  const LocalFit identity = test::KnownJacobian(Eigen::Matrix2d::Identity());
  const std::vector<double> z = {12.0, 0.0};  // in B_6
  const Eigen::VectorXd v = Eigen::Vector2d(0.1, 0.0);
  Certifier certifier({0.5}, 2, 2, kUnit);
  for (int phase = 0; phase < 12; ++phase) {
    EXPECT_EQ(certifier.StepFraction({disks, identity, z}, phase, v),
              std::abs(phase - 6) <= 3 ? 1 : 0)
        << phase;
  }
}

TEST_F(CertifierTest, NothingPassesOutsideAndAZeroControlPassesInside) {
  const std::vector<double> outside = {0.0, 5.0};
  const std::vector<double> inside = {0.0, 0.0};
  Certifier certifier({1.0}, 2, 2, kUnit);
  EXPECT_EQ(certifier.StepFraction({support, fit, outside}, 0, Eigen::VectorXd::Ones(2)), 0.0);
  EXPECT_EQ(certifier.StepFraction({support, fit, inside}, 0, Eigen::VectorXd::Zero(2)), 1.0);
}

TEST_F(CertifierTest, FindsViolationsOfTheAssumption) {
  const Eigen::VectorXd v = Eigen::Vector2d(0.0, 2.0);  // |u| = 0.5
  const Eigen::VectorXd effect = Eigen::Vector2d(1.0, 0.0);
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(2);
  Certifier certifier({0.4}, 2, 2, kUnit);
  // |dz - J v| <= 0.4 * 0.5
  EXPECT_FALSE(certifier.FindViolation(v, effect, Eigen::Vector2d(1.0, 0.2)));
  EXPECT_FALSE(certifier.FindViolation(v, effect, Eigen::Vector2d(0.8, 0.0)));
  EXPECT_NEAR(certifier.FindViolation(v, effect, Eigen::Vector2d(0.7, 0.0)).value_or(0.0), 0.6,
              1e-12);
  EXPECT_TRUE(certifier.FindViolation(v, effect, Eigen::VectorXd::Constant(2, std::nan(""))));
  EXPECT_FALSE(certifier.FindViolation(zero, zero, zero));
  const auto moved = certifier.FindViolation(zero, zero, Eigen::Vector2d(0.1, 0.0));
  EXPECT_TRUE(std::isinf(moved.value_or(0.0))) << "it moved without a control";
}

// The admitted part of a control ends inside a nearby support for every outcome that the assumption
// allows.
TEST_F(CertifierTest, AdmittedControlsAreCertified) {
  Certifier certifier({0.3}, 2, 2, kUnit);
  core::Random random(1);
  int whole = 0;
  int shrunk = 0;
  int climbs = 0;
  for (int i = 0; i < 1000; ++i) {
    const int phase = i % 10;
    const std::vector<double> z = {phase * kSpeed + 0.6 * random.Normal(), 0.6 * random.Normal()};
    if (support.LogDecision(phase, z, {}) < 0.0) continue;
    const LocalModel model{support, fit, z};
    const Eigen::VectorXd chosen =
        (4.0 * Eigen::Vector2d(random.Normal(), random.Normal())).cwiseMax(-5.0).cwiseMin(5.0);
    Eigen::VectorXd v = chosen;
    certifier.Reset();
    const auto admission =
        certifier.Admit(model, fit, {.control = Eigen::VectorXd::Constant(v.size(), 5.0)},
                        {phase, Mode::kPolicy}, v);
    ASSERT_TRUE(admission.any);
    ASSERT_LE(v.cwiseAbs().maxCoeff(), 5.0);
    ASSERT_GE(certifier.StepFraction(model, phase, v), 1.0 - 1e-8);
    if (!admission.gets_on) {
      ++climbs;
      ASSERT_EQ(admission.mode, Mode::kRecovery);
      ASSERT_GE(model.Level(phase, v), support.LogDecision(phase, z, {}));
    } else {
      // Only learned controls are reduced.
      ASSERT_TRUE(admission.mode == Mode::kPolicy || admission.share == 1.0);
      ++(admission.share < 1.0 ? shrunk : whole);
      // Changed controls end inside the next support.
      if (v != chosen) {
        ASSERT_GE(model.Level(phase + 1, v), 0.0);
      }
    }
  }
  EXPECT_GT(whole, 10);
  // Most controls are corrected until they pass without being shrunk.
  EXPECT_LE(shrunk, 100);
  EXPECT_LE(climbs, 1);
}

// Entry 0 has the values -2 and 1. It is neither raised nor shrunk, even in a probe. Without a
// learned control it is 0.
TEST_F(CertifierTest, AnEntryWithFewValuesKeepsThem) {
  Certifier certifier({0.3}, 2, 2, kUnit);
  core::Random random(1);
  int shrunk = 0;
  int nominal = 0;
  int probes = 0;
  for (int i = 0; i < 1000; ++i) {
    const int phase = i % 10;
    const std::vector<double> z = {phase * kSpeed + 0.6 * random.Normal(), 0.6 * random.Normal()};
    if (support.LogDecision(phase, z, {}) < 0.0) continue;
    const LocalModel model{support, fit, z};
    const double value = random.Uniform() < 0.5 ? -2.0 : 1.0;
    const bool demonstrated = random.Uniform() < 0.5;
    const Eigen::VectorXd chosen = Eigen::Vector2d(value, 3.0 * random.Normal());
    for (const Mode mode : {Mode::kPolicy, Mode::kProbe}) {
      Eigen::VectorXd v = chosen;
      certifier.Reset();
      const auto admission = certifier.Admit(model, fit, {.values = {{-2.0, 1.0}, {}}},
                                             {phase, mode, demonstrated}, v);
      if (admission.demonstrated) {
        ASSERT_TRUE(v[0] == -2.0 || v[0] == 1.0) << v[0];
      } else {
        ASSERT_EQ(v[0], admission.gets_on || admission.mode == Mode::kProbe ? value : 0.0);
      }
      ASSERT_GE(certifier.StepFraction(model, phase, v), 1.0 - 1e-8);
      shrunk += admission.gets_on && admission.share < 1.0 ? 1 : 0;
      nominal += admission.demonstrated ? 1 : 0;
      probes += admission.mode == Mode::kProbe && admission.share < 1.0 ? 1 : 0;
    }
  }
  EXPECT_GT(shrunk, 10);
  EXPECT_GT(nominal, 10);
  EXPECT_GT(probes, 10);
}

TEST_F(CertifierTest, FollowsDemonstrationsOnlyOnRequest) {
  Certifier certifier({0.3}, 2, 2, kUnit);
  core::Random random(1);
  int followed = 0;
  for (int i = 0; i < 1000; ++i) {
    const int phase = i % 10;
    const std::vector<double> z = {phase * kSpeed + 0.6 * random.Normal(), 0.6 * random.Normal()};
    if (support.LogDecision(phase, z, {}) < 0.0) continue;
    const LocalModel model{support, fit, z};
    const Eigen::VectorXd chosen = Eigen::Vector2d(5.0 * random.Normal(), 5.0 * random.Normal());
    for (const bool demonstrated : {true, false}) {
      Eigen::VectorXd v = chosen;
      certifier.Reset();
      const auto admission =
          certifier.Admit(model, fit, {.control = Eigen::VectorXd::Constant(v.size(), 5.0)},
                          {phase, Mode::kPolicy, demonstrated}, v);
      ASSERT_TRUE(demonstrated || !admission.demonstrated);
      followed += admission.demonstrated ? 1 : 0;
    }
  }
  EXPECT_GT(followed, 0);
}

TEST_F(CertifierTest, StopsAfterThreeConsecutiveStalls) {
  // At this peak no step raises l, and every control leaves the ball.
  const test::GaussianSupport peak({{0.0, 0.0}}, 1.0, 1.0);
  const std::vector<double> z = {0.0, 0.0};
  Certifier certifier({1.0}, 2, 2, kUnit);
  const auto admit = [&] {
    Eigen::VectorXd v = Eigen::Vector2d(1.0, 0.0);
    return certifier.Admit({peak, fit, z}, fit, {}, {0, Mode::kPolicy}, v).any;
  };
  EXPECT_TRUE(admit());
  EXPECT_TRUE(admit());
  EXPECT_FALSE(admit());
  certifier.Reset();
  EXPECT_TRUE(admit()) << "another episode";
}

TEST_F(CertifierTest, AZeroControlThatPassesIsNoStall) {
  const std::vector<double> z = {0.0, 0.0};
  Certifier certifier({1.0}, 2, 2, kUnit);
  for (int i = 0; i < 10; ++i) {
    Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
    const auto admitted = certifier.Admit({support, fit, z}, fit, {}, {0, Mode::kPolicy}, v);
    EXPECT_TRUE(admitted.any) << i;
    EXPECT_EQ(admitted.mode, Mode::kPolicy);
    EXPECT_TRUE(v.isZero(0.0));
  }
}

TEST_F(CertifierTest, ErrorsNameTheConstant) {
  const auto message = [](const Certificate& certificate) {
    return test::MessageOf<std::invalid_argument>(
        [&] { const Certifier certifier(certificate, 2, 2, kUnit); });
  };
  for (const double bad : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(message({bad}), HasSubstr("a certificate needs an eps"));
  }
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(message({1.0, bad}), HasSubstr("level"));
    EXPECT_THAT(message({1.0, 0.0, bad}), HasSubstr("state error"));
  }
  EXPECT_THAT(message({1.0, 0.0, -1.0}), HasSubstr("state error"));
}

}  // namespace
}  // namespace dfr::control
