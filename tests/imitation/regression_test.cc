#include "regression.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"
#include "tests/support/random_matrix.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation::internal {
namespace {

using core::Matrix;
using test::RandomMatrix;

TEST(RegressionLossTest, LossIsTheFormulaWithoutBiasesInTheDecay) {
  Mlp mlp({1, 2});
  Eigen::VectorXd parameters(4);
  parameters << 2, -1, 0.5, 3;  // y = (2 x + 0.5, -x + 3)
  Matrix inputs(2, 1), targets(2, 2);
  inputs << 1, -1;
  targets << 2.5, 0, -1.5, 4;  // errors (0, 2) and (0, 0)
  RegressionLoss loss(mlp, 0.1);
  EXPECT_DOUBLE_EQ(loss.Evaluate(parameters, inputs, targets, nullptr),
                   0.5 * (4.0 + 0.0) / 2 + 0.5 * 0.1 * (4 + 1));
}

TEST(RegressionLossTest, GradientIsThatOfTheLoss) {
  constexpr double kStep = 1e-5;
  core::Random random(1);
  const Mlp mlp({4, 6, 5, 3}, random);
  const Matrix inputs = RandomMatrix(random, 20, 4), targets = RandomMatrix(random, 20, 3);
  RegressionLoss loss(mlp, 0.3);
  Eigen::VectorXd gradient;
  loss.Evaluate(mlp.parameters(), inputs, targets, &gradient);
  for (Eigen::Index i = 0; i < gradient.size(); ++i) {
    Eigen::VectorXd moved = mlp.parameters();
    moved[i] += kStep;
    const double above = loss.Evaluate(moved, inputs, targets, nullptr);
    moved[i] -= 2.0 * kStep;
    const double below = loss.Evaluate(moved, inputs, targets, nullptr);
    EXPECT_NEAR(gradient[i], (above - below) / (2.0 * kStep), 1e-8) << "parameter " << i;
  }
}

TEST(RegressionLossTest, SmallerBatchesAfterTheFirstDoNotAllocate) {
  core::Random random(2);
  const Mlp mlp({4, 6, 3}, random);
  const Matrix inputs = RandomMatrix(random, 20, 4), targets = RandomMatrix(random, 20, 3);
  RegressionLoss loss(mlp, 0.3);
  Eigen::VectorXd gradient;
  loss.Evaluate(mlp.parameters(), inputs, targets, &gradient);
  const test::NoAlloc guard;
  loss.Evaluate(mlp.parameters(), inputs.topRows(7), targets.topRows(7), &gradient);
  loss.Evaluate(mlp.parameters(), inputs, targets, &gradient);
}

// Algorithm 1 of Kingma and Ba, entry by entry.
TEST(AdamTest, StepsMatchTheAlgorithm) {
  constexpr double kRate = 0.05, kBeta1 = 0.9, kBeta2 = 0.999, kEpsilon = 1e-8;
  core::Random random(3);
  Adam adam(4, kRate);
  Eigen::VectorXd actual = RandomMatrix(random, 4, 1).col(0);
  Eigen::VectorXd expected = actual;
  double m[4] = {}, v[4] = {};
  for (int t = 1; t <= 50; ++t) {
    const Eigen::VectorXd gradient = RandomMatrix(random, 4, 1).col(0);
    adam.Step(gradient, actual);
    for (int i = 0; i < 4; ++i) {
      m[i] = kBeta1 * m[i] + (1 - kBeta1) * gradient[i];
      v[i] = kBeta2 * v[i] + (1 - kBeta2) * gradient[i] * gradient[i];
      const double m_hat = m[i] / (1 - std::pow(kBeta1, t));
      const double v_hat = v[i] / (1 - std::pow(kBeta2, t));
      expected[i] -= kRate * m_hat / (std::sqrt(v_hat) + kEpsilon);
    }
    // Each of the 50 steps of size 0.05 is rounded several times.
    ASSERT_TRUE(test::AllClose(actual, expected, 1e-14)) << "step " << t;
  }
}

TEST(AdamTest, ImpossibleStatesAreRefused) {
  const test::TempFolder folder;
  const auto error = [&](std::int64_t steps, double first, double second) {
    core::ArchiveWriter writer("adam", 1);
    writer.Integer(steps);
    writer.Numbers({&first, 1});
    writer.Numbers({&second, 1});
    writer.Save(folder / "adam");
    core::ArchiveReader reader(folder / "adam", "adam", 1);
    Adam adam(1, 0.1);
    try {
      adam.Load(reader);
    } catch (const std::runtime_error& e) {
      return std::string(e.what());
    }
    return std::string("none");
  };
  EXPECT_EQ(error(3, -1.0, 0.5), "none");
  EXPECT_EQ(error(0, 0.0, 0.0), "none");
  EXPECT_THAT(error(-1, 0.0, 0.0), testing::HasSubstr("the optimiser's number of steps is -1"));
  for (const double wrong : {std::nan(""), HUGE_VAL}) {
    EXPECT_THAT(error(1, wrong, 0.5), testing::HasSubstr("moments are not finite"));
    EXPECT_THAT(error(1, 0.5, wrong), testing::HasSubstr("moments are not finite"));
  }
  EXPECT_THAT(error(1, 0.5, -1.0), testing::HasSubstr("second moment is negative"));
}

TEST(AdamTest, EveryEpochVisitsEveryRowOnce) {
  // Inputs of a linear layer are one-hot: a row of the weights moves only in steps whose batch has
  // the row's sample. Adam's first step has the size of the learning rate for any gradient.
  constexpr double kRate = 1e-3;
  const Matrix inputs = Matrix::Identity(7, 7);
  const Matrix targets = Matrix::Constant(7, 1, 5.0);
  Mlp mlp({7, 1});
  Adam adam(mlp.num_parameters(), kRate);
  core::Random random(4);
  FitByAdam(inputs, targets, 1, 7, 0.0, adam, random, mlp);
  EXPECT_TRUE(test::AllClose(mlp.parameters(), Eigen::VectorXd::Constant(8, kRate), 1e-10));

  // In batches of 3, 3 and 1, every weight moves, and none by more than three steps.
  Mlp other({7, 1});
  Adam fresh(other.num_parameters(), kRate);
  FitByAdam(inputs, targets, 1, 3, 0.0, fresh, random, other);
  EXPECT_GT(other.parameters().minCoeff(), 0.3 * kRate);
  EXPECT_LT(other.parameters().maxCoeff(), 3.0 * kRate + 1e-12);
}

}  // namespace
}  // namespace dfr::imitation::internal
