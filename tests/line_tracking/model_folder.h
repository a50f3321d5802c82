#pragma once

#include "dfr/control/rollout.h"
#include "dfr/core/random.h"
#include "tests/line_tracking/demonstrations.h"
#include "tests/support/temp_folder.h"

namespace dfr::apps::line_tracking {

/// A folder with model and calibration, removed with this object.
class ModelFolder : public test::TempFolder {
 public:
  ModelFolder() {
    line_task::LineCalibration known = test::PerfectCalibration(Disturbed());
    known.provenance.origin = core::Origin::kSimulated;
    known.Save(path / "calibration.dfr");
    SmallModel(0.5).Save(path / "model");
  }

  [[nodiscard]] line_task::LineCalibration Calibration() const {
    return line_task::LineCalibration::Load(path / "calibration.dfr");
  }
};

/// Returns the folder that all tests of a program share.
inline const ModelFolder& Data() {
  static const ModelFolder folder;
  return folder;
}

/// Outcome of an episode.
struct Ending {
  core::Outcome outcome;
  control::HaltCause cause;
  bool operator==(const Ending&) const = default;
};

inline Ending Episode(core::Plant& plant, control::Controller& controller, std::uint64_t seed) {
  const control::RolloutResult result = control::Rollout(
      plant, controller, {.plant_seed = core::DeriveSeed(seed, {0}), .controller_seed = seed});
  return {result.outcome, result.halt_cause};
}

}  // namespace dfr::apps::line_tracking
