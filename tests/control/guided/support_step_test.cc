#include "dfr/control/guided/support_step.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "tests/control/analytic.h"
#include "tests/control/known_jacobian.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

constexpr double kUnbounded = std::numeric_limits<double>::infinity();
constexpr int kNumStates = 3;

Eigen::VectorXd RandomVector(core::Random& random, int size, double scale = 1.0) {
  Eigen::VectorXd v(size);
  for (double& entry : v) entry = scale * random.Normal();
  return v;
}

Eigen::MatrixXd RandomJacobian(core::Random& random, int rows, int cols) {
  Eigen::MatrixXd j(rows, cols);
  for (double& entry : j.reshaped()) entry = random.Normal();
  return j;
}

// A support of three Gaussians, a J for three features and one to four control entries, a state
// that may be far outside, and a control within a limit that some entries may reach.
struct World {
  World(std::uint64_t seed, bool disturbed)
      : random(seed),
        controls(1 + static_cast<int>(seed % 4)),
        support({Point(), Point(), Point()}, random.Uniform(0.2, 3.0), random.Uniform(0.1, 0.9)),
        fit(test::KnownJacobian(
            RandomJacobian(random, kNumStates, controls),
            disturbed ? RandomVector(random, kNumStates) : Eigen::VectorXd(),
            disturbed ? DisturbanceModel{.base = 0.3, .per_control = 0.2} : DisturbanceModel{})),
        z(RandomVector(random, kNumStates, 1.5)),
        limit(random.Uniform(0.2, 2.0)),
        v(RandomVector(random, controls).cwiseMax(-limit).cwiseMin(limit)) {}

  std::vector<double> Point() {
    return {0.5 * random.Normal(), 0.5 * random.Normal(), 0.5 * random.Normal()};
  }
  [[nodiscard]] LocalModel model() const { return {support, fit, core::AsSpan(z)}; }

  core::Random random;
  int controls;
  test::GaussianSupport support;
  LocalFit fit;
  Eigen::VectorXd z;
  double limit;
  Eigen::VectorXd v;
};

// l = -2 |x|^2, c = 2. In one step from v = 0 with z = (1, 1), J = diag(2, 1): grad l = (-4, -4),
// d = J' grad l = (-8, -4), |d|^2 = 80, |J d|^2 = 272, s = 80 / (2 * 2 * 272) = 5 / 68.
class OneGaussianTest : public testing::Test {
 protected:
  test::GaussianSupport support_{{{0.0, 0.0}}, 2.0, 1.0};
  LocalFit fit_ = test::KnownJacobian(Eigen::Vector2d(2.0, 1.0).asDiagonal());
  Eigen::VectorXd z_ = Eigen::Vector2d(1.0, 1.0);
  LocalModel model_{support_, fit_, core::AsSpan(z_)};
};

TEST_F(OneGaussianTest, AStepMaximizesItsGuaranteedGain) {
  Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
  const double l = AscendSupport(model_, {.level = kUnbounded}, {.iterations = 1}, v);
  // J is known to 1e-9.
  EXPECT_TRUE(test::AllClose(v, Eigen::Vector2d(-10.0 / 17.0, -5.0 / 17.0), 1e-8));
  EXPECT_NEAR(l, -306.0 / 289.0, 1e-7);
  EXPECT_EQ(l, model_.Level(0, v));
}

// The bound is exact for a single Gaussian: l = -4 + 80 s - 2 * 272 s^2 = -2.
TEST_F(OneGaussianTest, AStepGoesNoFurtherThanTheTarget) {
  Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
  const double l = AscendSupport(model_, {.level = -2.0}, {.iterations = 1}, v);
  const double s = (80.0 - std::sqrt(80.0 * 80.0 - 4.0 * 544.0 * 2.0)) / (2.0 * 544.0);
  EXPECT_NEAR(l, -2.0, 1e-12);
  EXPECT_TRUE(test::AllClose(v, Eigen::Vector2d(-8.0 * s, -4.0 * s), 1e-8));
}

TEST_F(OneGaussianTest, StepsLeadToTheMaximum) {
  Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
  const double l = AscendSupport(model_, {.level = kUnbounded}, {.iterations = 100}, v);
  EXPECT_LE(l, 0.0);
  EXPECT_GT(l, -5e-3) << "it ends where a step gains less than 1e-3";
  EXPECT_TRUE(test::AllClose(v, Eigen::Vector2d(-0.5, -1.0), 0.05));
}

