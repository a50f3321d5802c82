#include "dfr/imitation/trpo.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/files/read_file.h"
#include "tests/imitation/point_reach.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using test::PointReach;
using testing::DoubleNear;
using testing::ElementsAre;
using testing::HasSubstr;

TrpoOptions SmallOptions() {
  return {.hidden = {16}, .critic_hidden = {16}, .horizon = 40, .batch_steps = 1000, .seed = 1};
}

// By hand: discount 0.5, lambda 0.5, V = (2, 4, 6), r = (1, 2, 3).
// Residuals: 1 + 2 - 2 = 1; 2 + 3 - 4 = 1; 3 + 0 - 6 = -3.
// A_2 = -3; A_1 = 1 + 0.25 (-3) = 0.25; A_0 = 1 + 0.25 * 0.25 = 1.0625.
TEST(GeneralizedAdvantagesTest, MatchesValuesComputedByHand) {
  const std::vector<double> rewards = {1, 2, 3}, values = {2, 4, 6};
  std::vector<double> advantages(3);
  {
    const test::NoAlloc guard;
    GeneralizedAdvantages(rewards, values, 0.5, 0.5, advantages);
  }
  EXPECT_THAT(advantages, ElementsAre(1.0625, 0.25, -3.0));
}

// lambda = 1 gives the discounted return minus the value, lambda = 0 the one-step residual. 1e-14
// exceeds the rounding of sums of a few terms below 10.
TEST(GeneralizedAdvantagesTest, LambdaInterpolatesBetweenReturnsAndResiduals) {
  const std::vector<double> rewards = {1, -2, 5, 0.5}, values = {0.3, 0.1, -2, 4};
  std::vector<double> advantages(4);
  GeneralizedAdvantages(rewards, values, 0.9, 1.0, advantages);
  EXPECT_NEAR(advantages[0], 1 - 0.9 * 2 + 0.81 * 5 + 0.729 * 0.5 - 0.3, 1e-14);
  GeneralizedAdvantages(rewards, values, 0.9, 0.0, advantages);
  EXPECT_THAT(advantages, ElementsAre(DoubleNear(1 + 0.9 * 0.1 - 0.3, 1e-14),
                                      DoubleNear(-2 - 0.9 * 2 - 0.1, 1e-14),
                                      DoubleNear(5 + 0.9 * 4 + 2, 1e-14), -3.5));
}

TEST(TrpoTest, LearnsToReachAGoalFromEverySeed) {
  for (std::uint64_t seed = 0; seed < 2; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed = " << seed);
    PointReach environment;
    TrpoOptions options = SmallOptions();
    options.seed = seed;
    Trpo trpo(environment, options);
    TrpoProgress progress = trpo.Iterate();
    EXPECT_LT(progress.completed, 0.5);  // a random walk
    for (int i = 1; i < 80; ++i) {
      progress = trpo.Iterate();
      if (progress.accepted) {
        EXPECT_LE(progress.kl, options.max_kl);
        EXPECT_GT(progress.surrogate_gain, 0.0);
      }
    }
    EXPECT_EQ(progress.iteration, 80);
    EXPECT_EQ(progress.steps, trpo.steps());
    EXPECT_GT(progress.explained_variance, 0.5);

    // Applies the mean action in 200 episodes from other start states.
    const GaussianPolicy policy = trpo.policy();
    test::PointPlant plant;
    int completed = 0;
    std::vector<double> x(4), u(2);
    for (std::uint64_t episode = 0; episode < 200; ++episode) {
      plant.Reset(core::DeriveSeed(99, {episode}));
      for (int t = 0; t < 40 && !plant.completed(); ++t) {
        plant.Observe(x);
        policy.mean().Control(t, x, u);
        ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
      }
      completed += plant.completed();
    }
    EXPECT_GE(completed, 195);
  }
}

void ExpectSame(const TrpoProgress& a, const TrpoProgress& b) {
  EXPECT_EQ(a.iteration, b.iteration);
  EXPECT_EQ(a.steps, b.steps);
  EXPECT_EQ(a.episodes, b.episodes);
  EXPECT_EQ(a.mean_return, b.mean_return);
  EXPECT_EQ(a.kl, b.kl);
  EXPECT_EQ(a.entropy, b.entropy);
  EXPECT_EQ(a.explained_variance, b.explained_variance);
}

TEST(TrpoTest, AResumedRunContinuesBitForBit) {
  const test::TempFolder folder;
  for (const int before : {0, 3}) {
    PointReach environment, other;
    Trpo whole(environment, SmallOptions());
    for (int i = 0; i < before; ++i) whole.Iterate();
    whole.Save(folder / "checkpoint.dfr");
    Trpo resumed = Trpo::Resume(other, folder / "checkpoint.dfr");
    for (int i = 0; i < 3; ++i) ExpectSame(whole.Iterate(), resumed.Iterate());
    const GaussianPolicy policy = whole.policy(), same = resumed.policy();
    EXPECT_EQ(policy.mean().mlp().parameters(), same.mean().mlp().parameters());
    EXPECT_EQ(policy.mean().whitening().mean(), same.mean().whitening().mean());
    EXPECT_EQ(policy.log_std(), same.log_std());
  }
}

