#include "dfr/kernel/cover_radius.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"

namespace dfr::kernel {
namespace {

double DistanceToSamples(const OneClassSvm& svm, const std::vector<double>& x) {
  double nearest = std::numeric_limits<double>::infinity();
  for (Eigen::Index i = 0; i < svm.num_support_vectors(); ++i) {
    nearest = std::min(nearest, (svm.support_vectors().row(i).transpose() -
                                 core::AsVector(std::span<const double>(x)))
                                    .norm());
  }
  return nearest;
}

// Finds the largest distance by brute force, on a lattice that reaches beyond the radius.
TEST(CoverRadiusTest, NoStateAtTheLevelIsFartherFromAllSamples) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    core::Random random(seed);
    core::Matrix samples(40, 2);
    for (double& entry : samples.reshaped()) entry = (seed % 2 == 0 ? 3.0 : 1.0) * random.Normal();
    const auto svm =
        OneClassSvm::Fit(samples, {.nu = 0.1, .gamma = seed < 3 ? 0.3 : 1.5, .tolerance = 1e-6});
    for (const double level : {-0.1, 0.0, 0.5, 2.0}) {
      const double radius = CoverRadius(svm, level);
      const double plain = std::sqrt((level - std::log(svm.rho())) / svm.gamma());
      EXPECT_LE(radius, plain * (1.0 + 1e-12));
      double furthest = 0.0;
      const double reach = samples.cwiseAbs().maxCoeff() + plain;
      for (int i = -40; i <= 40; ++i) {
        for (int j = -40; j <= 40; ++j) {
          const std::vector<double> there = {i / 40.0 * reach, j / 40.0 * reach};
          if (svm.LogDecision(there) < -level) continue;
          furthest = std::max(furthest, DistanceToSamples(svm, there));
        }
      }
      EXPECT_LE(furthest, radius) << "seed " << seed << ", level " << level;
      EXPECT_GT(radius, 0.0);
    }
  }
}

// Identical samples form one kernel, whose support is a ball of radius sqrt((level - log rho) /
// gamma).
TEST(CoverRadiusTest, IsAttainedByASingleKernel) {
  const core::Matrix samples = core::Matrix::Constant(10, 3, 0.7);
  const auto svm = OneClassSvm::Fit(samples, {.nu = 0.5, .gamma = 2.0});
  for (const double level : {0.5, 1.0, 3.0}) {
    // rho = 1 up to rounding
    EXPECT_NEAR(CoverRadius(svm, level), std::sqrt((level - std::log(svm.rho())) / 2.0), 1e-6);
  }
  EXPECT_EQ(CoverRadius(svm, -1.0), 0.0) << "nothing is that deep inside";
}

// Two distant samples share the weight. Near one sample, the other has almost no effect.
TEST(CoverRadiusTest, IsSmallerThanThePlainRadiusWhereSamplesAreSpread) {
  core::Matrix samples(2, 1);
  samples << -5.0, 5.0;
  const auto svm = OneClassSvm::Fit(samples, {.nu = 0.9, .gamma = 1.0});
  // .5 exp(-d^2) = .5 exp(-level), because rho is .5 up to exp(-100).
  const double level = 0.49;
  EXPECT_NEAR(CoverRadius(svm, level), 0.7, 0.7 * 0.02);
  EXPECT_GT(std::sqrt((level - std::log(svm.rho())) / svm.gamma()), 1.0);
}

// Every state is inside an estimate with rho <= 0.
TEST(CoverRadiusTest, NoBallsCoverTheWholeSpace) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  for (const double rho : {-0.1, 0.0}) {
    const auto svm =
        OneClassSvm::FromParts(core::Matrix::Zero(1, 2), Eigen::VectorXd::Ones(1), 1.0, rho);
    const std::vector<double> far = {3.0, 4.0};
    ASSERT_EQ(svm.LogDecision(far), kInfinity);
    EXPECT_EQ(svm.FromLog(svm.LogDecision(far)), kInfinity);
    for (const double level : {-1.0, 0.0, 2.0}) EXPECT_EQ(CoverRadius(svm, level), kInfinity);
  }
}

TEST(CoverRadiusTest, ANanLevelIsRefused) {
  const core::Matrix samples = core::Matrix::Random(5, 2);
  const auto svm = OneClassSvm::Fit(samples, {.nu = 0.5});
  EXPECT_THROW((void)CoverRadius(svm, std::nan("")), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::kernel
