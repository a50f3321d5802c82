#include "dfr/core/record.h"

#include <gtest/gtest.h>

#include <vector>

#include "dfr/core/plant.h"

namespace dfr::core {
namespace {

// A counter of controls that completes at `goal` and collides at `wall`.
class CountingPlant final : public Plant {
 public:
  CountingPlant(double goal, double wall) : goal_(goal), wall_(wall) { layout_.Add("count", 1); }
  [[nodiscard]] const StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return 1; }
  void Reset(std::uint64_t seed) override { count_ = static_cast<double>(seed); }
  [[nodiscard]] PlantStatus Apply(std::span<const double> u) noexcept override {
    if (u[0] < 0.0) return PlantStatus::kRefused;
    count_ += u[0];
    return PlantStatus::kOk;
  }
  void Observe(std::span<double> x) const noexcept override { x[0] = count_; }
  [[nodiscard]] bool completed() const noexcept override { return count_ >= goal_; }
  [[nodiscard]] bool collided() const noexcept override { return count_ >= wall_; }
  void Halt() noexcept override {}

 private:
  StateLayout layout_;
  double goal_;
  double wall_;
  double count_ = 0.0;
};

// Records from 5 on, in steps of one, with a refused control at `refused`.
Trajectory RecordFromFive(double goal, double wall, int refused = -1) {
  CountingPlant plant(goal, wall);
  plant.Reset(5);
  return Record(plant, 4, [&](int t, std::span<const double> x, std::span<double> u) {
    EXPECT_EQ(x[0], 5.0 + t);
    u[0] = t == refused ? -1.0 : 1.0;
    return plant.Apply(u);
  });
}

std::vector<double> States(const Trajectory& trajectory) {
  return {trajectory.states.data(), trajectory.states.data() + trajectory.states.size()};
}

TEST(RecordTest, EndsAtTheGoalAtAConstraintAndAtTheHorizon) {
  const Trajectory done = RecordFromFive(7, 100);
  EXPECT_EQ(done.outcome, Outcome::kCompleted);
  EXPECT_EQ(States(done), (std::vector<double>{5, 6, 7}));
  EXPECT_EQ(done.controls, Matrix::Ones(2, 1));
  EXPECT_EQ(RecordFromFive(8, 8).outcome, Outcome::kCollided);
  const Trajectory late = RecordFromFive(100, 100);
  EXPECT_EQ(late.outcome, Outcome::kHalted);
  EXPECT_EQ(late.num_steps(), 4);
  EXPECT_EQ(RecordFromFive(5, 100).num_steps(), 0);
}

TEST(RecordTest, LeavesOutAControlThatThePlantRefused) {
  const Trajectory refused = RecordFromFive(100, 100, 1);
  EXPECT_EQ(refused.outcome, Outcome::kHalted);
  EXPECT_EQ(States(refused), (std::vector<double>{5, 6}));
  EXPECT_EQ(refused.controls, Matrix::Ones(1, 1));
}

}  // namespace
}  // namespace dfr::core