TEST(TrpoTest, ACheckpointDeclaresNoMoreWeightsThanItsSizeAllows) {
  const test::TempFolder folder;
  const std::vector<int> narrow = {16};
  const std::vector<int> wide(20, Mlp::kMaxWidth);
  for (const bool critic : {false, true}) {
    core::ArchiveWriter archive("trpo-checkpoint", 2);
    archive.Integers(critic ? narrow : wide);
    archive.Integers(critic ? wide : narrow);
    for (int i = 0; i < 2; ++i) archive.Text("");
    for (int i = 0; i < 8; ++i) archive.Number(0.5);
    for (int i = 0; i < 6; ++i) archive.Integer(10);
    archive.Save(folder / "checkpoint.dfr");
    PointReach environment;
    EXPECT_THAT(test::MessageOf<std::runtime_error>([&] {
                  static_cast<void>(Trpo::Resume(environment, folder / "checkpoint.dfr"));
                }),
                HasSubstr("weights of 8 bytes, too many"));
  }
}

TEST(TrpoTest, ResultsDependOnlyOnTheSeed) {
  PointReach a, b, c;
  TrpoOptions options = SmallOptions();
  Trpo first(a, options), second(b, options);
  options.seed = 2;
  Trpo third(c, options);
  const TrpoProgress progress = first.Iterate();
  ExpectSame(progress, second.Iterate());
  EXPECT_NE(progress.mean_return, third.Iterate().mean_return);
}

TEST(TrpoTest, ExplorationNeverFallsBelowItsFloor) {
  PointReach environment;
  TrpoOptions options = SmallOptions();
  options.initial_log_std = -1.0;
  options.min_log_std = -1.05;
  Trpo trpo(environment, options);
  for (int i = 0; i < 15; ++i) trpo.Iterate();
  EXPECT_GE(trpo.policy().log_std().minCoeff(), -1.05);
}

TEST(TrpoTest, FeaturesLimitThePolicysInputs) {
  PointReach environment;
  TrpoOptions options = SmallOptions();
  options.features = "goal";
  Trpo trpo(environment, options);
  trpo.Iterate();
  EXPECT_EQ(trpo.policy().mean().mlp().input_dim(), 2);
  EXPECT_EQ(trpo.policy().state_dim(), 4);
}

TEST(TrpoTest, ABrokenRewardIsAnErrorThatNamesStepAndSeed) {
  PointReach environment;
  environment.broken_reward = true;
  Trpo trpo(environment, SmallOptions());
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { trpo.Iterate(); }),
              HasSubstr("reward is not finite at step 0 of the episode with seed"));
}

TEST(TrpoTest, AFailedIterationIsExplainedAndChangesNothing) {
  const test::TempFolder folder;
  PointReach environment;
  TrpoOptions options = SmallOptions();
  options.critic_learning_rate = 1e200;
  Trpo trpo(environment, options);
  const Eigen::VectorXd before = trpo.policy().mean().mlp().parameters();
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { trpo.Iterate(); }),
              HasSubstr("the critic diverges: choose a smaller critic_learning_rate than 1e+200"));
  EXPECT_EQ(trpo.policy().mean().mlp().parameters(), before);
  EXPECT_EQ(trpo.steps(), 0);
  trpo.Save(folder / "failed.dfr");
  Trpo(environment, options).Save(folder / "fresh.dfr");
  EXPECT_EQ(core::ReadFile(folder / "failed.dfr"), core::ReadFile(folder / "fresh.dfr"));

  PointReach huge;
  huge.reward_scale = 1e308;
  Trpo overflowing(huge, SmallOptions());
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { overflowing.Iterate(); }),
              HasSubstr("squares of the returns are not finite: scale the rewards down"));
  EXPECT_EQ(overflowing.steps(), 0);
}

TEST(TrpoTest, AnInfiniteStepIsRejected) {
  PointReach environment;
  TrpoOptions options = SmallOptions();
  options.max_kl = 1e308;
  Trpo trpo(environment, options);
  const Eigen::VectorXd before = trpo.policy().mean().mlp().parameters();
  EXPECT_FALSE(trpo.Iterate().accepted);
  EXPECT_EQ(trpo.policy().mean().mlp().parameters(), before);
}

TEST(TrpoTest, OptionsOutOfRangeAreNamed) {
  PointReach environment;
  const auto message = [&](auto change) {
    TrpoOptions options = SmallOptions();
    change(options);
    return test::MessageOf<std::invalid_argument>([&] { Trpo(environment, options); });
  };
  EXPECT_THAT(message([](TrpoOptions& o) { o.discount = 1.5; }), HasSubstr("discount"));
  EXPECT_THAT(message([](TrpoOptions& o) { o.horizon = 0; }), HasSubstr("horizon"));
  EXPECT_THAT(message([](TrpoOptions& o) { o.max_kl = 0; }), HasSubstr("max_kl"));
  EXPECT_THAT(message([](TrpoOptions& o) { o.min_log_std = 0; }), HasSubstr("floor 0"));
  EXPECT_THAT(message([](TrpoOptions& o) { o.features = "tip"; }), HasSubstr("'tip'"));
  EXPECT_THAT(message([](TrpoOptions& o) { o.hidden = {0}; }), HasSubstr("layer 1"));
}

}  // namespace
}  // namespace dfr::imitation
