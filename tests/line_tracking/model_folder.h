#pragma once

#include <unistd.h>

#include <filesystem>
#include <string>

#include "dfr/control/rollout.h"
#include "dfr/core/random.h"
#include "model.h"
#include "tests/line_tracking/scene.h"
#include "tests/sim_line_tracking/perfect_calibration.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {

/// A folder with model and calibration, removed with this object.
class ModelFolder {
 public:
  ModelFolder() {
    std::filesystem::create_directories(path);
    line_task::LineCalibration known = test::PerfectCalibration(Disturbed());
    known.provenance.origin = core::Origin::kSimulated;
    known.Save(path / "calibration.dfr");
    LineModelOptions options;
    options.hidden = {8};
    options.gammas = {0.5};
    LineModel::Fit(Demonstrate(FromTruth(), known, 20, 50, 1), options).Save(path / "model");
  }
  ~ModelFolder() { std::filesystem::remove_all(path); }
  ModelFolder(const ModelFolder&) = delete;
  ModelFolder& operator=(const ModelFolder&) = delete;

  [[nodiscard]] line_task::LineCalibration Calibration() const {
    return line_task::LineCalibration::Load(path / "calibration.dfr");
  }

  const std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("dfr-model-" + std::to_string(getpid()));
};

/// One folder for all tests of a program.
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
