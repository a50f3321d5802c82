#include "dfr/control/response/local_fit.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <span>
#include <utility>
#include <vector>

#include "dfr/control/response/response_estimate.h"
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

constexpr int kEntries = 3;

// Demonstrations apply v = K (z* - z) exactly, and dz = v. In this episode, the plant turns
// controls by .6 rad and a disturbance acts. The control with the demonstrated effect reverses the
// turn and compensates for the disturbance.
TEST(LocalFitTest, TheNominalControlHasTheDemonstratedEffectOnAChangedPlant) {
  core::Random random(5);
  const Eigen::Vector2d goal(0.5, -0.3);
  const auto seen = Simulate(
      40, 10, 2, 2, [&](int, auto z) { z << 3.0 * random.Normal(), 3.0 * random.Normal(); },
      [&](int, const auto& z, auto v, auto next) {
        v = 0.4 * (goal.transpose() - z);
        next = z + v;
      });
  const Eigen::Vector2d here(1.5, 0.4);
  const std::vector<double> z = {here[0], here[1]};
  const Eigen::Vector2d wanted = 0.4 * (goal - here);
  for (const bool measured : {true, false}) {
    SCOPED_TRACE(measured);
    const auto prior = Store(seen, {.measured_changes = measured});
    Eigen::VectorXd v(2);
    const ResponseEstimate still_estimate(prior);
    LocalFit still = still_estimate.FitAt(3, z);
    ASSERT_TRUE(still.NominalControl(v));
    // The ridge of the regression shrinks the control but keeps its direction.
    EXPECT_GT(v.normalized().dot(wanted.normalized()), 0.995);
    EXPECT_NEAR(v.norm() / wanted.norm(), 0.85, 0.1);
    const Eigen::Vector2d regressed = v;
    if (!measured) {
      ASSERT_TRUE(still.DemonstratedControl(v));
      EXPECT_TRUE(test::AllClose(v, regressed, 1e-9)) << "nothing differs from demonstrations";
    }
    still_estimate.FitAt(99, z, still);
    ASSERT_TRUE(still.NominalControl(v)) << "later steps use the last one";

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
    EXPECT_NEAR((turn * Eigen::Vector2d(v) + disturbance - regressed).norm() / regressed.norm(),
                0.0, 0.06);
    const test::NoAlloc guard;
    (void)turned.NominalControl(v);
  }
}

// Demonstrations follow a curve. Far from the curve the slopes of demonstrated controls are
// meaningless, and the nominal control is no larger than demonstrated.
TEST(LocalFitTest, FarFromDemonstrationsTheNominalControlIsNoExtrapolation) {
  core::Random random(8);
  double largest = 0.0;
  const auto seen = Simulate(
      40, 20, 4, 2,
      [&](int, auto z) {
        z << random.Normal(), random.Normal(), 0.5 * random.Normal(), 0.5 * random.Normal();
      },
      [&](int t, const auto& z, auto v, auto next) {
        v << std::cos(0.3 * t) + z[0] - z[2] + 0.2 * random.Normal(),
            std::sin(0.3 * t) + z[1] - z[3] + 0.2 * random.Normal();
        largest = std::max(largest, v.norm());
        next = z;
        next.tail(2) += 0.5 * v;
      });
  const ResponseEstimate estimate(Store(seen));
  LocalFit fit = estimate.MakeFit();
  Eigen::VectorXd v(2);
  double most = 0.0;
  for (int i = 0; i < 200; ++i) {
    const Eigen::VectorXd z = 10.0 * test::RandomMatrix(random, 4, 1).normalized();
    estimate.FitAt(10, core::AsSpan(z), fit);
    ASSERT_TRUE(fit.NominalControl(v));
    most = std::max(most, v.norm());
  }
  EXPECT_LE(most, largest);
}

// No control has an effect: the demonstrated control is returned unchanged.
TEST(LocalFitTest, WithoutAnEffectTheNominalControlIsTheDemonstratedOne) {
  const auto seen = Simulate(
      8, 5, 3, 2, [](int, auto z) { z.setZero(); },
      [](int, const auto& z, auto v, auto next) {
        v.setConstant(0.7);
        next = z;
      });
  const ResponseEstimate estimate(Store(seen));
  LocalFit fit = estimate.FitAt(2, std::vector<double>(3, 0.0));
  ASSERT_TRUE(fit.jacobian().isZero(0.0));
  Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
  ASSERT_TRUE(fit.NominalControl(v));
  EXPECT_TRUE(test::AllClose(v, Eigen::Vector2d(0.7, 0.7), 1e-6));
}

// The first entry always acts. The second entry acts only in contact, which begins at z_0 = 0. Near
// this state demonstrations disagree, and J is a mean of two responses.
TEST(LocalFitTest, DemonstrationsDisagreeOnAnEntryThatActsOnlyInContact) {
  core::Random random(7);
  const auto seen = Simulate(
      40, 10, 2, 2, [&](int, auto z) { z << -2.0 + 0.5 * random.Normal(), 0.5 * random.Normal(); },
      [&](int, const auto& z, auto v, auto next) {
        v << 0.4 + 0.1 * random.Normal(), 0.2 * random.Normal();
        next << z[0] + v[0], z[1] + (z[0] > 0.0 ? v[1] : 0.0);
      });
  const ResponseEstimate estimate(Store(seen));
  LocalFit before = estimate.FitAt(5, std::vector<double>{-0.3, 0.0});
  EXPECT_GT(before.Agreement(0), 0.9);
  EXPECT_LT(before.Agreement(1), 0.6);
  LocalFit far = estimate.FitAt(5, std::vector<double>{8.0, 0.0});
  const test::NoAlloc guard;
  EXPECT_GT(far.Agreement(0), 0.9);
}

