#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/imitation/gaussian_policy.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "train_supervisor.h"

namespace dfr::apps::pusher {
namespace {

struct Counts {
  int completed = 0;
  int collided = 0;
};

Counts Episodes(const imitation::GaussianPolicy& policy, bool sample) {
  constexpr int kHorizon = 60;
  sim::PusherPlant plant;
  std::vector<double> x(plant.state_dim());
  std::vector<double> u(plant.control_dim());
  Counts counts;
  for (std::uint64_t episode = 0; episode < 1000; ++episode) {
    plant.Reset(core::DeriveSeed(1911, {episode}));
    core::Random noise(core::DeriveSeed(1912, {episode}));
    for (int t = 0; t < kHorizon && !plant.completed() && !plant.collided(); ++t) {
      plant.Observe(x);
      if (sample) {
        policy.Sample(x, noise, u);
      } else {
        policy.mean().Control(t, x, u);
      }
      EXPECT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    }
    counts.completed += plant.completed();
    counts.collided += plant.collided();
  }
  return counts;
}

// The experiment's demand, over start states that neither training nor its stopping has used.
TEST(ShippedSupervisorTest, CompletesAndHardlyEverCollides) {
  const auto policy = imitation::GaussianPolicy::Load(DFR_SUPERVISOR);
  const Counts mean = Episodes(policy, false);
  EXPECT_GE(mean.completed, 990);
  EXPECT_LE(mean.collided, 5);
}

// What demonstrations do: few of them may have to be discarded.
TEST(ShippedSupervisorTest, SamplesAreUsableDemonstrations) {
  const auto policy = imitation::GaussianPolicy::Load(DFR_SUPERVISOR);
  EXPECT_NEAR(policy.log_std().array().exp().mean(), 0.3, 0.02);
  const Counts sampled = Episodes(policy, true);
  EXPECT_GE(sampled.completed, 930);
  EXPECT_LE(sampled.collided, 40);
}

class TrainSupervisorTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::path(testing::TempDir()) / "dfr_train_supervisor" / test->name();
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
};

std::string Bytes(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST_F(TrainSupervisorTest, GoesOnFromACheckpointAsIfNeverInterrupted) {
  // One iteration makes about 5000 controls, two about 9000: too few to be any good.
  TrainSupervisorOptions options;
  options.seed = 4;
  options.min_steps = 1;
  options.max_steps = 8000;
  options.out = folder_ / "straight.dfr";
  EXPECT_EQ(TrainSupervisor(options), EXIT_FAILURE);
  options.out = folder_ / "interrupted.dfr";
  options.max_steps = 4000;
  EXPECT_EQ(TrainSupervisor(options), EXIT_FAILURE);
  EXPECT_NE(Bytes(folder_ / "interrupted.dfr"), Bytes(folder_ / "straight.dfr"));
  options.max_steps = 8000;
  options.resume = true;
  EXPECT_EQ(TrainSupervisor(options), EXIT_FAILURE);
  ASSERT_FALSE(Bytes(folder_ / "straight.dfr").empty());
  EXPECT_EQ(Bytes(folder_ / "interrupted.dfr"), Bytes(folder_ / "straight.dfr"));
}

TEST_F(TrainSupervisorTest, MistakesAreNamed) {
  TrainSupervisorOptions options;
  options.out = folder_ / "none.dfr";
  options.resume = true;
  EXPECT_THAT([&] { TrainSupervisor(options); }, testing::ThrowsMessage<std::runtime_error>(
                                                     testing::HasSubstr("none.dfr.checkpoint")));
  options.max_steps = options.min_steps - 1;
  EXPECT_THAT([&] { TrainSupervisor(options); },
              testing::ThrowsMessage<std::invalid_argument>(testing::HasSubstr("--min-steps")));
}

}  // namespace
}  // namespace dfr::apps::pusher
