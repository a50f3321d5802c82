#include "dfr/core/numerics/local_scatter.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/all_close.h"

namespace dfr::core {
namespace {

// `count` normal points of covariance root root' about `mean`.
Matrix Normals(Random& random, int count, const Matrix& root, const Eigen::RowVectorXd& mean) {
  Matrix points(count, root.cols());
  for (double& x : points.reshaped()) x = random.Normal();
  return (points * root.transpose()).rowwise() + mean;
}

// 40 groups of 60 points with one covariance, whose correlation is .8.
struct Skewed {
  Random random{1};
  Matrix root = (Matrix(3, 3) << 2.0, 0.0, 0.0, 0.8, 0.6, 0.0, 0.0, 0.0, 0.1).finished();
  Matrix covariance = root * root.transpose();
  std::vector<Matrix> Groups(const Eigen::RowVectorXd& apart, int outliers = 0) {
    std::vector<Matrix> groups;
    for (int g = 0; g < 40; ++g) {
      const Eigen::RowVectorXd mean = Eigen::RowVectorXd::Constant(3, 5.0 * g);
      Matrix group(60, 3);
      group << Normals(random, 30, root, mean), Normals(random, 30, root, mean + apart);
      for (int i = 0; i < outliers; ++i) {
        group.row(i * 7) = mean + 20.0 * (group.row(i * 7) - mean);
      }
      groups.push_back(group);
    }
    return groups;
  }
  // Returns the scatter in units of the true standard deviations.
  Matrix Scaled(const Matrix& scatter) const {
    const Matrix units = covariance.diagonal().cwiseSqrt().cwiseInverse().asDiagonal();
    return units * scatter * units;
  }
};

TEST(LocalScatterTest, NormalPointsNearlyKeepTheirCovariance) {
  Skewed skewed;
  const auto groups = skewed.Groups(Eigen::RowVector3d::Zero());
  EXPECT_TRUE(
      test::AllClose(skewed.Scaled(LocalScatter(groups)), skewed.Scaled(skewed.covariance), 0.2));
  EXPECT_TRUE(test::AllClose(skewed.Scaled(PooledCovariance(groups)),
                             skewed.Scaled(skewed.covariance), 0.1));
}

// The scatter of two clusters is nearly the scatter of one cluster. The spread of all points is far
// wider.
TEST(LocalScatterTest, TwoClustersAreNotOneWideOne) {
  Skewed skewed;
  const auto groups = skewed.Groups(Eigen::RowVector3d(20.0, -10.0, 1.0));
  const Eigen::VectorXd local = skewed.Scaled(LocalScatter(groups)).diagonal();
  const Eigen::VectorXd global = skewed.Scaled(PooledCovariance(groups)).diagonal();
  EXPECT_GT(global.minCoeff(), 20.0);
  EXPECT_GT(local.minCoeff(), 0.8);
  EXPECT_LT(local.maxCoeff(), 2.5);
}

TEST(LocalScatterTest, OutliersHaveLittleEffect) {
  Skewed skewed;
  const auto groups = skewed.Groups(Eigen::RowVector3d::Zero(), 4);
  const Matrix scatter = skewed.Scaled(LocalScatter(groups));
  EXPECT_GT(skewed.Scaled(PooledCovariance(groups)).diagonal().minCoeff(), 15.0);
  EXPECT_TRUE(test::AllClose(scatter, skewed.Scaled(skewed.covariance), 0.4));
}

// A coordinate that is a sum of others, or constant up to the rounding of its mean, adds no
// dimension. A further dimension would make neighbours more distant.
TEST(LocalScatterTest, OnlyIndependentCoordinatesAreDimensions) {
  Skewed skewed;
  const auto groups = skewed.Groups(Eigen::RowVector3d::Zero());
  std::vector<Matrix> wider;
  for (std::size_t g = 0; g < groups.size(); ++g) {
    Matrix points(groups[g].rows(), 5);
    points << groups[g], groups[g].rowwise().sum(),
        Eigen::VectorXd::Constant(groups[g].rows(), 0.1 * static_cast<double>(g));
    wider.push_back(points);
  }
  const Matrix scatter = LocalScatter(wider);
  EXPECT_TRUE(test::AllClose(skewed.Scaled(scatter.topLeftCorner(3, 3)),
                             skewed.Scaled(skewed.covariance), 0.2));
  EXPECT_EQ(scatter.row(4), Eigen::RowVectorXd::Zero(5));
  EXPECT_EQ(PooledCovariance(wider).col(4), Eigen::VectorXd::Zero(5));
}

// Units scale the scatter. The order of points has no relevant effect.
TEST(LocalScatterTest, ScalesWithTheUnits) {
  Skewed skewed;
  std::vector<Matrix> groups = skewed.Groups(Eigen::RowVector3d(9.0, 9.0, 9.0));
  const Matrix before = LocalScatter(groups);
  const Matrix units = Eigen::RowVector3d(1024.0, 1.0 / 64.0, 8.0).asDiagonal();
  for (Matrix& group : groups) group = (group * units).colwise().reverse().eval();
  const Matrix expected = units * before * units;
  const Matrix after = LocalScatter(groups);
  EXPECT_TRUE(test::AllClose((after - expected) / expected.cwiseAbs().maxCoeff(),
                             Matrix::Zero(3, 3), 1e-6));
}

// A feature that jumps between two values has no scatter among neighbours. It gets a twentieth of
// its standard deviation.
TEST(LocalScatterTest, ASwitchKeepsATwentiethOfItsDeviation) {
  Random random(4);
  std::vector<Matrix> groups;
  for (int g = 0; g < 20; ++g) {
    Matrix group(60, 2);
    for (Eigen::Index i = 0; i < 60; ++i) group.row(i) << random.Normal(), i % 2;
    groups.push_back(group);
  }
  EXPECT_NEAR(LocalScatter(groups)(1, 1), 0.0025 * 0.25, 1e-9);
}

TEST(LocalScatterTest, WithoutEnoughPointsItIsThePooledCovariance) {
  Random random(5);
  std::vector<Matrix> groups;
  groups.reserve(6);
  for (int g = 0; g < 5; ++g) {
    groups.push_back(Normals(random, 3, Matrix::Identity(2, 2), Eigen::RowVector2d(g, 0)));
  }
  groups.emplace_back(0, 2);
  EXPECT_TRUE(test::AllClose(LocalScatter(groups), PooledCovariance(groups), 0.0));
  // By hand: +-1 about the means of two groups.
  const std::vector<Matrix> hand = {(Matrix(2, 1) << 1.0, 3.0).finished(),
                                    (Matrix(2, 1) << 9.0, 11.0).finished()};
  EXPECT_EQ(PooledCovariance(hand)(0, 0), 1.0);
}

TEST(LocalScatterTest, CopiesAndConstantsStayFinite) {
  const std::vector<Matrix> same = {Matrix::Ones(200, 3)};
  EXPECT_TRUE(test::AllClose(LocalScatter(same), Matrix::Zero(3, 3), 0.0));
}

TEST(LocalScatterTest, ErrorsNameTheOption) {
  const std::vector<Matrix> groups = {Matrix::Identity(5, 5)};
  for (const LocalScatterOptions& options :
       {LocalScatterOptions{.neighbours = 0.0},
        {.neighbours = 1.0},
        {.kept = 0.0},
        {.kept = 1.1},
        {.rounds = 0},
        {.ridge = 0.0},
        {.neighbours = std::numeric_limits<double>::quiet_NaN()}}) {
    EXPECT_THROW((void)LocalScatter(groups, options), std::invalid_argument);
  }
  EXPECT_THROW((void)LocalScatter({}), std::invalid_argument);
  EXPECT_THROW((void)PooledCovariance({}), std::invalid_argument);
  const std::vector<Matrix> widths = {Matrix::Ones(5, 2), Matrix::Ones(5, 3)};
  EXPECT_THROW((void)LocalScatter(widths), std::invalid_argument);
}

TEST(InverseSquareRootTest, WhitensTheRegularisedMatrix) {
  Random random(2);
  Matrix a(5, 5);
  for (Eigen::Index i = 0; i < a.size(); ++i) a.data()[i] = random.Normal();
  const Matrix covariance = a * a.transpose();
  const Matrix root = InverseSquareRoot(covariance, 0.3);
  const Matrix regular = covariance + 0.3 * Matrix::Identity(5, 5);
  // The condition number is about 1e2: a few of the sixteen digits are lost.
  EXPECT_TRUE(test::AllClose(root * regular * root, Matrix::Identity(5, 5), 1e-12));
  EXPECT_TRUE(test::AllClose(root, root.transpose(), 1e-14));
}

}  // namespace
}  // namespace dfr::core