// Demonstrations agree exactly on the effect of a control, and the drift is larger.
TEST(LocalFitTest, ADriftIsNoDisagreement) {
  core::Random random(7);
  const auto seen = Simulate(
      30, 10, 1, 1, [&](int, auto z) { z << random.Normal(); },
      [&](int, const auto& z, auto v, auto next) {
        v << 0.3 * random.Normal();
        next = z + v;
        next[0] += 1.0;
      });
  const ResponseEstimate estimate(Store(seen), {}, /*drift=*/true);
  LocalFit fit = estimate.FitAt(5, std::vector{5.0});
  ASSERT_GT(fit.drift()[0], 0.8);
  EXPECT_GT(fit.Agreement(0), 0.8);
}

// A = ridge I + sum of v v'. The sum of the eigenvalues of A^-1 is its trace.
TEST(LocalFitTest, TheSumOfEigenvaluesIsReturnedIfItIsKnownToSuffice) {
  core::Random random(4);
  const ResponseOptions options{.prior_weight = 0.0};
  ResponseEstimate estimate(Store(Linear(RandomMatrix(random, kEntries, 3), 4, 3, random), options),
                            {}, /*drift=*/false);
  const std::vector<double> z(kEntries, 0.0);
  LocalFit fit = estimate.FitAt(0, z);
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(3, 3);
  for (int i = 0; i < 5; ++i) {
    const Eigen::VectorXd v = RandomMatrix(random, 3, 1);
    a = options.forgetting * a + v * v.transpose();
    estimate.Update(fit, core::AsSpan(v), z);
  }
  a.diagonal().array() += options.ridge;
  estimate.FitAt(0, z, fit);
  std::vector<double> direction(3);
  const double trace = a.inverse().trace();
  EXPECT_NEAR(fit.LeastExcitedDirection(direction, 2.0 * trace), trace, 1e-9 * trace);
}

TEST(LocalFitTest, LeastExcitedDirectionIsTheTopEigenvectorOfTheInverse) {
  core::Random random(4);
  // Demonstrations that never use the third entry of the control.
  auto d = Linear(RandomMatrix(random, kEntries, 3), 10, 8, random);
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
  const Eigen::VectorXd dz = Eigen::VectorXd::Zero(kEntries);
  estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
  estimate.FitAt(3, core::Row(d.features[0], 3), fit);
  EXPECT_LT(fit.LeastExcitedDirection(direction), 1.0) << "after it was tried";
}

// Under a disturbance a second equal probe is uninformative. Only the opposite sign separates the
// effect of the probe from the disturbance.
TEST(LocalFitTest, LeastExcitedDirectionHasTheSignThatSeparatesADisturbance) {
  core::Random random(8);
  auto d = Linear(RandomMatrix(random, kEntries, 2), 10, 8, random);
  for (auto& u : d.controls) u.col(1).setZero();
  const auto prior = Store(d);
  const std::vector<double> z(kEntries, 0.0);
  const Eigen::VectorXd dz = Eigen::VectorXd::Ones(kEntries);
  for (const double sign : {1.0, -1.0}) {
    ResponseEstimate estimate(prior, {.base = 1.0, .per_control = 0.5}, /*drift=*/false);
    LocalFit fit = estimate.FitAt(3, z);
    const Eigen::VectorXd probe = Eigen::Vector2d(0.0, sign * 0.5);
    std::vector<double> direction(2);
    for (int i = 0; i < 3; ++i) {
      estimate.Update(fit, core::AsSpan(probe), core::AsSpan(dz));
      estimate.FitAt(3, z, fit);
      EXPECT_GT(fit.LeastExcitedDirection(direction), 10.0) << "the same probe does not help";
      EXPECT_NEAR(direction[1], -sign, 1e-3);
    }
    const Eigen::VectorXd other = -probe;
    estimate.Update(fit, core::AsSpan(other), core::AsSpan(dz));
    estimate.FitAt(3, z, fit);
    EXPECT_LT(fit.LeastExcitedDirection(direction), 5.0);
  }
}

// Eigen's products and factors of large matrices may allocate.
TEST(LocalFitTest, NothingAllocatesUpToTheLargestSizes) {
  for (const auto& [n, m] : {std::pair(140, 7), std::pair(7, 200), std::pair(256, 256)}) {
    SCOPED_TRACE(testing::Message() << n << " features, " << m << " control entries");
    core::Random random(9);
    const core::Matrix jacobian = RandomMatrix(random, n, m);
    const auto prior = Store(Linear(jacobian, 12, 6, random));
    ResponseEstimate estimate(prior, {.base = 1.0}, /*drift=*/true);
    LocalFit fit = estimate.MakeFit();
    const std::vector<double> z(static_cast<std::size_t>(n), 0.1);
    Eigen::VectorXd v = RandomMatrix(random, m, 1);
    const Eigen::VectorXd dz = jacobian * v;
    std::vector<double> direction(static_cast<std::size_t>(m));
    {
      const test::NoAlloc guard;
      estimate.FitAt(3, z, fit);
      estimate.Update(fit, z, core::AsSpan(v), core::AsSpan(dz), 1.0, 20.0);
      estimate.FitAt(3, z, fit);
      EXPECT_TRUE(fit.NominalControl(v));
      EXPECT_GT(fit.LeastExcitedDirection(direction), 0.0);
      EXPECT_GE(fit.Agreement(0), 0.0);
    }
    EXPECT_TRUE(fit.jacobian().allFinite());
    EXPECT_TRUE(v.allFinite());
    EXPECT_NEAR(core::AsVector(std::span<const double>(direction)).norm(), 1.0, 1e-9);
  }
}

}  // namespace
}  // namespace dfr::control