TEST_F(OneGaussianTest, AControlWithNothingToGainIsKeptBitForBit) {
  const Eigen::VectorXd before = Eigen::Vector2d(-0.1 / 3.0, 0.7 / 3.0);
  Eigen::VectorXd v = before;
  const double l = model_.Level(0, v);
  for (const double met : {l, l - 1.0, -kUnbounded}) {
    EXPECT_EQ(AscendSupport(model_, {.level = met}, {}, v), l);
  }
  EXPECT_EQ(AscendSupport(model_, {.level = 0.0}, {.iterations = 0}, v), l);
  const LocalFit nothing = test::KnownJacobian(Eigen::Matrix2d::Zero());
  const LocalModel without_effect{support_, nothing, core::AsSpan(z_)};
  EXPECT_EQ(AscendSupport(without_effect, {.level = 0.0}, {}, v), -4.0);
  EXPECT_TRUE(v == before);
}

// A prediction that is passed from call to call equals the control's prediction, bit for bit, and
// has no effect on the result.
TEST_F(OneGaussianTest, AKnownPredictionIsKeptUpToDate) {
  for (const double limit : {kUnbounded, 0.25}) {
    Eigen::VectorXd v = Eigen::Vector2d(0.2, -0.1);
    Eigen::VectorXd fresh = v;
    PredictedLevel there = model_.Predict(0, v);
    for (const double level : {-3.0, -2.0, -0.5, kUnbounded}) {
      const StepLimits limits{.control = Eigen::VectorXd::Constant(v.size(), limit)};
      EXPECT_EQ(AscendSupport(model_, {.level = level}, limits, v, there),
                AscendSupport(model_, {.level = level}, limits, fresh));
      EXPECT_TRUE(v == fresh);
      const PredictedLevel expected = model_.Predict(0, v);
      EXPECT_EQ(there.level, expected.level);
      EXPECT_EQ(there.level, model_.Level(0, v));
      EXPECT_TRUE(there.gradient == expected.gradient);
    }
  }
}

// One entry is at its limit: only the other entry can raise the level.
TEST_F(OneGaussianTest, AnEntryAtItsLimitIsHeld) {
  Eigen::VectorXd v = Eigen::Vector2d(-0.25, 0.0);
  const double l =
      AscendSupport(model_, {.level = kUnbounded},
                    {.control = Eigen::VectorXd::Constant(v.size(), 0.25), .iterations = 1}, v);
  EXPECT_EQ(v[0], -0.25);
  EXPECT_EQ(v[1], -0.25);
  EXPECT_NEAR(l, -2.0 * (0.25 + 0.5625), 1e-7);  // at (1 - 2 * 0.25, 1 - 0.25)
}

// From z' = (3, 1), grad l = (-12, -4), d = (-24, -4), |J d|^2 = 2320, s = 592 / (2 * 2 * 2320);
// the limit has no effect, because d leads away from it. The same holds with all signs changed.
TEST_F(OneGaussianTest, AnEntryAtItsLimitCanMoveBack) {
  for (const double sign : {1.0, -1.0}) {
    const Eigen::VectorXd z = sign * z_;
    const LocalModel model{support_, fit_, core::AsSpan(z)};
    Eigen::VectorXd v = Eigen::Vector2d(sign, 0.0);
    (void)AscendSupport(model, {.level = kUnbounded},
                        {.control = Eigen::VectorXd::Constant(v.size(), 1.0), .iterations = 1}, v);
    const double s = 592.0 / 9280.0;
    EXPECT_TRUE(test::AllClose(v, sign * Eigen::Vector2d(1.0 - 24.0 * s, -4.0 * s), 1e-6));
  }
}

// Entry 0 has two values: the ascent ignores its gradient and moves only entry 1.
TEST_F(OneGaussianTest, AnEntryWithFewValuesChangesOnlyInSnap) {
  const LocalModel model{support_, fit_, core::AsSpan(z_)};
  const StepLimits limits{.iterations = 20, .values = {{-1.0, 0.25}, {}}};
  Eigen::VectorXd v = Eigen::Vector2d(0.3, 0.0);
  const double before = model.Level(0, v);
  const double l = AscendSupport(model, {.level = kUnbounded}, limits, v);
  EXPECT_GT(l, before);
  EXPECT_EQ(v[0], 0.3);
  limits.Snap(v);
  EXPECT_EQ(v[0], 0.25);
  v[0] = -0.5;
  const double free = v[1];
  limits.Snap(v);
  EXPECT_EQ(v[0], -1.0);
  EXPECT_EQ(v[1], free);
}

