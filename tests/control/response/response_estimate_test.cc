#include "dfr/control/response/response_estimate.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/random.h"
#include "tests/control/guided/linear_demonstrations.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

using test::Linear;
using test::RandomMatrix;
using test::Simulate;
using test::Store;

constexpr int kN = 3;
constexpr int kM = 2;

// dz = J v, without a drift.
constexpr bool kDrift = false;

TEST(ResponseEstimateTest, RecoversALinearSystemFromDemonstrations) {
  core::Random random(1);
  const core::Matrix truth = RandomMatrix(random, kN, kM);
  const auto d = Linear(truth, 20, 10, random);
  const ResponseEstimate estimate(Store(d, {.ridge = 1e-9}));
  const LocalFit fit = estimate.FitAt(4, core::Row(d.features[3], 4));
  // Products of controls and changes are stored as float, with a relative error of 6e-8.
  EXPECT_TRUE(test::AllClose(fit.jacobian(), truth, 1e-6));
}

// Definition: J minimises ridge |J|^2 + sum of weights |dz - J v|^2.
TEST(ResponseEstimateTest, OnlineDataAreWeightedLeastSquaresWithForgetting) {
  core::Random random(2);
  const auto d = Linear(RandomMatrix(random, kN, kM), 4, 3, random);
  const ResponseOptions options{.prior_weight = 0.0};
  ResponseEstimate estimate(Store(d, options), {}, kDrift);
  const std::vector<double> z(kN, 0.0);
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(kM, kM);
  Eigen::MatrixXd b = Eigen::MatrixXd::Zero(kM, kN);
  LocalFit fit = estimate.FitAt(0, z);
  for (int i = 0; i < 12; ++i) {
    const Eigen::VectorXd v = RandomMatrix(random, kM, 1);
    const Eigen::VectorXd dz = RandomMatrix(random, kN, 1);
    a = options.forgetting * a + v * v.transpose();
    b = options.forgetting * b + v * dz.transpose();
    estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
  }
  a += options.ridge * Eigen::MatrixXd::Identity(kM, kM);
  estimate.FitAt(0, z, fit);
  const Eigen::MatrixXd expected = core::SolveSymmetric(a, b).transpose();
  EXPECT_TRUE(test::AllClose(fit.jacobian(), expected, 1e-12));
}

// A measurement of weight w counts as w equal measurements. A weight of 0 excludes it.
TEST(ResponseEstimateTest, AMeasurementCountsByItsWeight) {
  core::Random random(7);
  const auto d = Linear(RandomMatrix(random, kN, kM), 4, 3, random);
  const auto prior = Store(d);
  const std::vector<double> z(kN, 0.0);
  const Eigen::VectorXd v = RandomMatrix(random, kM, 1);
  const Eigen::VectorXd dz = RandomMatrix(random, kN, 1);
  const auto after = [&](double weight) -> Eigen::MatrixXd {
    ResponseEstimate estimate(prior, {}, kDrift);
    estimate.Update(estimate.FitAt(0, z), z, core::AsSpan(v), core::AsSpan(dz), 0.0, weight);
    return estimate.FitAt(0, z).jacobian();
  };
  // The weight scales neither forgetting nor the prior: the sums are A + w v v', B + w v dz'. The
  // same control times sqrt(w) gives the same sums.
  ResponseEstimate scaled(prior, {}, kDrift);
  const Eigen::VectorXd v2 = std::sqrt(2.5) * v;
  const Eigen::VectorXd dz2 = std::sqrt(2.5) * dz;
  scaled.Update(scaled.FitAt(0, z), core::AsSpan(v2), core::AsSpan(dz2));
  EXPECT_TRUE(test::AllClose(after(2.5), scaled.FitAt(0, z).jacobian(), 1e-12));
  EXPECT_GT((after(2.5) - after(1.0)).norm(), 1e-3);
  const LocalFit untouched = ResponseEstimate(prior, {}, kDrift).FitAt(0, z);
  EXPECT_TRUE(test::AllClose(after(0.0), untouched.jacobian(), 0.0));
  EXPECT_TRUE(after(1.0) != untouched.jacobian());
}

