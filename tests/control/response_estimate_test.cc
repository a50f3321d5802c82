#include "dfr/control/guided/response_estimate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <memory>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

constexpr int kN = 3;
constexpr int kM = 2;

// dz = J v.
constexpr bool kDrift = false;

core::Matrix RandomMatrix(core::Random& random, int rows, int cols) {
  core::Matrix m(rows, cols);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = random.Normal();
  return m;
}

struct Demonstrations {
  std::vector<core::Matrix> features;
  std::vector<core::Matrix> controls;
};

// z' = z + J u exactly.
Demonstrations Linear(const core::Matrix& jacobian, int count, int length, core::Random& random) {
  Demonstrations demonstrations;
  for (int d = 0; d < count; ++d) {
    core::Matrix u = RandomMatrix(random, length, static_cast<int>(jacobian.cols()));
    core::Matrix z(length + 1, jacobian.rows());
    z.row(0).setZero();
    for (int t = 0; t < length; ++t) z.row(t + 1) = z.row(t) + u.row(t) * jacobian.transpose();
    demonstrations.features.push_back(z);
    demonstrations.controls.push_back(u);
  }
  return demonstrations;
}

std::shared_ptr<const TransitionStore> Store(const Demonstrations& d,
                                             const ResponseOptions& options = {}) {
  return std::make_shared<const TransitionStore>(d.features, d.controls, options);
}

TEST(ResponseEstimateTest, RecoversALinearSystemFromDemonstrations) {
  core::Random random(1);
  const core::Matrix truth = RandomMatrix(random, kN, kM);
  const auto d = Linear(truth, 20, 10, random);
  const ResponseEstimate estimate(Store(d, {.ridge = 1e-9}));
  const LocalFit fit = estimate.FitAt(4, core::Row(d.features[3], 4));
  // Products of controls and changes are kept in float, of relative error 6e-8.
  EXPECT_TRUE(test::AllClose(fit.jacobian(), truth, 1e-6));
}

// The definition: J minimises ridge |J|^2 + sum of weights |dz - J v|^2.
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
  const Eigen::MatrixXd expected = a.ldlt().solve(b).transpose();
  EXPECT_TRUE(test::AllClose(fit.jacobian(), expected, 1e-12));
  estimate.Reset();
  estimate.FitAt(0, z, fit);
  EXPECT_TRUE(test::AllClose(fit.jacobian(), Eigen::MatrixXd::Zero(kN, kM), 0.0));
}

