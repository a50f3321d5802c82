#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "tests/sim_line_tracking/perfect_calibration.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;
using test::Apply;
using test::Observe;
using test::PerfectCalibration;
using test::State;

// The requirement on vision: 95 % of errors below 0.3 mm, and never the wrong side, over poses of
// tool and platform, light and blur. The side is judged from 0.3 mm on, because smaller distances
// are within the errors. Takes seconds: quantiles and rare wrong sides need hundreds of pictures.
TEST(LineTrackingPlantTest, VisionIsAccurateOverPosesLightAndBlur) {
  std::vector<double> distance_errors;
  std::vector<double> tip_errors;
  int wrong_sides = 0;
  int not_seen = 0;
  int looks = 0;
  for (const double blur : {0.0, 1.0, 2.0}) {
    for (const double light_change : {0.0, 0.5}) {
      LineTrackingOptions options;
      options.disturbance.wave = Wave::kRandom;
      options.endoscope.blur_px = blur;
      options.endoscope.light_change = light_change;
      options.endoscope.glare = 60.0;
      const line_task::LineCalibration known = PerfectCalibration(options);
      LineTrackingPlant plant(options, &known);
      core::Random random(10);
      for (std::uint64_t seed = 0; seed < 5; ++seed) {
        plant.Reset(seed);
        const core::Matrix controls = plant.OpenLoopControls(25, 2e-3);
        for (int i = 0; i < 25; ++i) {
          const PlantStatus status = Apply(plant, controls(i, 0) + 0.2 * random.Normal(),
                                           controls(i, 1) + 0.3 * random.Normal());
          ASSERT_EQ(status, PlantStatus::kOk);
          if (std::abs(plant.truth().distance_m) > 0.006) break;
          ++looks;
          const vision::LineObservation& seen = plant.last_observation();
          if (!seen.seen()) {
            ++not_seen;
            continue;
          }
          const LineTrackingTruth truth = plant.truth();
          const State x = Observe(plant);
          distance_errors.push_back(std::abs(seen.distance_m - truth.distance_m));
          tip_errors.push_back(
              std::hypot(1e-3 * x[0] - truth.tip_m.x(), 1e-3 * x[1] - truth.tip_m.y()));
          if (std::abs(truth.distance_m) > 3e-4 && seen.distance_m * truth.distance_m < 0) {
            ++wrong_sides;
          }
        }
      }
    }
  }
  const auto quantile95 = [](std::vector<double>& errors) {
    std::sort(errors.begin(), errors.end());
    return errors[errors.size() * 95 / 100];
  };
  ASSERT_GT(distance_errors.size(), 500U);
  EXPECT_LT(quantile95(distance_errors), 3e-4);
  EXPECT_LT(quantile95(tip_errors), 3e-4);
  EXPECT_EQ(wrong_sides, 0);
  EXPECT_LT(not_seen, looks / 20);
}

}  // namespace
}  // namespace dfr::sim