// Demonstrations respond by `first` until time step 10 and then by `second`.
TEST(ResponseEstimateTest, EarlierControlsDoNotHideADemonstratedChangeOfTheResponse) {
  core::Random random(11);
  const core::Matrix first = core::Matrix::Identity(2, 2);
  core::Matrix second = core::Matrix::Zero(2, 2);
  second(0, 0) = 1.0;  // A contact blocks the second direction.
  const auto d = Simulate(
      30, 20, 2, 2, [](int, auto z) { z.setZero(); },
      [&](int t, const auto& z, auto v, auto next) {
        v << random.Normal(), random.Normal();
        next = z + v * (t < 10 ? first : second).transpose();
      });
  ResponseEstimate estimate(Store(d, {.window = 0}), {}, kDrift);
  LocalFit fit = estimate.MakeFit();
  const std::vector<double> z(2, 0.0);
  // In this episode, the plant turns controls by 20 degrees.
  const double angle = 20.0 / 180.0 * std::numbers::pi;
  core::Matrix turn(2, 2);
  turn << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
  for (int t = 0; t < 10; ++t) {
    estimate.FitAt(t, z, fit);
    const Eigen::VectorXd v = std::sqrt(2.0) * Eigen::Vector2d::Unit(t % 2);
    const Eigen::VectorXd dz = first * turn * v;
    estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
  }
  estimate.FitAt(9, z, fit);
  // Ten controls weigh less than the prior's 15: the estimate learns a part of the turn.
  EXPECT_LT((fit.jacobian() - first * turn).norm(), 0.8 * (first - first * turn).norm());
  // Ten free steps do not outweigh the contact that demonstrations contain in the next step.
  estimate.FitAt(10, z, fit);
  EXPECT_LT(std::abs(fit.jacobian()(1, 1)), 0.1);
}

// Demonstrations use the first control entry alone, and only the first feature ever changes. In
// this episode the second entry either changes the second feature by an ordinary amount, or has no
// effect while a sensor adds noise of ten ordinary changes.
TEST(ResponseEstimateTest, LearnsTheEffectOfAnUndemonstratedControlAndNotTheNoiseOfASensor) {
  core::Random random(12);
  const auto d = Simulate(
      10, 20, 2, 2, [](int, auto z) { z.setZero(); },
      [&](int, const auto& z, auto v, auto next) {
        v << (random.Uniform(0.0, 1.0) < 0.5 ? -1.0 : 1.0), 0.0;
        next = z + v;
      });
  const auto prior = Store(d);
  EXPECT_NEAR(prior->mean_square_change(), 1.0, 1e-12);
  const std::vector<double> z(2, 0.0);
  // Returns the estimated effect of the second entry on the second feature after 12 controls.
  const auto learned = [&](double effect, double noise) {
    ResponseEstimate estimate(prior, {}, kDrift);
    LocalFit fit = estimate.FitAt(0, z);
    for (int t = 0; t < 12; ++t) {
      const Eigen::Vector2d v(1.0, t % 2 == 0 ? 0.5 : -0.5);
      const Eigen::Vector2d dz(v[0], effect * v[1] + noise * random.Normal());
      estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
      estimate.FitAt(0, z, fit);
    }
    return fit.jacobian()(1, 1);
  };
  EXPECT_NEAR(learned(2.0, 0.0), 2.0, 0.1);
  // The errors of a response that demonstrations do not determine do not count as noise.
  EXPECT_NEAR(learned(4.0, 0.0), 4.0, 0.2);
  double sum = 0.0;
  for (int i = 0; i < 40; ++i) sum += learned(4.0, 0.5);
  EXPECT_NEAR(sum / 40.0, 4.0, 0.4) << "half an ordinary change of noise";
  double square = 0.0;
  for (int i = 0; i < 40; ++i) square += std::pow(learned(0.0, 10.0), 2);
  // Least squares with the ridge alone has the variance 100 / sum v^2, about 50.
  EXPECT_LT(square / 40.0, 0.1);
}

