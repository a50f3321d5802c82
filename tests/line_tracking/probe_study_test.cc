#include "probe_study.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "dfr/core/random.h"
#include "tests/line_tracking/scene.h"
#include "tests/sim_line_tracking/perfect_calibration.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// Compares each probe with its effect: with exact states all signs are correct, and the fine probes
// are 50 times shorter.
TEST(ProbeStudyTest, ExactStatesHaveNoWrongSigns) {
  LineTrialRunner runner(
      LineModel::Fit(Demonstrate(FromTruth(), test::PerfectCalibration(FromTruth()), 20, 50, 1),
                     {.hidden = {8}, .gammas = {0.05}}),
      {"dfr", "dfr-fine"}, FromTruth(), test::PerfectCalibration(FromTruth()));
  std::array<double, 2> sizes{};
  for (const int method : {0, 1}) {
    ProbeStudy study(runner.model(), runner.plant());
    EXPECT_TRUE(std::isnan(study.right_sign()));
    for (std::uint64_t seed = 0; seed < 6; ++seed)
      runner.RunObserved(method, seed, seed, &study, 100);
    ASSERT_GT(study.probes(), 20);
    EXPECT_EQ(study.right_sign(), 1.0);
    EXPECT_EQ(study.error_um(), 0.0);
    EXPECT_GE(study.recoveries(), study.ended());
    EXPECT_GE(study.recoveries(), study.out_of_reach());
    sizes[static_cast<std::size_t>(method)] = study.size_um();
  }
  // The ratio is not exactly 50, because the states differ.
  EXPECT_GT(sizes[0], 20.0 * sizes[1]);
}

}  // namespace
}  // namespace dfr::apps::line_tracking
