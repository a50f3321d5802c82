#pragma once

#include "model.h"
#include "tests/line_tracking/scene.h"
#include "tests/sim_line_tracking/perfect_calibration.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {

/// Returns ten demonstrations with exact states, drawn once per program.
inline const imitation::DemonstrationSet& Demonstrations() {
  static const imitation::DemonstrationSet set =
      Demonstrate(FromTruth(), test::PerfectCalibration(FromTruth()), 10, 50, 1);
  return set;
}

/// Returns a small model fitted to Demonstrations().
inline LineModel SmallModel(double gamma) {
  LineModelOptions options;
  options.hidden = {8};
  options.gammas = {gamma};
  return LineModel::Fit(Demonstrations(), options);
}

}  // namespace dfr::apps::line_tracking