// After Reset() an estimate equals a new one, bit for bit.
TEST(ResponseEstimateTest, ResetRemovesTheLastEpisode) {
  core::Random random(12);
  const core::Matrix truth = RandomMatrix(random, kN, kM);
  const auto d = Linear(truth, 20, 10, random);
  const auto prior = Store(d);
  const auto z = core::Row(d.features[3], 4);
  const auto elsewhere = core::Row(d.features[5], 9);
  const Eigen::VectorXd v = RandomMatrix(random, kM, 1);
  const Eigen::VectorXd dz = 9.0 * truth * v;  // Counts as noise.
  for (const bool drift : {false, true}) {
    SCOPED_TRACE(drift);
    ResponseEstimate fresh(prior, {}, drift);
    ResponseEstimate used(prior, {}, drift);
    used.Update(used.FitAt(9, elsewhere), core::AsSpan(v), core::AsSpan(dz));
    used.Reset();
    const auto fit_after_a_control = [&](ResponseEstimate& estimate) {
      estimate.Update(estimate.FitAt(4, z), core::AsSpan(v), core::AsSpan(dz));
      return estimate.FitAt(4, z);
    };
    const LocalFit expected = fit_after_a_control(fresh);
    const LocalFit fit = fit_after_a_control(used);
    EXPECT_TRUE(fit.jacobian() == expected.jacobian());
    EXPECT_TRUE(fit.drift() == expected.drift());
  }
}

// A fit keeps its bits after fits at other states and after calls of its functions.
TEST(ResponseEstimateTest, AFitDependsOnMeasurementsAndArgumentsAlone) {
  core::Random random(13);
  const auto d = Linear(RandomMatrix(random, kN, kM), 20, 10, random);
  ResponseEstimate estimate(Store(d), {.base = 0.5});
  LocalFit other = estimate.FitAt(3, core::Row(d.features[2], 3));
  const Eigen::VectorXd dz = RandomMatrix(random, kN, 1);
  estimate.Update(other, core::Row(d.controls[2], 3), core::AsSpan(dz));
  const auto z = core::Row(d.features[3], 4);
  LocalFit once = estimate.FitAt(4, z);
  estimate.FitAt(9, core::Row(d.features[5], 9), other);
  LocalFit twice = estimate.FitAt(4, z);
  EXPECT_TRUE(once.jacobian() == twice.jacobian());
  EXPECT_TRUE(once.drift() == twice.drift());
  Eigen::VectorXd v(kM);
  Eigen::VectorXd direction(kM);
  const double value = once.LeastExcitedDirection(core::AsSpan(direction));
  ASSERT_TRUE(twice.NominalControl(v));
  EXPECT_EQ(twice.LeastExcitedDirection(core::AsSpan(direction)), value);
  EXPECT_TRUE(once.jacobian() == twice.jacobian());
  // Updates with two equal fits have the same effect.
  ResponseEstimate copy = estimate;
  estimate.Update(once, core::AsSpan(v), core::AsSpan(dz));
  copy.Update(twice, core::AsSpan(v), core::AsSpan(dz));
  EXPECT_TRUE(estimate.FitAt(9, z).jacobian() == copy.FitAt(9, z).jacobian());
}

