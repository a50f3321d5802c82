#include "dfr/reduction/action_directions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/reduction/choose_components.h"
#include "dfr/reduction/slow_features.h"
#include "tests/support/message_of.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::HasSubstr;

constexpr int kTask = 3;
constexpr int kNuisances = 4;
constexpr int kEntries = 8;  // The last source is noise.

// A task [x, y, gap], nuisances that are constant in each demonstration and slower than the task,
// and noise, mixed by a random matrix. Actions move (x, y): y towards the gap.
struct Mixture {
  Matrix mixing = Matrix(kEntries, kEntries);  // One row per score.
  std::vector<core::Trajectory> demonstrations;
};

Mixture MakeMixture(int count, std::uint64_t seed) {
  core::Random random(seed);
  Mixture mixture;
  for (double& value : mixture.mixing.reshaped()) value = random.Normal();
  for (int d = 0; d < count; ++d) {
    Eigen::RowVectorXd source(kEntries);
    for (double& value : source) value = random.Uniform(-1.0, 1.0);
    source.segment(kTask, kNuisances) *= 3.0;
    source[0] = 0.0;
    core::Trajectory one;
    one.states.resize(31, kEntries);
    one.controls.resize(30, 2);
    for (int t = 0; t <= 30; ++t) {
      source[kEntries - 1] = random.Normal();
      Eigen::RowVectorXd seen = source;
      for (double& value : seen.head(kTask)) value += 0.05 * random.Normal();
      for (double& value : seen.segment(kTask, kNuisances)) value += 0.05 * random.Normal();
      one.states.row(t) = seen * mixture.mixing.transpose();
      if (t == 30) break;
      one.controls.row(t) << 0.05, 0.2 * (source[2] - source[1]) + 0.01 * random.Normal();
      source.head(2) += one.controls.row(t);
    }
    mixture.demonstrations.push_back(std::move(one));
  }
  return mixture;
}

// One block of all columns.
const std::vector<std::vector<int>> kWhole = {{0, 1, 2, 3, 4, 5, 6, 7}};

// Returns the fraction of the first component's squared source weights that belongs to the task.
double ShareOfTask(const Matrix& weights, const Mixture& mixture) {
  const Eigen::RowVectorXd followed = (weights * mixture.mixing).row(0);
  return followed.head(kTask).squaredNorm() / followed.squaredNorm();
}

TEST(ActionDirectionsTest, TakesTheTaskBeforeASlowNuisance) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const Mixture mixture = MakeMixture(30, seed);
    std::vector<Matrix> states;
    for (const core::Trajectory& d : mixture.demonstrations) states.push_back(d.states);
    const ActionDirections directions(mixture.demonstrations, kWhole);
    EXPECT_GT(ShareOfTask(directions.Weights(0, 1), mixture), 0.95);
    EXPECT_LT(ShareOfTask(FitSlowFeatures(states).directions, mixture), 0.2);
  }
}

// Any basis of the subspace represents the same components. The basis of slow features is
// uncorrelated.
TEST(ActionDirectionsTest, ComponentsAreSlowFeaturesSlowestFirst) {
  const Mixture mixture = MakeMixture(30, 4);
  const Matrix weights = ActionDirections(mixture.demonstrations, kWhole).Weights(0, 3);
  ASSERT_EQ(weights.rows(), 3);
  std::vector<Matrix> components;
  for (const core::Trajectory& d : mixture.demonstrations) {
    components.push_back(d.states * weights.transpose());
  }
  const SlowFeatures slow = FitSlowFeatures(components);
  EXPECT_GT(slow.slowness[0], slow.slowness[1]);
  const Matrix unit = slow.directions.rowwise().normalized().cwiseAbs();
  EXPECT_LT((unit - Matrix::Identity(3, 3)).norm(), 0.05);
  EXPECT_EQ(ActionDirections(mixture.demonstrations, kWhole).Weights(0, 99).rows(), kEntries);
}

