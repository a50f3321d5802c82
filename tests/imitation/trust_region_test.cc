#include "trust_region.h"

#include <gtest/gtest.h>

#include <cmath>

#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/random.h"
#include "tests/support/all_close.h"
#include "tests/support/random_matrix.h"

namespace dfr::imitation::internal {
namespace {

using core::Matrix;
using test::RandomMatrix;

// A small policy with controls drawn from it.
struct Case {
  core::Random random{1};
  Mlp mlp{{3, 5, 2}, random};
  Eigen::VectorXd log_std = Eigen::Vector2d(-0.4, 0.1);
  Matrix inputs = RandomMatrix(random, 40, 3);
  Matrix controls;
  Eigen::VectorXd advantages = RandomMatrix(random, 40, 1).col(0);

  Case() {
    Mlp::Workspace workspace;
    controls = mlp.Forward(inputs, workspace);
    controls += RandomMatrix(random, 40, 2) * Eigen::Vector2d(log_std.array().exp()).asDiagonal();
  }
  TrustRegionProblem Problem() const { return {mlp, log_std, inputs, controls, advantages}; }
};

TEST(TrustRegionTest, GainAndDivergenceAreZeroAtTheOldPolicy) {
  const Case c;
  TrustRegionProblem problem = c.Problem();
  const auto [gain, kl] = problem.Evaluate(problem.theta());
  EXPECT_NEAR(gain, 0.0, 1e-15);
  EXPECT_NEAR(kl, 0.0, 1e-15);
}

TEST(TrustRegionTest, GradientIsThatOfTheSurrogate) {
  constexpr double kStep = 1e-5;
  const Case c;
  TrustRegionProblem problem = c.Problem();
  for (Eigen::Index i = 0; i < problem.theta().size(); ++i) {
    Eigen::VectorXd theta = problem.theta();
    theta[i] += kStep;
    const double above = problem.Evaluate(theta).gain;
    theta[i] -= 2.0 * kStep;
    const double below = problem.Evaluate(theta).gain;
    // The error is step^2 times third derivatives of order 10.
    EXPECT_NEAR(problem.gradient()[i], (above - below) / (2.0 * kStep), 1e-8) << "entry " << i;
  }
}

// KL is zero with zero gradient at the old policy, so KL(theta + h v) = h^2/2 v'Fv + O(h^3), and
// the odd part cancels between v and -v.
TEST(TrustRegionTest, FisherVectorProductIsTheHessianOfTheKl) {
  constexpr double kStep = 1e-3;
  const Case c;
  TrustRegionProblem problem = c.Problem();
  core::Random random(2);
  const auto kl = [&](const Eigen::VectorXd& step) {
    return problem.Evaluate(problem.theta() + step).kl;
  };
  for (int k = 0; k < 20; ++k) {
    const Eigen::VectorXd v = RandomMatrix(random, problem.theta().size(), 1).col(0).normalized();
    const Eigen::VectorXd w = RandomMatrix(random, problem.theta().size(), 1).col(0).normalized();
    Eigen::VectorXd product;
    problem.FisherVectorProduct(v, product);
    // Mixed second derivative. The error is step^2 times fourth derivatives of order 10.
    const double across =
        (kl(kStep * (v + w)) - kl(kStep * (v - w)) + kl(-kStep * (v + w)) - kl(kStep * (w - v))) /
        (4.0 * kStep * kStep);
    EXPECT_NEAR(product.dot(w), across, 2e-5);
  }
}

// Compares with the sample mean of log(pi_old / pi_new) over controls drawn from the old policy.
TEST(TrustRegionTest, KlIsTheMeanLogRatioOfTheDensities) {
  const Eigen::Vector2d old_log_std(-0.4, 0.1), new_log_std(-0.2, -0.1);
  Mlp mlp({1, 2});
  Eigen::VectorXd moved(6);
  moved << 0, 0, 0.3, -0.2, new_log_std;  // the biases move the mean
  constexpr int kDraws = 200000;
  core::Random random(3);
  const Matrix noise = RandomMatrix(random, kDraws, 2);
  const Matrix inputs = Matrix::Zero(kDraws, 1);
  const Matrix controls = noise * Eigen::Vector2d(old_log_std.array().exp()).asDiagonal();
  const Eigen::VectorXd advantages = Eigen::VectorXd::Zero(kDraws);
  TrustRegionProblem problem(mlp, old_log_std, inputs, controls, advantages);
  const Eigen::RowVector2d mean(0.3, -0.2);
  const Eigen::ArrayXd log_ratio = (new_log_std - old_log_std).sum() -
                                   0.5 * noise.array().square().rowwise().sum() +
                                   0.5 * (((controls.rowwise() - mean).array().rowwise() *
                                           (-new_log_std.array()).exp().transpose())
                                              .square()
                                              .rowwise()
                                              .sum());
  const double deviation = std::sqrt((log_ratio - log_ratio.mean()).square().mean());
  EXPECT_NEAR(problem.Evaluate(moved).kl, log_ratio.mean(), 4.0 * deviation / std::sqrt(kDraws));
}

TEST(TrustRegionTest, ConjugateGradientSolvesInAsManyStepsAsUnknowns) {
  core::Random random(4);
  const Eigen::MatrixXd root = RandomMatrix(random, 8, 8);
  const Eigen::MatrixXd a = root * root.transpose() + Eigen::MatrixXd::Identity(8, 8);
  const Eigen::VectorXd b = RandomMatrix(random, 8, 1).col(0);
  const auto product = [&](const Eigen::VectorXd& v, Eigen::VectorXd& out) { out = a * v; };
  // The condition number is below 100. The loss of conjugacy is about this number times the
  // rounding error.
  EXPECT_TRUE(
      test::AllClose(ConjugateGradient(product, b, 8), core::SolveSymmetric(a, b).col(0), 1e-8));
  EXPECT_EQ(ConjugateGradient(product, Eigen::VectorXd::Zero(8), 8).norm(), 0.0);
}

}  // namespace
}  // namespace dfr::imitation::internal