// z' = z + J v + s d. An estimate that attributes the disturbance to the control has a wrong J.
TEST(ResponseEstimateTest, SeparatesADisturbanceFromTheResponseToControls) {
  core::Random random(5);
  const core::Matrix truth = RandomMatrix(random, kN, kM);
  const Eigen::VectorXd disturbance = RandomMatrix(random, kN, 1);
  const DisturbanceModel time{.base = 0.5, .per_control = 1.0};
  const auto d = Linear(truth, 4, 3, random);
  const auto prior = Store(d, {.ridge = 1e-9, .prior_weight = 0.0});
  ResponseEstimate aware_estimate(prior, time, kDrift);
  ResponseEstimate blind_estimate(prior, {}, kDrift);
  const std::vector<double> z(kN, 0.0);
  for (int i = 0; i < 12; ++i) {
    const Eigen::VectorXd v = RandomMatrix(random, kM, 1);
    const Eigen::VectorXd dz = truth * v + time.Duration(v) * disturbance;
    for (ResponseEstimate* estimate : {&aware_estimate, &blind_estimate}) {
      estimate->Update(estimate->FitAt(0, z), core::AsSpan(v), core::AsSpan(dz));
    }
  }
  const LocalFit aware = aware_estimate.FitAt(0, z);
  const LocalFit blind = blind_estimate.FitAt(0, z);
  // The error is the ridge divided by a sum over 12 controls.
  EXPECT_TRUE(test::AllClose(aware.jacobian(), truth, 1e-7));
  EXPECT_TRUE(test::AllClose(aware.disturbance(), disturbance, 1e-7));
  EXPECT_GT((blind.jacobian() - truth).norm(), 0.1);
  EXPECT_TRUE(test::AllClose(blind.disturbance(), Eigen::VectorXd::Zero(kN), 0.0));

  const Eigen::VectorXd v = Eigen::Vector2d(0.3, -0.4);
  Eigen::VectorXd there = Eigen::VectorXd::Ones(kN);
  aware.AddEffect(v, there);
  // |v| = 0.5, so s = 1.
  const Eigen::VectorXd expected = Eigen::VectorXd::Ones(kN) + truth * v + disturbance;
  EXPECT_TRUE(test::AllClose(there, expected, 1e-7));
  aware_estimate.Reset();
  EXPECT_TRUE(
      test::AllClose(aware_estimate.FitAt(0, z).disturbance(), Eigen::VectorXd::Zero(kN), 0.0));
}

// Definition: weighted least squares with forgetting over [z' - z; 1; v], where z is the state of
// the fit.
TEST(ResponseEstimateTest, DriftIsLeastSquaresAboutTheStateOfTheFit) {
  for (const int m : {1, kM}) {
    core::Random random(11);
    const auto d = Linear(RandomMatrix(random, kN, m), 4, 3, random);
    const ResponseOptions options{.prior_weight = 0.0};
    ResponseEstimate estimate(Store(d, options));
    LocalFit fit = estimate.MakeFit();
    const int rows = kN + 1 + m;
    const Eigen::VectorXd here = RandomMatrix(random, kN, 1);
    Eigen::MatrixXd a = Eigen::MatrixXd::Zero(rows, rows);
    Eigen::MatrixXd b = Eigen::MatrixXd::Zero(rows, kN);
    for (int i = 0; i < 30; ++i) {
      const Eigen::VectorXd z = RandomMatrix(random, kN, 1);
      const Eigen::VectorXd v = RandomMatrix(random, m, 1);
      // Larger changes would count as noise and raise the ridge of J.
      const Eigen::VectorXd dz = 0.2 * RandomMatrix(random, kN, 1);
      // At every control the sums are relative to a different state.
      estimate.FitAt(0, core::AsSpan(z), fit);
      estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
      Eigen::VectorXd w(rows);
      w << z - here, 1.0, v;
      a = options.forgetting * a + w * w.transpose();
      b = options.forgetting * b + w * dz.transpose();
    }
    for (Eigen::Index i = 0; i < rows; ++i) {
      a(i, i) += i < kN ? options.slope_ridge : i == kN ? options.drift_ridge : options.ridge;
    }
    const Eigen::MatrixXd expected = core::SolveSymmetric(a, b);
    estimate.FitAt(0, core::AsSpan(here), fit);
    EXPECT_TRUE(test::AllClose(fit.jacobian(), expected.bottomRows(m).transpose(), 1e-12));
    EXPECT_TRUE(test::AllClose(fit.drift(), expected.row(kN).transpose(), 1e-12));
  }
}

