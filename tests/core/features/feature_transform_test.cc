#include "dfr/core/features/feature_transform.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::core {
namespace {

// 200 walks of 10 or 20 states. Feature 1 grows with t, features 0 and 1 are correlated across
// walks, feature 2 has other units, and feature 3 is constant.
std::vector<Matrix> Walks() {
  Random random(1);
  std::vector<Matrix> walks;
  for (int d = 0; d < 200; ++d) {
    Matrix states(d % 2 == 0 ? 10 : 20, 4);
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      const double a = random.Normal();
      const double b = random.Normal();
      states.row(t) << 3.0 + a, 5.0 * static_cast<double>(t) + 0.1 * (0.8 * a + 0.6 * b),
          1000.0 * random.Normal(), 7.0;
    }
    walks.push_back(states);
  }
  return walks;
}

// Definition without local scatter: across demonstrations at the same time, the covariance of z is
// (Corr + r)^(-1/2) Corr (Corr + r)^(-1/2) for any units. Progress has no effect.
TEST(FeatureTransformTest, WhitensTheSpreadAcrossDemonstrations) {
  const auto walks = Walks();
  const auto transform =
      FeatureTransform::Whitening(FeatureSelection::All(4), walks, {.ridge = 1e-6, .local = false});
  Matrix scatter = Matrix::Zero(4, 4);
  int count = 0;
  for (int t = 0; t < 10; ++t) {
    Matrix z(static_cast<Eigen::Index>(walks.size()), 4);
    for (Eigen::Index d = 0; d < z.rows(); ++d) {
      z.row(d) = transform.Apply(walks[static_cast<std::size_t>(d)]).row(t);
    }
    z.rowwise() -= z.colwise().mean().eval();
    scatter += z.transpose() * z;
    count += static_cast<int>(z.rows());
  }
  scatter /= count;
  Matrix expected = Matrix::Identity(4, 4);
  expected(3, 3) = 0.0;  // a constant stays constant
  // States beyond t = 10 exist in half of the walks. The estimate uses these states, but this check
  // does not.
  EXPECT_TRUE(test::AllClose(scatter, expected, 0.05));
}

TEST(FeatureTransformTest, WithoutDecorrelationItDividesByTheStandardDeviation) {
  const auto transform = FeatureTransform::Whitening(FeatureSelection::All(4), Walks(),
                                                     {.decorrelate = false, .local = false});
  const Eigen::VectorXd diagonal = transform.scale().diagonal();
  EXPECT_TRUE(test::AllClose(Matrix(diagonal.asDiagonal()), transform.scale(), 0.0));
  EXPECT_NEAR(diagonal[0], 1.0, 0.05);
  EXPECT_NEAR(diagonal[1], 10.0, 0.5);
  EXPECT_NEAR(diagonal[2], 0.001, 0.00005);
}

// The units of other features do not affect the scale.
TEST(FeatureTransformTest, ScalesAFeatureWithoutVarianceByItsStep) {
  for (const double unit : {1e-6, 1.0, 1e6}) {
    for (const bool local : {true, false}) {
      Random random(4);
      std::vector<Matrix> demonstrations;
      for (int d = 0; d < 20; ++d) {
        Matrix states(20, 2);
        for (Eigen::Index t = 0; t < states.rows(); ++t) {
          states.row(t) << 0.1 * static_cast<double>(t), unit * random.Normal();
        }
        demonstrations.push_back(states);
      }
      const WhiteningOptions options = {.local = local};
      const auto transform =
          FeatureTransform::Whitening(FeatureSelection::All(2), demonstrations, options);
      const Matrix z = transform.Apply(demonstrations[0]);
      const double step = 1.0 / std::sqrt(1.0 + options.ridge);
      EXPECT_NEAR(z(1, 0) - z(0, 0), step, 1e-9) << unit;
      EXPECT_NEAR(transform.scale()(1, 1) * unit, step, 0.1) << unit;
    }
  }
}

