#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/rollout_video.h"
#include "apps/study/pictures/camera.h"
#include "apps/study/planar/task.h"
#include "dfr/core/plant.h"
#include "dfr/experiment/disturbed_plant.h"
#include "dfr/safety/task_model.h"
#include "dfr/sim/gallery/gallery.h"
#include "dfr/study/learned_model.h"

namespace dfr::study {

/// A variant of a task's world.
struct Variant {
  std::string name;  ///< "" for the demonstrated variant.
  std::function<std::unique_ptr<core::SimulatedPlant>()> make;
};

/// Pictures of a plant, and their size.
struct Drawing {
  int width = 0;
  int height = 0;
  apps::RolloutVideoRecorder::Draw draw;
};

/// A task of any program, for tables of studies.
struct Task {
  std::string name;
  std::vector<Variant> variants;  ///< The demonstrated variant comes first.
  double length = 1.0;            ///< Length by which observation noise is scaled.
  safety::ControllerOptions controllers = {};
  /// Learns the task's models from this number of demonstrations. The learned policy is a weak one,
  /// of 8 units and 10 epochs, except in line tracking, whose demonstrations are open-loop.
  std::function<LearnedModel(int demonstrations, std::uint64_t seed)> learn = {};
  /// Continues the undisturbed plant after a halt. Empty: nothing moves.
  std::function<void(core::SimulatedPlant&)> settle = {};
  /// Draws the undisturbed plant, which must outlive the drawing. Empty: no pictures.
  std::function<Drawing(const core::SimulatedPlant&)> draw = {};
  /// The gallery's task for guards with default settings; null for other tasks.
  const sim::GalleryTask* small = nullptr;
  std::optional<planar::Task> plane =
      {};  ///< The planar task for planar::Methods; empty for other tasks.
};

/// Returns "pusher", "planar-corridor", "planar-push", the gallery's tasks and "line-tracking".
/// MakeTask() also accepts "planar-push-weak", planar-push with a worse learner.
[[nodiscard]] std::vector<std::string> TaskNames();
/// @throws std::invalid_argument listing the valid names.
[[nodiscard]] Task MakeTask(const std::string& name);
/// Expands task names of a command line, each once: names, "all", or the gallery's groups
/// "gallery", "design" or "held-out".
/// @throws std::invalid_argument listing the valid names.
[[nodiscard]] std::vector<std::string> SelectTasks(const std::vector<std::string>& words);

/// Differences between the world of a test and the demonstrated world.
struct Condition {
  std::string name;
  std::string variant = {};  ///< Runs the condition only in tasks with that variant.
  experiment::DisturbanceOptions disturbance = {};
  double noise = 0.0;        ///< Standard deviation of observation noise, in units of Task::length.
  Nuisances nuisances = {};  ///< Disturbances of the pictures that guards receive.
  int demonstrations = 0;    ///< Number of demonstrations; 0: the study's number.
  bool on_request = false;   ///< Excluded from studies of all conditions.

  /// Returns the number of demonstrations in a study with `count`.
  [[nodiscard]] int CountOr(int count) const noexcept {
    return demonstrations > 0 ? demonstrations : count;
  }
};

/// Returns all conditions, "as demonstrated" first.
[[nodiscard]] const std::vector<Condition>& Conditions();

}  // namespace dfr::study
