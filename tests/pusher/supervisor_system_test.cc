#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "supervisor/train_supervisor.h"
#include "tests/pusher/supervisor_episodes.h"
#include "tests/support/temp_folder.h"

namespace dfr::apps::pusher {
namespace {

// Checks the experiment's requirement on mean actions, and that few sampled demonstrations are
// discarded. Rates of one per cent need a thousand episodes.
TEST(ShippedSupervisorTest, CompletesWithItsMeanAndItsSamples) {
  const auto policy = imitation::GaussianPolicy::Load(DFR_SUPERVISOR);
  const Counts mean = Episodes(policy, false, 1000);
  EXPECT_GE(mean.completed, 990);
  EXPECT_LE(mean.collided, 5);
  const Counts sampled = Episodes(policy, true, 1000);
  EXPECT_GE(sampled.completed, 930);
  EXPECT_LE(sampled.collided, 40);
}

std::string Bytes(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Takes seconds: each training ends with an evaluation over a thousand episodes.
TEST(TrainSupervisorTest, ResumesFromACheckpointBitForBit) {
  const std::filesystem::path folder = dfr::test::ProcessFolder() / "dfr_train_supervisor_system";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  // One iteration has about 5000 controls, two about 9000: too few for a good supervisor.
  TrainSupervisorOptions options;
  options.seed = 4;
  options.min_steps = 1;
  options.max_steps = 8000;
  options.out = folder / "straight.dfr";
  EXPECT_EQ(TrainSupervisor(options), EXIT_FAILURE);
  options.out = folder / "interrupted.dfr";
  options.max_steps = 4000;
  EXPECT_EQ(TrainSupervisor(options), EXIT_FAILURE);
  EXPECT_NE(Bytes(folder / "interrupted.dfr"), Bytes(folder / "straight.dfr"));
  options.max_steps = 8000;
  options.resume = true;
  EXPECT_EQ(TrainSupervisor(options), EXIT_FAILURE);
  ASSERT_FALSE(Bytes(folder / "straight.dfr").empty());
  EXPECT_EQ(Bytes(folder / "interrupted.dfr"), Bytes(folder / "straight.dfr"));
  options.seed = 5;
  EXPECT_THROW(TrainSupervisor(options), std::invalid_argument) << "another seed";
  options.seed.reset();
  options.horizon = 61;
  EXPECT_THROW(TrainSupervisor(options), std::invalid_argument) << "another horizon";
  options.horizon.reset();
  options.scene.joint_step = 0.05;
  EXPECT_THROW(TrainSupervisor(options), std::invalid_argument) << "another scene";
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace dfr::apps::pusher
