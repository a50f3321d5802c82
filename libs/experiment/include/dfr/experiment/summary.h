#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dfr/experiment/intervals.h"
#include "dfr/experiment/paired_evaluation.h"

namespace dfr::experiment {

/// A fraction of the episodes, with ClusteredInterval() over trials or supervisors. With fewer than
/// 5 clusters, the interval is ProportionInterval(), which treats episodes as independent.
struct Share {
  double value = 0.0;
  Interval interval;
};

/// Results of one method with one kind of learner at one data point, over all trials.
struct Cell {
  std::string method;
  std::string learner;
  int demonstrations = 0;  ///< Number of demonstrations; 0 for an average over all data points.
  int trials = 0;
  int episodes = 0;
  Share completed;
  Share halted;
  Share collided;
  double seconds_per_trajectory = 0.0;  ///< Processor time.
  double controls_per_trajectory = 0.0;
  double recovery_controls = 0.0;  ///< Mean number per trajectory, including probes.
  /// Share of the controls that equal the policy's bit for bit; absent for
  /// EvaluationPlan::policies.
  std::optional<double> passed = 1.0;
  /// Mean size of the changes to controls (EpisodeResult::change), over changes of known size.
  std::optional<double> change = {};
  int redrawn_starts = 0;  ///< Number of start states outside the support, which were drawn again.
  std::map<std::string, int> halt_causes;
  /// Number of collisions by the source of the control that collided.
  std::map<std::string, int> collision_causes;
};

/// Comparison of a method with the reference for one kind of learner, over all data points. Ratios
/// of totals equal ratios of averages, because every data point has the same number of episodes.
struct Contrast {
  std::string method;
  std::string against;
  std::string learner;
  PairedContrast ratios;
  /// Clusters of the intervals: "episodes" if there are fewer than 5 trials; otherwise
  /// "supervisors" if there are at least 5 supervisors, else "trials". Intervals over episodes
  /// ignore the variation between trials.
  std::string clusters;
  std::optional<double> seconds_ratio;   ///< Seconds per trajectory, relative to the reference.
  std::optional<double> controls_ratio;  ///< Controls per trajectory, relative to the reference.
  /// Number of pairs (one start state each) in which only the method collided.
  int only_method_collided = 0;
  int only_reference_collided = 0;  ///< Number of pairs in which only the reference collided.
  double mcnemar_p = 1.0;           ///< ClusteredMcNemar() of all pairs, by `clusters`.
};

/// Mean of a quantity reported by the runners, over the trials in which it is finite; NaN if there
/// are none.
struct MeasureMean {
  std::string name;
  std::string learner;
  int demonstrations = 0;
  double mean = 0.0;
};

struct Summary {
  std::string experiment;
  std::string preset;
  std::string commit;
  std::uint64_t seed = 0;
  std::vector<Cell> cells;     ///< Ordered by learner, method, demonstrations.
  std::vector<Cell> averages;  ///< Ordered by learner and method, over all data points.
  std::vector<Contrast> contrasts;
  std::vector<MeasureMean> measures;  ///< Ordered by name, learner, demonstrations.
};

struct SummaryOptions {
  std::string experiment = {};
  std::string preset = {};
  std::string commit = {};
};

/// Aggregates Evaluate()'s results for `plan`, whose first method is the reference.
/// @throws std::invalid_argument unless the results cover the whole plan.
[[nodiscard]] Summary Summarize(const EvaluationPlan& plan, std::span<const UnitResult> results,
                                const SummaryOptions& options);

/// Returns the summary as JSON; undefined quantities are null:
///   {"experiment": "pusher", "preset": ..., "commit": ..., "seed": ...,
///    "cells": [{"method": "dfr", "learner": "8", "demonstrations": 120, "trials": 10,
///      "episodes": 600, "completed": 0.41, "completed_interval": [lo, hi], "halted": ...,
///      "halted_interval": ..., "collided": ..., "collided_interval": ...,
///      "controls_per_trajectory": ..., "recovery_controls": ..., "passed": ..., "change": ...,
///      "redrawn_starts": ...,
///      "halt_causes": {"outside-support": 3, ...}, "collision_causes": {...}}, ...],
///    "averages": [the same with "demonstrations": null, ...],
///    "contrasts": [{"method": "dfr", "against": "baseline", "learner": "8",
///      "collision_reduction": ..., "interval": [..], "collision_reduction_interval": [..],
///      "completion_ratio": ..., "completion_ratio_interval": [..], "clusters": "trials",
///      "controls_ratio": ..., "only_method_collided": ...,
///      "only_reference_collided": ..., "mcnemar_p": ...}, ...],
///    "measures": [{"name": ..., "learner": ..., "demonstrations": ..., "mean": ...}, ...]}
/// "interval" of a contrast repeats "collision_reduction_interval". Contains no measured times, so
/// the text is identical for any distribution of units over machines with the same instruction set.
[[nodiscard]] std::string ToJson(const Summary& summary);

/// Writes ToJson() to a temporary file and renames it when complete.
/// @throws std::runtime_error naming the file.
void SaveSummary(const Summary& summary, const std::filesystem::path& path);

/// Writes the processor times as SaveSummary() does: {"cells": [{"method", "learner",
/// "demonstrations", "seconds_per_trajectory"}, ...], "averages": [...], "contrasts": [{"method",
/// "against", "learner", "seconds_ratio"}, ...]}.
/// @throws as SaveSummary().
void SaveTimes(const Summary& summary, const std::filesystem::path& path);

/// Prints the averages with contrasts, then the data points, as text for a terminal.
void PrintTable(const Summary& summary, std::ostream& out);

}  // namespace dfr::experiment
