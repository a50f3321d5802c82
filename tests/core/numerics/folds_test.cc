#include "dfr/core/numerics/folds.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <span>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::core {
namespace {

// `each` demonstrations of each of `goals` paths from one start. The goals alternate, as if a
// supervisor cycled through them.
std::vector<Matrix> Cycle(int goals, int each, std::uint64_t seed) {
  Random random(seed);
  std::vector<Matrix> demonstrations;
  for (int d = 0; d < goals * each; ++d) {
    Matrix states(12 + d % 3, 2);
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      const double share = static_cast<double>(t) / static_cast<double>(states.rows() - 1);
      states.row(t) << 10.0 * share + 0.3 * random.Normal(),
          20.0 * share * (d % goals) + 0.3 * random.Normal();
    }
    demonstrations.push_back(states);
  }
  return demonstrations;
}

template <typename T>
std::vector<T> Permuted(const std::vector<T>& items, const std::vector<std::size_t>& order) {
  std::vector<T> permuted;
  permuted.reserve(items.size());
  for (const std::size_t i : order) permuted.push_back(items[i]);
  return permuted;
}

std::vector<std::size_t> Permutation(std::size_t n, std::uint64_t seed) {
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), std::size_t{0});
  Random(seed).Shuffle(std::span(order));
  return order;
}

TEST(FoldsTest, EachDemonstrationIsInOneFoldAndSizesDifferByOneAtMost) {
  for (const int count : {5, 7, 23, 60}) {
    const auto demonstrations = Cycle(1, count, 1);
    for (const Folds& folds :
         {StratifiedFolds(demonstrations, 5), ContiguousFolds(demonstrations.size(), 5)}) {
      std::vector<std::size_t> all;
      for (const auto& fold : folds) {
        EXPECT_GE(static_cast<int>(fold.size()), count / 5);
        EXPECT_LE(static_cast<int>(fold.size()), (count + 4) / 5);
        all.insert(all.end(), fold.begin(), fold.end());
      }
      std::sort(all.begin(), all.end());
      std::vector<std::size_t> every(demonstrations.size());
      std::iota(every.begin(), every.end(), std::size_t{0});
      EXPECT_EQ(all, every);
    }
  }
}

// Returns the entries of each matrix, because matrices of different sizes cannot be compared.
std::vector<std::vector<double>> Entries(const std::vector<Matrix>& matrices) {
  std::vector<std::vector<double>> entries;
  entries.reserve(matrices.size());
  for (const Matrix& matrix : matrices) {
    entries.emplace_back(matrix.data(), matrix.data() + matrix.size());
  }
  return entries;
}

// Fits rely on this property: in any order of input, the same demonstrations share a fold, in the
// same order.
TEST(FoldsTest, TheOrderOfDemonstrationsChangesNothing) {
  for (const int goals : {1, 5}) {
    const auto demonstrations = Cycle(goals, 12, 2);
    const auto folds_of = [&](const std::vector<Matrix>& items, std::uint64_t seed) {
      std::vector<std::vector<std::vector<double>>> content;
      content.reserve(4);
      for (const auto& fold : StratifiedFolds(items, 4, seed)) {
        content.push_back(Entries(Permuted(items, fold)));
      }
      return content;
    };
    const auto expected = folds_of(demonstrations, 7);
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      const auto permuted = Permuted(demonstrations, Permutation(demonstrations.size(), seed));
      ASSERT_EQ(folds_of(permuted, 7), expected) << seed;
      ASSERT_EQ(Entries(Permuted(permuted, DeterministicOrder(permuted))),
                Entries(Permuted(demonstrations, DeterministicOrder(demonstrations))))
          << seed;
    }
    EXPECT_NE(folds_of(demonstrations, 8), expected) << "another seed, other folds";
  }
}

// Another compiler or processor may round a recorded state differently.
TEST(FoldsTest, RoundingChangesNothing) {
  Random random(5);
  const auto demonstrations = Cycle(5, 12, 4);
  auto rounded = demonstrations;
  for (Matrix& states : rounded) {
    for (double& x : states.reshaped()) x *= 1.0 + 1e-15 * random.Normal();
  }
  EXPECT_EQ(DeterministicOrder(rounded, 3), DeterministicOrder(demonstrations, 3));
  EXPECT_EQ(StratifiedFolds(rounded, 5, 3), StratifiedFolds(demonstrations, 5, 3));
}