// Without curvature one step reaches the target level.
TEST(AscendSupportTest, ALinearLevelIsClimbedInOneStep) {
  const test::FunctionLogSupport ramp(1, 0.0,
                                      [](int, std::span<const double> x, std::span<double> g) {
                                        if (!g.empty()) g[0] = 1.0;
                                        return x[0];
                                      });
  const LocalFit fit = test::KnownJacobian(Eigen::MatrixXd::Constant(1, 1, 2.0));
  const std::vector<double> z = {-3.0};
  Eigen::VectorXd v = Eigen::VectorXd::Zero(1);
  EXPECT_NEAR(AscendSupport({ramp, fit, z}, {.level = 1.0}, {}, v), 1.0, 1e-12);
  EXPECT_NEAR(v[0], 2.0, 1e-8);
}

TEST(AscendSupportTest, NeverLowersTheLevelStaysWithinItsLimitsAndNeverAllocates) {
  int raised = 0;
  for (std::uint64_t seed = 0; seed < 500; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed = " << seed);
    World world(seed, /*disturbed=*/seed % 2 == 0);
    const LocalModel model = world.model();
    const StepTarget target{.level = seed % 3 == 0 ? kUnbounded : 0.1};
    const StepLimits limits{.control = Eigen::VectorXd::Constant(world.v.size(), world.limit)};
    Eigen::VectorXd v = world.v;
    const test::NoAlloc guard;
    const double before = model.Level(0, v);
    const double l = AscendSupport(model, target, limits, v);
    ASSERT_GE(l, before);
    ASSERT_EQ(l, model.Level(0, v)) << "the returned level";
    ASSERT_LE(v.cwiseAbs().maxCoeff(), world.limit);
    raised += l > before ? 1 : 0;
  }
  EXPECT_GT(raised, 375);
}

// Each change of features is the effect of some control, and each maximum of l is above the target.
TEST(AscendSupportTest, ReachesAnAttainableTarget) {
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed = " << seed);
    core::Random random(seed);
    const auto point = [&] {
      return std::vector{0.5 * random.Normal(), 0.5 * random.Normal(), 0.5 * random.Normal()};
    };
    // One of three Gaussians alone reaches log(1 / (3 * 0.3)) = 0.1.
    const test::GaussianSupport support({point(), point(), point()}, 1.0, 0.3);
    const LocalFit fit = test::KnownJacobian(Eigen::MatrixXd::Identity(kNumStates, 4) +
                                             0.1 * RandomJacobian(random, kNumStates, 4));
    const Eigen::VectorXd z = RandomVector(random, kNumStates, 1.5);
    const LocalModel model{support, fit, core::AsSpan(z)};
    Eigen::VectorXd v = RandomVector(random, 4);
    const double before = model.Level(0, v);
    const double l = AscendSupport(model, {.level = 0.0}, {.iterations = 100}, v);
    ASSERT_GE(l, -1e-12) << "from " << before;
  }
}

TEST(AscendSupportTest, UsesTheSupportOfTheGivenPhase) {
  // B_t is a disk around (t, 0).
  const test::GaussianSupport support({{0.0, 0.0}}, 1.0, 0.5, {1.0, 0.0}, 5);
  const LocalFit fit = test::KnownJacobian(Eigen::Matrix2d::Identity());
  const std::vector<double> z = {0.0, 0.0};
  Eigen::VectorXd v = Eigen::VectorXd::Zero(2);
  const double l = AscendSupport({support, fit, z}, {.phase = 3, .level = kUnbounded}, {}, v);
  EXPECT_TRUE(test::AllClose(v, Eigen::Vector2d(3.0, 0.0), 1e-7));
  EXPECT_NEAR(l, std::log(2.0), 1e-12);
}

TEST(AscendSupportTest, ANonFiniteStateChangesNothing) {
  World world(1, false);
  world.z[1] = kUnbounded;
  Eigen::VectorXd v = world.v;
  const double l = AscendSupport(world.model(), {}, {}, v);
  EXPECT_FALSE(l >= 0.0);
  EXPECT_TRUE(v == world.v);
}

}  // namespace
}  // namespace dfr::control