TEST(ActionDirectionsTest, DoesNotDependOnTheOrderOfDemonstrations) {
  Mixture mixture = MakeMixture(12, 5);
  const Matrix before = ActionDirections(mixture.demonstrations, kWhole).Weights(0, 3);
  std::swap(mixture.demonstrations[0], mixture.demonstrations[7]);
  std::swap(mixture.demonstrations[3], mixture.demonstrations[11]);
  EXPECT_EQ(ActionDirections(mixture.demonstrations, kWhole).Weights(0, 3), before);
}

TEST(ActionDirectionsTest, ABlockNeedNotExplainWhatOtherColumnsExplain) {
  Mixture mixture = MakeMixture(30, 6);
  // A column beside the block explains one action. The block's first entry explains the other.
  core::Random random(12);
  for (core::Trajectory& d : mixture.demonstrations) {
    Matrix states(d.states.rows(), 4);
    for (double& value : states.reshaped()) value = random.Uniform(-1.0, 1.0);
    d.states = states;
    d.controls.col(0) = states.col(2).head(30);
    d.controls.col(1) = states.col(0).head(30);
    d.states.col(1) = d.states.col(2);  // Repeats that column.
    d.states.col(3).setOnes();          // Has no effect.
  }
  const std::vector<std::vector<int>> blocks = {{0, 1}};
  const auto of_x = [&](std::span<const core::Trajectory> demonstrations) {
    const Matrix weights = ActionDirections(demonstrations, blocks).Weights(0, 1).cwiseAbs();
    return weights(0, 0) / weights.sum();
  };
  const double with = of_x(mixture.demonstrations);
  for (core::Trajectory& d : mixture.demonstrations)
    d.states.conservativeResize(Eigen::NoChange, 3);
  EXPECT_EQ(of_x(mixture.demonstrations), with);
  EXPECT_GT(with, 0.9);
  for (core::Trajectory& d : mixture.demonstrations)
    d.states.conservativeResize(Eigen::NoChange, 2);
  EXPECT_LT(of_x(mixture.demonstrations), 0.9);
}

TEST(ActionDirectionsTest, ExplainLeftOutDemonstrationsBetterThanSlowFeatures) {
  const Mixture mixture = MakeMixture(30, 7);
  const auto explained = [&](bool by_actions) {
    return ChooseComponents(mixture.demonstrations,
                            {.candidates = {3}, .blocks = kWhole, .by_actions = by_actions})
        .table.at(0)
        .explained;
  };
  EXPECT_GT(explained(true), 0.8);
  EXPECT_LT(explained(false), 0.5);
}

// Directions are fitted without the actions that they are judged by.
TEST(ActionDirectionsTest, DoNotExplainRandomActionsOfLeftOutDemonstrations) {
  Mixture mixture = MakeMixture(12, 8);
  core::Random random(9);
  for (core::Trajectory& d : mixture.demonstrations) {
    d.controls.rowwise() = Eigen::RowVector2d(random.Normal(), random.Normal());
  }
  const ComponentsChoice choice = ChooseComponents(
      mixture.demonstrations, {.candidates = {1, 2, 3}, .blocks = kWhole, .by_actions = true});
  for (const ComponentsScore& row : choice.table) EXPECT_LT(row.explained, 0.2);
}

TEST(ActionDirectionsTest, RefusesABlockThatDoesNotVary) {
  Mixture mixture = MakeMixture(4, 10);
  for (core::Trajectory& d : mixture.demonstrations) d.states.col(2).setOnes();
  const std::vector<std::vector<int>> blocks = {{2}};
  EXPECT_THAT(
      test::MessageOf([&] { static_cast<void>(ActionDirections(mixture.demonstrations, blocks)); }),
      HasSubstr("all rows are equal"));
}

// Constant actions depend on nothing. All components together span the same space as slow
// features.
TEST(ActionDirectionsTest, AConstantActionLeavesSlowFeatures) {
  Mixture mixture = MakeMixture(12, 11);
  std::vector<Matrix> states;
  for (core::Trajectory& d : mixture.demonstrations) {
    d.controls.setOnes();
    states.push_back(d.states);
  }
  const Matrix weights = ActionDirections(mixture.demonstrations, kWhole).Weights(0, kEntries);
  EXPECT_LT((weights - FitSlowFeatures(states).directions).norm(), 1e-6 * weights.norm());
}

}  // namespace
}  // namespace dfr::reduction