// A mass moves by its velocity without a force, but every demonstration has a force. Feedback
// correlates forces with states, so J alone attributes the motion to the forces.
TEST(ResponseEstimateTest, SeparatesTheMotionOfAMassFromTheResponseToForces) {
  core::Random random(12);
  const auto seen = Simulate(
      40, 10, 2, 1, [&](int, auto z) { z << random.Normal(), random.Normal(); },
      [&](int, const auto& z, auto v, auto next) {
        v << -0.6 * z[0] - 1.1 * z[1] + 0.2 * random.Normal();
        next << z[0] + 0.5 * z[1], z[1] + 0.5 * v[0];
      });
  const auto prior = Store(seen, {.ridge = 1e-6, .drift_ridge = 1e-3, .slope_ridge = 1e-2});
  const Eigen::VectorXd z = Eigen::Vector2d(0.4, -0.7);
  const Eigen::VectorXd response = Eigen::Vector2d(0.0, 0.5);
  const LocalFit fit = ResponseEstimate(prior).FitAt(3, core::AsSpan(z));
  EXPECT_TRUE(test::AllClose(fit.jacobian(), response, 0.02));
  EXPECT_TRUE(test::AllClose(fit.drift(), Eigen::Vector2d(0.5 * z[1], 0.0), 0.02));
  Eigen::VectorXd v(1);
  v << 0.3;
  Eigen::VectorXd there = z;
  fit.AddEffect(v, there);
  EXPECT_TRUE(test::AllClose(there, Eigen::Vector2d(z[0] + 0.5 * z[1], z[1] + 0.15), 0.02));
  const LocalFit alone = ResponseEstimate(prior, {}, kDrift).FitAt(3, core::AsSpan(z));
  EXPECT_GT((alone.jacobian() - response).norm(), 0.1);
  EXPECT_TRUE(test::AllClose(alone.drift(), Eigen::Vector2d::Zero(), 0.0));
}

// A robot follows commanded velocities, and its measured velocity is a feature. An operator's
// commands change slowly, so the velocity of the last step nearly determines the next command.
TEST(ResponseEstimateTest, SeparatesAMeasuredVelocityFromTheResponseToItsCommand) {
  core::Random random(13);
  double noise = 0.0;
  const auto seen = Simulate(
      40, 10, 2, 1,
      [&](int, auto z) {
        z << random.Normal(), 0.0;
        noise = random.Normal();
      },
      [&](int, const auto& z, auto v, auto next) {
        noise = 0.8 * noise + 0.6 * random.Normal();
        v << 1.0 + 0.5 * noise;
        next << z[0] + v[0], v[0] / 0.5;
      });
  const auto prior = Store(seen);
  const Eigen::VectorXd z = Eigen::Vector2d(5.0, 2.0);
  const LocalFit fit = ResponseEstimate(prior).FitAt(5, core::AsSpan(z));
  EXPECT_NEAR(fit.jacobian()(0), 1.0, 0.05);
  // The ridges attribute a part of the response to the drift, but never the larger part.
  EXPECT_GT(fit.jacobian()(1), 0.5 * 1.0 / 0.5);
  EXPECT_LE(fit.jacobian()(1), 1.0 / 0.5);
}

// All demonstrations may pause at the same time, or end with padding.
TEST(ResponseEstimateTest, WithoutControlsTheNearestTransitionsInTimeCount) {
  core::Random random(3);
  const auto seen = Simulate(
      10, 40, 1, 1, [](int, auto z) { z.setZero(); },
      [&](int t, const auto& z, auto v, auto next) {
        v << (t < 5 || t == 20 ? random.Normal() : 0.0);
        next = z + 2.0 * v;
      });
  const ResponseEstimate estimate(Store(seen));
  for (const int t : {2, 12, 20, 30, 39, 1000}) {
    EXPECT_NEAR(estimate.FitAt(t, std::vector{0.0}).jacobian()(0), 2.0, 0.1) << t;
  }
}

