#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/summary.h"

namespace dfr::experiment {

/// An episode that is to be run again instead of an experiment.
struct Rerun {
  std::string episode;               ///< Its id; empty: none.
  std::vector<std::string> methods;  ///< Shown beside it, from the same start state.
  std::filesystem::path film;        ///< Empty: without pictures.
};

/// What all commands that compare methods let their users choose.
struct ExperimentOptions {
  std::string preset = "quick";
  std::filesystem::path out;  ///< Empty: no file is written.
  std::uint64_t seed = 2018;
  int threads = 0;  ///< 0: one per core.
  bool restart = false;
  bool salvage = false;
  bool video = true;
  Shard shard = {};  ///< Other than 1/1: there is a ledger alone, to be merged.
  Rerun rerun = {};  ///< Without an episode: none.
  /// The text of run.toml, which starts the same run again. Empty: there is none.
  std::function<std::string()> configuration = {};
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

/// A folder that belongs to one process, until this is destroyed or the process ends.
class OutputFolder {
 public:
  /// Makes the folder options.out unless that is empty, with ledger.jsonl of an earlier run removed
  /// if options.restart.
  /// @throws std::runtime_error naming the folder if it cannot be made, or another process has it.
  explicit OutputFolder(const ExperimentOptions& options);
  ~OutputFolder();
  OutputFolder(OutputFolder&&) noexcept;
  OutputFolder& operator=(OutputFolder&&) noexcept;

 private:
  struct Lock;
  std::unique_ptr<Lock> lock_;
};

/// Runs the plan, or options.shard of it, with a progress bar and a ledger in options.out, of which
/// an OutputFolder has been made, and writes there:
/// - run.toml, as options.configuration has it;
/// - of the whole plan summary.json, which is the same for any number of threads, shards and
///   machines, and times.json, which is not.
/// With options.rerun it runs that episode of the run in options.out instead, as TrialRunner::Run()
/// and Film() do, and prints how it ends; the ledger must say the same.
/// Of a shard and of a rerun there is no result to return. After SIGTERM or SIGUSR1 no further unit
/// begins; a second one ends the process. `settings` are all that decides the results besides the
/// plan.
/// @throws as Evaluate() and SaveSummary() do.
[[nodiscard]] std::optional<ExperimentResult> RunExperiment(
    const std::string& name, const EvaluationPlan& plan, const MakeTrialRunner& make,
    const std::map<std::string, std::string>& settings, const ExperimentOptions& options);

}  // namespace dfr::experiment
