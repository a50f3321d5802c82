#include "dfr/reduction/slow_features.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/message_of.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::HasSubstr;

// Mixtures of three sources: a slow sine, a fast one and noise.
Matrix Mixed(const Eigen::Matrix3d& mixing, int rows, std::uint64_t seed) {
  core::Random random(seed);
  Matrix x(rows, 3);
  for (int t = 0; t < rows; ++t) {
    const Eigen::Vector3d source(std::sin(0.02 * t), std::sin(0.9 * t), random.Normal());
    x.row(t) = (mixing * source).transpose();
  }
  return x;
}

TEST(SlowFeaturesTest, FindsTheSlowSourceOfAMixture) {
  Eigen::Matrix3d mixing;
  mixing << 0.5, 2.0, 1.0, -0.3, 1.0, 3.0, 1.0, -1.0, 0.5;
  const std::vector<Matrix> episodes = {Mixed(mixing, 4000, 1)};
  const SlowFeatures fit = FitSlowFeatures(episodes);
  ASSERT_EQ(fit.directions.rows(), 3);
  // The first direction extracts the slow source alone: v' M is along e_0.
  Eigen::RowVector3d read = fit.directions.row(0) * mixing;
  read /= read.norm();
  EXPECT_NEAR(std::abs(read[0]), 1.0, 1e-3);
  // The slow sine has variance 1 / 2, and its differences have 2 sin(0.01)^2. The slowness of noise
  // is 1 / 2.
  EXPECT_NEAR(fit.slowness[0], 0.25 / std::pow(std::sin(0.01), 2), 0.05 * fit.slowness[0]);
  EXPECT_NEAR(fit.slowness[1], 0.25 / std::pow(std::sin(0.45), 2), 0.05 * fit.slowness[1]);
  EXPECT_NEAR(fit.slowness[2], 0.5, 0.05);
}

TEST(SlowFeaturesTest, DifferencesHaveVarianceOne) {
  Eigen::Matrix3d mixing = Eigen::Matrix3d::Identity();
  mixing(0, 1) = 3.0;
  core::Random random(2);
  std::vector<Matrix> episodes = {Matrix(50, 3), Matrix(30, 3)};
  for (Matrix& x : episodes) {
    for (double& value : x.reshaped()) value = random.Normal();
    x *= mixing;
  }
  const SlowFeatures fit = FitSlowFeatures(episodes);
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  double steps = 0.0;
  for (const Matrix& x : episodes) {
    const Matrix z = (x.rowwise() - fit.mean.transpose()) * fit.directions.transpose();
    const Matrix step = z.bottomRows(z.rows() - 1) - z.topRows(z.rows() - 1);
    sum += step.transpose() * step;
    mean += step.colwise().sum().transpose();
    steps += static_cast<double>(step.rows());
  }
  mean /= steps;
  const Eigen::Matrix3d covariance = sum / steps - mean * mean.transpose();
  EXPECT_LT((covariance - Eigen::Matrix3d::Identity()).norm(), 1e-4);
}

TEST(SlowFeaturesTest, AnEntryConstantInEachEpisodeIsSlowest) {
  // Two episodes of three entries: a constant, -1 or 1; noise; an entry that never varies.
  core::Random random(4);
  std::vector<Matrix> episodes(2, Matrix::Constant(50, 3, 7.0));
  for (int i = 0; i < 2; ++i) {
    for (int t = 0; t < 50; ++t) {
      episodes[static_cast<std::size_t>(i)](t, 0) = i == 0 ? -1.0 : 1.0;
      episodes[static_cast<std::size_t>(i)](t, 1) = random.Normal();
    }
  }
  const SlowFeatures fit = FitSlowFeatures(episodes);
  ASSERT_EQ(fit.directions.rows(), 2);
  EXPECT_GT(fit.directions(0, 0), 0.0);
  EXPECT_LT(std::abs(fit.directions(0, 1)), 0.01 * fit.directions(0, 0));
  // The mean variance is about 2 / 3. A millionth of it bounds the differences from below. The
  // variance along the constants is 1.
  EXPECT_NEAR(fit.slowness[0], 1.5e6, 0.2e6);
  EXPECT_NEAR(fit.mean[2], 7.0, 1e-12);
}

TEST(SlowFeaturesTest, RefusesEpisodesWithoutDifferences) {
  const auto message = [](const std::vector<Matrix>& episodes) {
    return test::MessageOf([&] { static_cast<void>(FitSlowFeatures(episodes)); });
  };
  EXPECT_THAT(message({}), HasSubstr("need episodes"));
  EXPECT_THAT(message({Matrix::Ones(1, 2), Matrix::Zero(1, 2)}), HasSubstr("two states"));
  EXPECT_THAT(message({Matrix::Ones(5, 2)}), HasSubstr("all rows are equal"));
  EXPECT_THAT(message({Matrix::Ones(5, 2), Matrix::Ones(5, 3)}),
              HasSubstr("episode 1 has 3 columns, but episode 0 has 2"));
  Matrix bad = Matrix::Ones(5, 2);
  bad(2, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message({Matrix::Ones(5, 2), bad}), HasSubstr("episode 1 has an entry that is not"));
}

}  // namespace
}  // namespace dfr::reduction
