#include "dfr/experiment/disturbed_plant.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "tests/control/analytic.h"
#include "tests/support/no_alloc.h"

namespace dfr::experiment {
namespace {

std::unique_ptr<core::SimulatedPlant> Point(int dim) {
  return std::make_unique<test::PointPlant>(
      test::PointPlantOptions{.start = std::vector<double>(static_cast<std::size_t>(dim), 0.0)});
}

std::vector<double> After(core::SimulatedPlant& plant, const std::vector<double>& u) {
  EXPECT_EQ(plant.Apply(u), core::PlantStatus::kOk);
  std::vector<double> x(u.size());
  plant.Observe(x);
  return x;
}

TEST(DisturbedPlantTest, WithoutDisturbanceItIsThePlant) {
  DisturbedPlant plant(Point(3), {});
  plant.Reset(1);
  const std::vector<double> u = {0.1, -0.2, 0.3};
  EXPECT_EQ(After(plant, u), u);
}

TEST(DisturbedPlantTest, ControlsTakeEffectLate) {
  DisturbedPlant plant(Point(1), {.control_delay = 2});
  for (const std::uint64_t seed : {1, 2}) {
    plant.Reset(seed);  // discards pending controls
    EXPECT_EQ(After(plant, {1.0})[0], 0.0);
    EXPECT_EQ(After(plant, {2.0})[0], 0.0);
    EXPECT_EQ(After(plant, {4.0})[0], 1.0);
    EXPECT_EQ(After(plant, {0.0})[0], 3.0);
  }
}

TEST(DisturbedPlantTest, ObservationsAreLate) {
  DisturbedPlant plant(Point(1), {.observation_delay = 2});
  plant.Reset(1);
  EXPECT_EQ(After(plant, {1.0})[0], 0.0);
  EXPECT_EQ(After(plant, {2.0})[0], 0.0);
  EXPECT_EQ(After(plant, {4.0})[0], 1.0);
  const auto clone = plant.Clone();
  EXPECT_EQ(After(plant, {8.0})[0], 3.0);
  EXPECT_EQ(After(*clone, {8.0})[0], 3.0);
  EXPECT_EQ(After(plant, {0.0})[0], 7.0);
}

TEST(DisturbedPlantTest, ControlsAndObservationsAreLostAtTheirRates) {
  constexpr int kControls = 4000;
  EXPECT_NO_THROW(DisturbedPlant(Point(1), {.dropped = 1.0, .missing = 1.0}));
  DisturbedPlant dropping(Point(1), {.dropped = 0.3});
  dropping.Reset(1);
  double x = 0.0;
  for (int i = 0; i < kControls; ++i) x = After(dropping, {1.0})[0];
  EXPECT_NEAR(x / kControls, 0.7, 4.0 * std::sqrt(0.3 * 0.7 / kControls));

  for (const int delay : {0, 3}) {
    DisturbedPlant losing(Point(1), {.observation_delay = delay, .missing = 0.2});
    losing.Reset(1);
    int repeated = 0;
    double before = 0.0;  // the start state
    for (int i = 0; i < kControls; ++i) {
      const double seen = After(losing, {1.0})[0];
      repeated += seen == before ? 1 : 0;
      if (seen != before) {
        EXPECT_EQ(seen, std::max(0, i + 1 - delay));  // no observation is older than the delay
      }
      before = seen;
    }
    EXPECT_NEAR(static_cast<double>(repeated) / kControls, 0.2,
                4.0 * std::sqrt(0.2 * 0.8 / kControls) + 3.0 / kControls);
  }
}

TEST(DisturbedPlantTest, RotationKeepsTheNormAndScaleChangesIt) {
  for (const int dim : {1, 2, 7}) {
    for (std::uint64_t seed = 0; seed < 5; ++seed) {
      std::vector<double> u(static_cast<std::size_t>(dim), 0.3);
      DisturbedPlant turned(Point(dim), {.rotation_sd = 0.7});
      turned.Reset(seed);
      EXPECT_NEAR(test::Norm(After(turned, u)), test::Norm(u), 1e-14);
      DisturbedPlant scaled(Point(dim), {.scale_sd = 0.2});
      scaled.Reset(seed);
      const auto x = After(scaled, u);
      for (std::size_t i = 1; i < x.size(); ++i) EXPECT_NEAR(x[i], x[0], 1e-15);
      EXPECT_NE(x[0], u[0]);
    }
  }
}

TEST(DisturbedPlantTest, AnEpisodeHasOneRotationOfTheGivenDeviation) {
  DisturbedPlant plant(Point(2), {.rotation_sd = 0.3});
  double square = 0.0;
  constexpr int kEpisodes = 2000;
  for (int e = 0; e < kEpisodes; ++e) {
    plant.Reset(static_cast<std::uint64_t>(e));
    const auto first = After(plant, {1.0, 0.0});
    const auto second = After(plant, {1.0, 0.0});
    EXPECT_NEAR(second[1], 2.0 * first[1], 1e-14);
    square += std::pow(std::atan2(first[1], first[0]), 2);
  }
  // The standard deviation of a sample variance is 0.09 sqrt(2 / 2000) = 0.003. The limit is three
  // times as large.
  EXPECT_NEAR(square / kEpisodes, 0.09, 0.009);
}

TEST(DisturbedPlantTest, NoiseIsOnObservationsOnlyAndFixedBetweenControls) {
  DisturbedPlant plant(Point(2), {.observation_noise = 0.1});
  plant.Reset(3);
  std::vector<double> a(2), b(2);
  plant.Observe(a);
  plant.Observe(b);
  EXPECT_EQ(a, b) << "without a control the observation stays the same";
  EXPECT_GT(test::Norm(a), 0.0);
  double square = 0.0;
  constexpr int kLooks = 4000;
  for (int i = 0; i < kLooks; ++i) {
    const auto x = After(plant, {0.0, 0.0});
    square += x[0] * x[0] + x[1] * x[1];
  }
  // The point does not move: noise does not accumulate. The standard deviation is 0.01 sqrt(2 /
  // 8000) = 0.00016. The limit is three times as large.
  EXPECT_NEAR(square / (2 * kLooks), 0.01, 0.0005);
}

TEST(DisturbedPlantTest, ACloneContinuesIdentically) {
  DisturbedPlant plant(Point(3), {0.5, 0.2, 0.1, 0.05, 0.02});
  plant.Reset(9);
  (void)After(plant, {0.1, 0.2, 0.3});
  const auto clone = plant.Clone();
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(After(plant, {0.1, 0.0, -0.1}), After(*clone, {0.1, 0.0, -0.1}));
  }
}

TEST(DisturbedPlantTest, ApplyNeverAllocatesAndErrorsAreNamed) {
  DisturbedPlant plant(Point(3), {0.5, 0.2, 0.1, 0.05, 0.02});
  plant.Reset(1);
  const std::vector<double> u(3, 0.1);
  {
    const test::NoAlloc guard;
    EXPECT_EQ(plant.Apply(u), core::PlantStatus::kOk);
  }
  EXPECT_EQ(plant.Apply(std::vector<double>(2, 0.0)), core::PlantStatus::kRefused);
  EXPECT_THROW(DisturbedPlant(Point(2), {.bias = -1.0}), std::invalid_argument);
  EXPECT_THROW(DisturbedPlant(nullptr, {}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::experiment
