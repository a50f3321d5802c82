#include "small_system.h"

#include <gmock/gmock.h>

#include <Eigen/Cholesky>

#include "dfr/core/random.h"
#include "tests/support/no_alloc.h"

namespace dfr::control::internal {
namespace {

// Eigen is the peer. Its order of sums is part of the recorded results of all guards.
TEST(SmallSystemTest, FactorsAndSolvesWithTheBitsOfEigen) {
  core::Random random(1);
  for (Eigen::Index n = 1; n <= 40; ++n) {
    const Eigen::MatrixXd half =
        Eigen::MatrixXd::NullaryExpr(n, n, [&] { return random.Uniform(-1.0, 1.0); });
    const Eigen::MatrixXd a = half * half.transpose() + 0.1 * Eigen::MatrixXd::Identity(n, n);
    const Eigen::MatrixXd b =
        Eigen::MatrixXd::NullaryExpr(n, 1, [&] { return random.Uniform(-1.0, 1.0); });
    const Eigen::LLT<Eigen::MatrixXd> peer(a);
    Eigen::MatrixXd l = a;
    Factor(l);
    const Eigen::MatrixXd lower = l.triangularView<Eigen::Lower>();
    EXPECT_EQ(lower, Eigen::MatrixXd(peer.matrixL())) << n;
    Eigen::MatrixXd x = b;
    SolveFactored(l, x);
    EXPECT_EQ(x, peer.solve(b)) << n;
  }
}

// Larger matrices are factored by tiles, because Eigen would allocate.
TEST(SmallSystemTest, FactorsAndSolvesLargeMatricesWithoutAllocation) {
  core::Random random(2);
  for (const Eigen::Index n : {128, 129, 255, 256, 257, 384, 513}) {
    SCOPED_TRACE(n);
    const Eigen::MatrixXd half =
        Eigen::MatrixXd::NullaryExpr(n, n, [&] { return random.Uniform(-1.0, 1.0); });
    const Eigen::MatrixXd a = half * half.transpose() + Eigen::MatrixXd::Identity(n, n);
    const Eigen::MatrixXd b =
        Eigen::MatrixXd::NullaryExpr(n, 1, [&] { return random.Uniform(-1.0, 1.0); });
    Eigen::MatrixXd l = a;
    Eigen::MatrixXd x = b;
    {
      const test::NoAlloc guard;
      Factor(l);
      SolveFactored(l, x);
    }
    const Eigen::MatrixXd lower = l.triangularView<Eigen::Lower>();
    EXPECT_LT((lower * lower.transpose() - a).norm(), 1e-13 * a.norm());
    EXPECT_LT((a * x - b).norm(), 1e-9 * b.norm());
  }
}

TEST(SmallSystemTest, StopsAtAPivotThatIsNotPositive) {
  Eigen::MatrixXd a = Eigen::MatrixXd::Identity(3, 3);
  a(1, 0) = a(0, 1) = 2.0;  // the second pivot is 1 - 4
  Factor(a);
  EXPECT_EQ(a(0, 0), 1.0);
  EXPECT_EQ(a(1, 0), 2.0);
  EXPECT_EQ(a(1, 1), 1.0) << "the pivot stays unchanged";
}

}  // namespace
}  // namespace dfr::control::internal
