#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/summary.h"

namespace dfr::experiment {

/// What all commands that compare methods let their users choose.
struct ExperimentOptions {
  std::string preset = "quick";
  std::filesystem::path out;
  std::uint64_t seed = 2018;
  int threads = 0;  ///< 0: one per core.
  bool restart = false;
  bool video = true;
  // Empty, or 0: as the preset says.
  std::vector<std::string> methods = {};
  int trials = 0;
  int episodes = 0;
};

/// The preset's plan, with the seed and what else `options` chooses.
[[nodiscard]] EvaluationPlan ApplyTo(EvaluationPlan preset, const ExperimentOptions& options);

/// What an experiment found.
struct ExperimentResult {
  std::vector<UnitResult> units;
  Summary summary;
};

/// Makes the folder options.out, with ledger.jsonl of an earlier run removed if options.restart.
/// @throws std::runtime_error naming the folder if it cannot be made.
void PrepareFolder(const ExperimentOptions& options);

/// Runs the plan with a progress bar and a ledger in options.out, which PrepareFolder() has made,
/// and writes summary.json there. `settings` are all that decides the results besides the plan.
/// @throws as Evaluate() and SaveSummary() do.
[[nodiscard]] ExperimentResult RunExperiment(const std::string& name, const EvaluationPlan& plan,
                                             const MakeTrialRunner& make,
                                             const std::map<std::string, std::string>& settings,
                                             const ExperimentOptions& options,
                                             const BootstrapOptions& bootstrap = {});

}  // namespace dfr::experiment