// In every state, demonstrations of context 0 move by (1, 0). One in three has context 2 and moves
// by (0, 1). The weights are exp(-d^2) with the difference d of contexts.
TEST(ResponseEstimateTest, TheNominalControlIsThatOfDemonstrationsInTheSameContext) {
  core::Random random(3);
  std::vector<core::Matrix> contexts;
  constexpr int kLong = 10;
  bool other = false;
  const auto seen = Simulate(
      30, kLong, 2, kM,
      [&](int d, auto z) {
        other = d % 3 == 0;
        contexts.push_back(core::Matrix::Constant(kLong, 1, other ? 2.0 : 0.0));
        z << random.Normal(), random.Normal();
      },
      [&](int, const auto& z, auto v, auto next) {
        v << (other ? 0.0 : 1.0), (other ? 1.0 : 0.0);
        next = z + 1e-3 * v;
      });
  const ResponseEstimate estimate(std::make_shared<const TransitionStore>(
                                      seen.features, seen.controls, ResponseOptions{}, contexts),
                                  {}, kDrift);
  LocalFit fit = estimate.MakeFit();
  estimate.FitAt(4, std::vector{0.0, 0.0}, fit);
  for (const double context : {0.0, 2.0}) {
    fit.SetContext(std::vector{context});
    estimate.FitAt(4, std::vector{0.0, 0.0}, fit);
    Eigen::VectorXd v(kM);
    ASSERT_TRUE(fit.NominalControl(v));
    const double near = 2.0 * std::exp(-context * context);
    const double far = std::exp(-(2.0 - context) * (2.0 - context));
    EXPECT_NEAR(v[0], near / (near + far), 0.05);
    EXPECT_NEAR(v[1], far / (near + far), 0.05);
    // The fit follows its context, and returns to the same bits with the first context.
    Eigen::VectorXd again(kM);
    fit.SetContext(std::vector{1.0});
    ASSERT_TRUE(fit.NominalControl(again));
    EXPECT_FALSE(again == v);
    fit.SetContext(std::vector{context});
    ASSERT_TRUE(fit.NominalControl(again));
    EXPECT_TRUE(again == v);
  }
  // Contexts with a wrong number of rows or columns are refused.
  contexts[7] = core::Matrix::Zero(kLong - 1, 1);
  EXPECT_THROW(TransitionStore(seen.features, seen.controls, {}, contexts), std::invalid_argument);
  contexts[7] = core::Matrix::Zero(kLong, 2);
  EXPECT_THROW(TransitionStore(seen.features, seen.controls, {}, contexts), std::invalid_argument);
}

TEST(ResponseEstimateTest, DurationsOfADisturbanceAreChecked) {
  core::Random random(6);
  const auto d = Linear(RandomMatrix(random, kN, kM), 4, 3, random);
  const auto prior = Store(d);
  EXPECT_THROW(ResponseEstimate(prior, {.base = -0.1}), std::invalid_argument);
  EXPECT_THROW(ResponseEstimate(prior, {.per_control = std::nan("")}), std::invalid_argument);
  // Either member alone enables the disturbance.
  for (const DisturbanceModel time :
       {DisturbanceModel{.base = 0.5}, DisturbanceModel{.per_control = 0.5}, DisturbanceModel{}}) {
    ResponseEstimate estimate(prior, time, kDrift);
    const std::vector<double> z(kN, 0.0);
    const std::vector<double> v(kM, 1.0);
    const std::vector<double> dz(kN, 1.0);
    estimate.Update(estimate.FitAt(0, z), v, dz);
    EXPECT_EQ(estimate.FitAt(0, z).disturbance().isZero(0.0),
              time.base == 0.0 && time.per_control == 0.0);
  }
}

TEST(ResponseEstimateTest, NothingAllocatesAfterConstruction) {
  core::Random random(5);
  const auto d = Linear(RandomMatrix(random, 12, 7), 20, 10, random);
  ResponseEstimate estimate(Store(d));
  LocalFit fit = estimate.MakeFit();
  const std::vector<double> v(7, 0.5);
  const std::vector<double> z(12, 0.1);
  std::vector<double> direction(7);
  Eigen::VectorXd there = Eigen::VectorXd::Zero(12);
  Eigen::VectorXd control = Eigen::VectorXd::Zero(7);
  const test::NoAlloc guard;
  for (int t = 0; t < 12; ++t) {
    estimate.Update(fit, v, z);
    estimate.FitAt(t, z, fit);
    fit.AddEffect(control, there);
    (void)fit.NominalControl(control);
    (void)fit.LeastExcitedDirection(direction);
  }
}

}  // namespace
}  // namespace dfr::control
