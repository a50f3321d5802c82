#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/rollout_video.h"
#include "apps/study/planar/task.h"
#include "dfr/core/plant.h"
#include "dfr/experiment/disturbed_plant.h"
#include "dfr/safety/task_model.h"
#include "dfr/sim/gallery/gallery.h"
#include "dfr/study/learned_model.h"

namespace dfr::study {

/// A world to be run in.
struct Variant {
  std::string name;  ///< "" for the one that was demonstrated in.
  std::function<std::unique_ptr<core::SimulatedPlant>()> make;
};

/// Pictures of a plant, and their size.
struct Drawing {
  int width = 0;
  int height = 0;
  apps::RolloutVideoRecorder::Draw draw;
};

/// A task of any of the programs, as the stress table needs it.
struct Task {
  std::string name;
  std::vector<Variant> variants;  ///< The demonstrated one first.
  double length = 1.0;            ///< What noise of observations is a share of.
  safety::ControllerOptions controllers = {};
  /// Learns the task's models from so many demonstrations; the learned policy is a weak one, of 8
  /// units and 10 epochs, but for line tracking, whose demonstrations are open-loop.
  std::function<LearnedModel(int demonstrations, std::uint64_t seed)> learn = {};
  /// What happens in the undisturbed plant after a halt. Empty: nothing.
  std::function<void(core::SimulatedPlant&)> aftermath = {};
  /// Draws the undisturbed plant, which has to outlive the drawing. Empty: there are no pictures.
  std::function<Drawing(const core::SimulatedPlant&)> draw = {};
  /// What guards at their default settings are tried on; null of tasks outside the gallery.
  const sim::GalleryTask* small = nullptr;
  std::optional<planar::Task> plane = {};  ///< What planar::Methods is made for; empty elsewhere.
};

/// "pusher", "planar-corridor", "planar-push", the gallery's tasks, "line-tracking". MakeTask()
/// also knows "planar-push-weak", planar-push with a worse learner of its own.
[[nodiscard]] std::vector<std::string> TaskNames();
/// @throws std::invalid_argument naming the tasks there are.
[[nodiscard]] Task MakeTask(const std::string& name);
/// The tasks that a command line means, each once: names, "all", or of the gallery's tasks
/// "gallery", "design" or "judgement".
/// @throws std::invalid_argument naming the tasks there are.
[[nodiscard]] std::vector<std::string> SelectTasks(const std::vector<std::string>& words);

/// How the world differs from the demonstrated one.
struct Condition {
  std::string name;
  std::string variant = {};  ///< Runs where a task has that variant.
  experiment::DisturbanceOptions disturbance = {};
  double noise = 0.0;       ///< Standard deviation in observations, in Task::length.
  int demonstrations = 0;   ///< In place of the study's, unless 0.
  bool on_request = false;  ///< Not one of those that a study of all conditions runs.
};

/// All conditions, "as demonstrated" first.
[[nodiscard]] const std::vector<Condition>& Conditions();

}  // namespace dfr::study
