#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "apps/planar/methods.h"
#include "apps/planar/task.h"
#include "dfr/control/disturbed_plant.h"
#include "dfr/control/rollout.h"
#include "dfr/experiment/experiment.h"

namespace dfr::study::planar {

/// A comparison of methods on one planar task. Every trial has its own demonstrations and learner;
/// methods share its start states.
struct PlanarStudy {
  std::string task = "corridor";
  experiment::EvaluationPlan plan;
  MethodOptions methods;
  control::DisturbanceOptions disturbance;  ///< At test time; demonstrations are undisturbed.
  experiment::ExperimentOptions run;        ///< Folder, shard and threads of it.
};

struct PlanarResult {
  std::vector<experiment::UnitResult> units;
  /// [method]: controls of each recovery, in order of trials and episodes.
  std::vector<std::vector<int>> recovery_lengths;
};

[[nodiscard]] PlanarResult RunStudy(const PlanarStudy& study);

/// A study that differs in task, methods' options, disturbance or numbers of demonstrations.
struct Variant {
  std::string name;
  PlanarStudy study;
};

/// Runs them as one experiment, with the first one's plan and run: variants take the place of
/// learners. One result a variant; none at all of a shard.
/// @throws std::invalid_argument unless all have as many data points; and as
///   experiment::RunExperiment().
[[nodiscard]] std::vector<PlanarResult> RunVariants(const std::string& name,
                                                    const std::vector<Variant>& variants);

}  // namespace dfr::study::planar