// All episodes start at the same state, to single precision.
TEST(FoldsTest, DistinguishesDifferencesInDoublePrecision) {
  std::vector<Matrix> demonstrations;
  for (int d = 0; d < 6; ++d) demonstrations.push_back(Matrix::Constant(2, 1, 1.0 + 1e-12 * d));
  const std::vector<Matrix> reversed(demonstrations.rbegin(), demonstrations.rend());
  EXPECT_EQ(Entries(Permuted(reversed, DeterministicOrder(reversed))),
            Entries(Permuted(demonstrations, DeterministicOrder(demonstrations))));
}

// Split conformal prediction assumes that the first demonstrations are a random sample. Each rank
// is then equally often among the first demonstrations, and a further demonstration exceeds all of
// them as often as in a random order.
TEST(FoldsTest, TheFirstAreARandomSample) {
  constexpr int kCount = 20;
  constexpr int kHeldOut = 10;
  constexpr int kRuns = 2000;
  std::vector<int> first(kCount, 0);
  int beyond = 0;
  for (std::uint64_t run = 0; run < kRuns; ++run) {
    Random random(run);
    std::vector<Matrix> demonstrations;
    demonstrations.reserve(kCount);
    for (int d = 0; d < kCount; ++d) {
      demonstrations.push_back(Matrix::Constant(1, 1, random.Normal()));
    }
    const std::vector<std::size_t> order = DeterministicOrder(demonstrations);
    double largest = 0.0;
    for (std::size_t i = 0; i < kHeldOut; ++i) {
      const double value = demonstrations[order[i]](0, 0);
      largest = std::max(largest, std::abs(value));
      ++first[static_cast<std::size_t>(
          std::count_if(demonstrations.begin(), demonstrations.end(),
                        [&](const Matrix& other) { return other(0, 0) < value; }))];
    }
    beyond += std::abs(random.Normal()) > largest ? 1 : 0;
  }
  // Binomial(2000, 1/2): standard deviation 22.4. The limit for 20 ranks is five standard
  // deviations.
  EXPECT_THAT(first, testing::Each(testing::AllOf(testing::Gt(888), testing::Lt(1112))));
  // Binomial(2000, 1/11): mean 182, standard deviation 12.9. The limit is four standard deviations.
  EXPECT_NEAR(beyond, 182, 52);
}

TEST(FoldsTest, NoFoldHoldsAWholeCluster) {
  // d mod 5 would put each goal into a separate fold. Instead each fold has two of the ten
  // demonstrations of each goal, or one more or less if a demonstration is far from its goal's
  // other demonstrations.
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const auto demonstrations = Cycle(5, 10, seed);
    for (const auto& fold : StratifiedFolds(demonstrations, 5, seed)) {
      std::vector<int> of_goal(5, 0);
      for (const std::size_t d : fold) ++of_goal[d % 5];
      EXPECT_THAT(of_goal, testing::Each(testing::AllOf(testing::Ge(1), testing::Le(3)))) << seed;
    }
  }
}

TEST(FoldsTest, ControlsDistinguishDemonstrationsOfEqualStates) {
  Random random(3);
  std::vector<Trajectory> demonstrations(6);
  for (auto& d : demonstrations) {
    d.states = Matrix::Ones(3, 1);
    d.controls = Matrix::Constant(2, 1, random.Normal());
  }
  std::vector<Trajectory> reversed(demonstrations.rbegin(), demonstrations.rend());
  const auto controls = [](const std::vector<Trajectory>& items) {
    std::vector<Matrix> all;
    all.reserve(items.size());
    for (const auto& d : items) all.push_back(d.controls);
    return all;
  };
  EXPECT_EQ(controls(InDeterministicOrder(demonstrations)),
            controls(InDeterministicOrder(reversed)));
}

TEST(FoldsTest, ContiguousFoldsAreStretchesOfTheRecording) {
  EXPECT_EQ(ContiguousFolds(5, 2), (Folds{{0, 1, 2}, {3, 4}}));
  EXPECT_EQ(Others(ContiguousFolds(5, 2), 0, std::vector<std::size_t>{4, 2, 0, 1, 3}),
            (std::vector<std::size_t>{4, 3}));
  EXPECT_EQ(WithoutFold(std::vector{'a', 'b', 'c', 'd', 'e'}, ContiguousFolds(5, 2), 0),
            (std::vector{'d', 'e'}));
}

TEST(FoldsTest, InvalidArgumentsAreRefused) {
  const auto demonstrations = Cycle(1, 3, 1);
  EXPECT_THROW((void)StratifiedFolds(demonstrations, 1), std::invalid_argument);
  EXPECT_THROW((void)StratifiedFolds(demonstrations, 4), std::invalid_argument);
  EXPECT_THROW((void)ContiguousFolds(3, 4), std::invalid_argument);
  auto wrong = demonstrations;
  wrong[1].resize(4, 3);
  EXPECT_THROW((void)StratifiedFolds(wrong, 2), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::core