// Rounding by the recorder does not count as variance, neither in a clock nor in an entry at rest.
TEST(FeatureTransformTest, RoundingIsNoVariance) {
  Random random(5);
  std::vector<Matrix> demonstrations;
  for (int d = 0; d < 20; ++d) {
    Matrix states(20, 3);
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      states.row(t) << 0.1 * static_cast<double>(t) + 1e-11 * random.Normal(),
          1e-14 * random.Normal(), random.Normal();
    }
    demonstrations.push_back(states);
  }
  const auto transform = FeatureTransform::Whitening(FeatureSelection::All(3), demonstrations);
  EXPECT_NEAR(transform.scale()(0, 0), 10.0, 1.0);
  EXPECT_LT(transform.scale()(1, 1), 10.0);
  EXPECT_NEAR(transform.scale()(2, 2), 1.0, 0.2);
}

// Two paths are 20 standard deviations apart. A unit of z is at most a third of half their
// distance. Without local scatter it is half their distance.
TEST(FeatureTransformTest, SeveralWaysAreNotOneWideOne) {
  Random random(3);
  std::vector<Matrix> demonstrations;
  for (int d = 0; d < 60; ++d) {
    Matrix states(20, 2);
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      states.row(t) << static_cast<double>(t) + 0.1 * random.Normal(),
          (d % 2 == 0 ? 1.0 : -1.0) + 0.1 * random.Normal();
    }
    demonstrations.push_back(states);
  }
  const auto all = FeatureSelection::All(2);
  const auto local = FeatureTransform::Whitening(all, demonstrations);
  EXPECT_GT(local.scale()(1, 1), 3.0);
  EXPECT_LT(local.scale()(1, 1), 12.0);
  const auto global = FeatureTransform::Whitening(all, demonstrations, {.local = false});
  EXPECT_NEAR(global.scale()(1, 1), 1.0, 0.1);
}

TEST(FeatureTransformTest, IdentityIsTheSelectionAndRowsAgreeWithSingleStates) {
  StateLayout layout;
  layout.Add("arm", 3);
  layout.Add("object", 2);
  const auto identity = FeatureTransform::Identity(FeatureSelection(layout, "object,arm[0:1]"));
  std::vector<double> z(3);
  identity.Apply(std::vector<double>{1, 2, 3, 4, 5}, z);
  EXPECT_EQ(z, (std::vector<double>{4, 5, 1}));
  const auto walks = Walks();
  const auto transform = FeatureTransform::Whitening(FeatureSelection::All(4), walks);
  const Matrix rows = transform.Apply(walks[0]);
  std::vector<double> one(4);
  const test::NoAlloc guard;
  transform.Apply(Row(walks[0], 3), one);
  for (int i = 0; i < 4; ++i) ASSERT_EQ(one[static_cast<std::size_t>(i)], rows(3, i));
}

// Whitening thousands of features would take hours. The demonstrations are equal: the number of
// features is refused before their scatter is computed.
TEST(FeatureTransformTest, TooManyFeaturesAreRefusedFirst) {
  constexpr int kMost = FeatureTransform::kMaxFeatures;
  const std::vector<Matrix> same(3, Matrix::Ones(4, kMost + 1));
  const auto all = FeatureSelection::All(kMost + 1);
  for (const auto& message :
       {dfr::test::MessageOf([&] { (void)FeatureTransform::Whitening(all, same); }),
        dfr::test::MessageOf([&] { (void)FeatureTransform::Identity(all); })}) {
    EXPECT_THAT(message, testing::HasSubstr("at most 256 features are supported, not 257"));
  }
  EXPECT_NO_THROW((void)FeatureTransform::Identity(FeatureSelection::All(kMost)));
}

TEST(FeatureTransformTest, InvalidArgumentsAreRefused) {
  const auto all = FeatureSelection::All(4);
  EXPECT_THROW(FeatureTransform::Whitening(all, std::vector{Walks()[0]}), std::invalid_argument);
  const std::vector<Matrix> same(3, Matrix::Ones(4, 4));
  EXPECT_THROW(FeatureTransform::Whitening(all, same), std::invalid_argument);
  EXPECT_THROW(FeatureTransform(all, Eigen::VectorXd::Zero(3), Matrix::Identity(4, 4)),
               std::invalid_argument);
  EXPECT_THROW(FeatureTransform(all, Eigen::VectorXd::Zero(4), Matrix::Identity(4, 3)),
               std::invalid_argument);
  EXPECT_THROW((void)MedianNumStates({}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::core
