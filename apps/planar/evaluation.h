#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "apps/planar/methods.h"
#include "apps/planar/task.h"
#include "dfr/control/disturbed_plant.h"
#include "dfr/control/rollout.h"
#include "dfr/experiment/paired_evaluation.h"

namespace dfr::apps::planar {

/// A comparison of methods on one planar task. Every trial has its own demonstrations and learner;
/// methods share its start states.
struct PlanarStudy {
  std::string task = "corridor";
  experiment::EvaluationPlan plan;
  MethodOptions methods;
  control::DisturbanceOptions disturbance;  ///< At test time; demonstrations are undisturbed.
  int threads = 0;
};

struct PlanarResult {
  std::vector<experiment::UnitResult> units;
  /// [method]: controls of each recovery, in order of trials and episodes.
  std::vector<std::vector<int>> recovery_lengths;
};

[[nodiscard]] PlanarResult RunStudy(const PlanarStudy& study);

}  // namespace dfr::apps::planar
