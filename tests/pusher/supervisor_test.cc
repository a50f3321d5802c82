#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <stdexcept>

#include "supervisor/train_supervisor.h"
#include "tests/pusher/supervisor_episodes.h"
#include "tests/support/temp_folder.h"

namespace dfr::apps::pusher {
namespace {

// `pusher train-supervisor` prints the same shares over a thousand episodes.
TEST(ShippedSupervisorTest, CompletesWithItsMeanAndItsSamples) {
  const auto policy = imitation::GaussianPolicy::Load(DFR_SUPERVISOR);
  EXPECT_NEAR(policy.log_std().array().exp().mean(), 0.3, 0.02);
  const Counts mean = Episodes(policy, false, 100);
  EXPECT_GE(mean.completed, 99);
  EXPECT_LE(mean.collided, 0);
  const Counts sampled = Episodes(policy, true, 100);
  EXPECT_GE(sampled.completed, 93);
  EXPECT_LE(sampled.collided, 4);
}

TEST(TrainSupervisorTest, MistakesAreNamed) {
  TrainSupervisorOptions options;
  options.out = dfr::test::ProcessFolder() / "none.dfr";
  options.resume = true;
  EXPECT_THAT([&] { TrainSupervisor(options); }, testing::ThrowsMessage<std::runtime_error>(
                                                     testing::HasSubstr("none.dfr.checkpoint")));
  options.max_steps = options.min_steps - 1;
  EXPECT_THAT([&] { TrainSupervisor(options); },
              testing::ThrowsMessage<std::invalid_argument>(testing::HasSubstr("--min-steps")));
}

}  // namespace
}  // namespace dfr::apps::pusher