// A measurement of weight w counts as w equal ones; of weight 0, not at all.
TEST(ResponseEstimateTest, AMeasurementCountsAsOftenAsItsWeightSays) {
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
  // Neither forgetting nor the prior's own weight scale with it: the sums are
  // A + w v v', B + w v dz', which the same control, sqrt(w) as large, gives as well.
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

// Demonstrations that respond by `first` until time step 10 and by `second` from then on.
TEST(ResponseEstimateTest, ADemonstratedChangeOfTheResponseIsNoCorrection) {
  core::Random random(11);
  const core::Matrix first = core::Matrix::Identity(2, 2);
  core::Matrix second = core::Matrix::Zero(2, 2);
  second(0, 0) = 1.0;  // A contact blocks the second direction.
  Demonstrations d;
  for (int i = 0; i < 30; ++i) {
    core::Matrix u = RandomMatrix(random, 20, 2);
    core::Matrix z = core::Matrix::Zero(21, 2);
    for (int t = 0; t < 20; ++t) {
      z.row(t + 1) = z.row(t) + u.row(t) * (t < 10 ? first : second).transpose();
    }
    d.features.push_back(z);
    d.controls.push_back(u);
  }
  ResponseEstimate estimate(Store(d, {.window = 0}), {}, kDrift);
  LocalFit fit = estimate.MakeFit();
  const std::vector<double> z(2, 0.0);
  // This plant turns controls by 20 degrees, before and after the contact.
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
  // Ten controls weigh less than the prior's 15: a part of the turn is learned.
  EXPECT_LT((fit.jacobian() - first * turn).norm(), 0.8 * (first - first * turn).norm());
  // Ten free steps do not outvote the contact that demonstrations show for the next one.
  estimate.FitAt(10, z, fit);
  EXPECT_LT(std::abs(fit.jacobian()(1, 1)), 0.1);
}

// Reset() leaves the state of a new estimate, to the last bit.
TEST(ResponseEstimateTest, ResetRemovesTheLastEpisode) {
  core::Random random(12);
  const core::Matrix truth = RandomMatrix(random, kN, kM);
  const auto d = Linear(truth, 20, 10, random);
  const auto prior = Store(d);
  const auto z = core::Row(d.features[3], 4);
  const auto elsewhere = core::Row(d.features[5], 9);
  const Eigen::VectorXd v = RandomMatrix(random, kM, 1);
  const Eigen::VectorXd dz = 2.0 * truth * v;
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

// To the last bit: neither fits elsewhere nor calls of the fit itself change a fit.
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
  // The measurement of a control counts for every fit that it was predicted by.
  ResponseEstimate copy = estimate;
  estimate.Update(once, core::AsSpan(v), core::AsSpan(dz));
  copy.Update(twice, core::AsSpan(v), core::AsSpan(dz));
  EXPECT_TRUE(estimate.FitAt(9, z).jacobian() == copy.FitAt(9, z).jacobian());
}

// z' = z + J v + s d: an estimate that takes the disturbance for a response to the control has a
// wrong J.
TEST(ResponseEstimateTest, TellsADisturbanceFromTheAnswerToControls) {
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
  EXPECT_TRUE(test::AllClose(aware.jacobian(), truth, 1e-7));  // ridge against 12 controls
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

// By the definition: weighted least squares with forgetting over [z' - z; 1; v], where z is the
// last state.
TEST(ResponseEstimateTest, DriftIsLeastSquaresAboutTheStateThatIsAskedAbout) {
  core::Random random(11);
  const auto d = Linear(RandomMatrix(random, kN, kM), 4, 3, random);
  const ResponseOptions options{.prior_weight = 0.0};
  ResponseEstimate estimate(Store(d, options));
  LocalFit fit = estimate.MakeFit();
  constexpr int kRows = kN + 1 + kM;
  const Eigen::VectorXd here = RandomMatrix(random, kN, 1);
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(kRows, kRows);
  Eigen::MatrixXd b = Eigen::MatrixXd::Zero(kRows, kN);
  for (int i = 0; i < 30; ++i) {
    const Eigen::VectorXd z = RandomMatrix(random, kN, 1);
    const Eigen::VectorXd v = RandomMatrix(random, kM, 1);
    const Eigen::VectorXd dz = RandomMatrix(random, kN, 1);
    // Sums are about another state at every control.
    estimate.FitAt(0, core::AsSpan(z), fit);
    estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
    Eigen::VectorXd w(kRows);
    w << z - here, 1.0, v;
    a = options.forgetting * a + w * w.transpose();
    b = options.forgetting * b + w * dz.transpose();
  }
  for (Eigen::Index i = 0; i < kRows; ++i) {
    a(i, i) += i < kN ? options.slope_ridge : i == kN ? options.drift_ridge : options.ridge;
  }
  const Eigen::MatrixXd expected = a.ldlt().solve(b);
  estimate.FitAt(0, core::AsSpan(here), fit);
  EXPECT_TRUE(test::AllClose(fit.jacobian(), expected.bottomRows(kM).transpose(), 1e-12));
  EXPECT_TRUE(test::AllClose(fit.drift(), expected.row(kN).transpose(), 1e-12));
}

// A mass moves by its velocity without a force, but every demonstration has a force. Feedback
// correlates forces with states, so J alone attributes the motion to the forces.
TEST(ResponseEstimateTest, TellsTheMotionOfAMassFromTheAnswerToForces) {
  core::Random random(12);
  std::vector<core::Matrix> features;
  std::vector<core::Matrix> controls;
  for (int d = 0; d < 40; ++d) {
    core::Matrix z(11, 2);
    core::Matrix v(10, 1);
    z.row(0) << random.Normal(), random.Normal();
    for (Eigen::Index t = 0; t < 10; ++t) {
      v(t, 0) = -0.6 * z(t, 0) - 1.1 * z(t, 1) + 0.2 * random.Normal();
      z(t + 1, 0) = z(t, 0) + 0.5 * z(t, 1);
      z(t + 1, 1) = z(t, 1) + 0.5 * v(t, 0);
    }
    features.push_back(z);
    controls.push_back(v);
  }
  const auto prior = std::make_shared<const TransitionStore>(
      features, controls, ResponseOptions{.ridge = 1e-6, .drift_ridge = 1e-3, .slope_ridge = 1e-2});
  const Eigen::VectorXd z = Eigen::Vector2d(0.4, -0.7);
  const Eigen::VectorXd answer = Eigen::Vector2d(0.0, 0.5);
  const LocalFit fit = ResponseEstimate(prior).FitAt(3, core::AsSpan(z));
  EXPECT_TRUE(test::AllClose(fit.jacobian(), answer, 0.02));
  EXPECT_TRUE(test::AllClose(fit.drift(), Eigen::Vector2d(0.5 * z[1], 0.0), 0.02));
  Eigen::VectorXd v(1);
  v << 0.3;
  Eigen::VectorXd there = z;
  fit.AddEffect(v, there);
  EXPECT_TRUE(test::AllClose(there, Eigen::Vector2d(z[0] + 0.5 * z[1], z[1] + 0.15), 0.02));
  const LocalFit alone = ResponseEstimate(prior, {}, kDrift).FitAt(3, core::AsSpan(z));
  EXPECT_GT((alone.jacobian() - answer).norm(), 0.1);
  EXPECT_TRUE(test::AllClose(alone.drift(), Eigen::Vector2d::Zero(), 0.0));
}

TEST(ResponseEstimateTest, DriftTimesAreChecked) {
  core::Random random(6);
  const auto d = Linear(RandomMatrix(random, kN, kM), 4, 3, random);
  const auto prior = Store(d);
  EXPECT_THROW(ResponseEstimate(prior, {.base = -0.1}), std::invalid_argument);
  EXPECT_THROW(ResponseEstimate(prior, {.per_control = std::nan("")}), std::invalid_argument);
  // Either of them alone is a disturbance.
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

// Demonstrations take v = K (z* - z) exactly, dz = v. The plant turns controls by .6 and the world
// drifts: the control with the demonstrated effect is the one turned back, minus the disturbance.
TEST(ResponseEstimateTest, DoesWhatDemonstrationsDidWhateverControlsDoToday) {
  core::Random random(5);
  const Eigen::Vector2d goal(0.5, -0.3);
  std::vector<core::Matrix> features;
  std::vector<core::Matrix> controls;
  for (int d = 0; d < 40; ++d) {
    core::Matrix z(11, 2);
    core::Matrix v(10, 2);
    z.row(0) << 3.0 * random.Normal(), 3.0 * random.Normal();
    for (Eigen::Index t = 0; t < 10; ++t) {
      v.row(t) = 0.4 * (goal.transpose() - z.row(t));
      z.row(t + 1) = z.row(t) + v.row(t);
    }
    features.push_back(z);
    controls.push_back(v);
  }
  const auto prior = std::make_shared<const TransitionStore>(features, controls, ResponseOptions{});
  const Eigen::Vector2d here(1.5, 0.4);
  const std::vector<double> z = {here[0], here[1]};
  const Eigen::Vector2d wanted = 0.4 * (goal - here);
  Eigen::VectorXd v(2);

  const ResponseEstimate still_estimate(prior);
  LocalFit still = still_estimate.FitAt(3, z);
  ASSERT_TRUE(still.NominalControl(v));
  // Shrunk by the ridge of the regression, in the same direction.
  EXPECT_GT(v.normalized().dot(wanted.normalized()), 0.995);
  EXPECT_NEAR(v.norm() / wanted.norm(), 0.85, 0.1);
  const Eigen::Vector2d regressed = v;
  still_estimate.FitAt(99, z, still);
  ASSERT_TRUE(still.NominalControl(v)) << "beyond the last, the last demonstrated control";

  const Eigen::Rotation2Dd turn(0.6);
  const Eigen::Vector2d disturbance(0.05, 0.1);
  ResponseEstimate estimate(prior, {.base = 1.0});
  LocalFit turned = estimate.FitAt(3, z);
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector2d tried(random.Normal(), random.Normal());
    const Eigen::Vector2d moved = turn * tried + disturbance;
    estimate.Update(turned, z, core::AsSpan(Eigen::VectorXd(tried)),
                    core::AsSpan(Eigen::VectorXd(moved)), 1.0, 20.0);
  }
  estimate.FitAt(3, z, turned);
  ASSERT_TRUE(turned.NominalControl(v));
  EXPECT_NEAR((turn * Eigen::Vector2d(v) + disturbance - regressed).norm() / regressed.norm(), 0.0,
              0.06);
  const test::NoAlloc guard;
  (void)turned.NominalControl(v);
}

// No control causes a change: the demonstrated control is returned unchanged.
TEST(ResponseEstimateTest, WithoutAnEffectTheNominalControlIsTheDemonstratedOne) {
  const std::vector<core::Matrix> features(8, core::Matrix::Zero(6, 3));
  const std::vector<core::Matrix> controls(8, core::Matrix::Constant(5, 2, 0.7));
  const ResponseEstimate estimate(
      std::make_shared<const TransitionStore>(features, controls, ResponseOptions{}));
  LocalFit fit = estimate.FitAt(2, std::vector<double>(3, 0.0));
  ASSERT_TRUE(fit.jacobian().isZero(0.0));
  Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
  ASSERT_TRUE(fit.NominalControl(v));
  EXPECT_TRUE(test::AllClose(v, Eigen::Vector2d(0.7, 0.7), 1e-6));
}

TEST(ResponseEstimateTest, LeastKnownIsTheTopEigenvectorOfTheInverse) {
  core::Random random(4);
  // Demonstrations that never use the third control.
  auto d = Linear(RandomMatrix(random, kN, 3), 10, 8, random);
  for (auto& u : d.controls) u.col(2).setZero();
  ResponseEstimate estimate(Store(d));
  LocalFit fit = estimate.FitAt(3, core::Row(d.features[0], 3));
  std::vector<double> direction(3);
  const double value = fit.LeastExcitedDirection(direction);
  EXPECT_NEAR(value, 1.0 / ResponseOptions{}.ridge, 1e-6);
  EXPECT_NEAR(std::abs(direction[2]), 1.0, 1e-6);
  std::vector<double> untouched = {7.0, 7.0, 7.0};
  EXPECT_GE(fit.LeastExcitedDirection(untouched, 1e9), value);
  EXPECT_EQ(untouched[0], 7.0);
  const Eigen::VectorXd v = Eigen::Vector3d(0, 0, 2);
  const Eigen::VectorXd dz = Eigen::VectorXd::Zero(kN);
  estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
  estimate.FitAt(3, core::Row(d.features[0], 3), fit);
  EXPECT_LT(fit.LeastExcitedDirection(direction), 1.0) << "after it was tried";
}

// Under a disturbance a second equal probe is uninformative: only the other sign separates its
// effect from the disturbance.
TEST(ResponseEstimateTest, LeastExcitedDirectionHasTheSignThatSeparatesADisturbance) {
  core::Random random(8);
  auto d = Linear(RandomMatrix(random, kN, 2), 10, 8, random);
  for (auto& u : d.controls) u.col(1).setZero();
  const auto prior = Store(d);
  const std::vector<double> z(kN, 0.0);
  const Eigen::VectorXd dz = Eigen::VectorXd::Ones(kN);
  for (const double sign : {1.0, -1.0}) {
    ResponseEstimate estimate(prior, {.base = 1.0, .per_control = 0.5}, kDrift);
    LocalFit fit = estimate.FitAt(3, z);
    const Eigen::VectorXd probe = Eigen::Vector2d(0.0, sign * 0.5);
    std::vector<double> direction(2);
    for (int i = 0; i < 3; ++i) {
      estimate.Update(fit, core::AsSpan(probe), core::AsSpan(dz));
      estimate.FitAt(3, z, fit);
      EXPECT_GT(fit.LeastExcitedDirection(direction), 10.0)
          << "as unknown as before, however often";
      EXPECT_NEAR(direction[1], -sign, 1e-3);
    }
    const Eigen::VectorXd other = -probe;
    estimate.Update(fit, core::AsSpan(other), core::AsSpan(dz));
    estimate.FitAt(3, z, fit);
    EXPECT_LT(fit.LeastExcitedDirection(direction), 5.0);
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
