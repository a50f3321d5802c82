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

/// An episode to repeat instead of running an experiment.
struct Rerun {
  std::string episode;               ///< Episode id; empty: none.
  std::vector<std::string> methods;  ///< Methods to compare, from the same start state.
  std::filesystem::path film;        ///< File of the film; empty: no pictures.
};

/// Options shared by all commands that compare methods.
struct ExperimentOptions {
  std::string preset = "quick";
  std::filesystem::path out;  ///< Output folder; empty: no files are written.
  std::uint64_t seed = 2018;
  int threads = 0;  ///< Number of threads; 0: one per core.
  bool restart = false;
  bool salvage = false;
  bool video = true;
  Shard shard = {};  ///< A shard other than 1/1 writes only a ledger for a merge.
  Rerun rerun = {};  ///< Empty `episode`: no rerun.
  /// Returns the text of run.toml, which reproduces the run. Empty: no run.toml.
  std::function<std::string()> configuration = {};
  // The members below replace the preset's values unless they are empty or 0.
  std::vector<std::string> methods = {};
  int trials = 0;
  int episodes = 0;
};

/// Returns the preset's plan with the seed and the other choices of `options`.
[[nodiscard]] EvaluationPlan ApplyTo(EvaluationPlan preset, const ExperimentOptions& options);

/// Results of an experiment.
struct ExperimentResult {
  std::vector<UnitResult> units;
  Summary summary;
};

/// Exclusive lock on a folder, held by one process until destruction or the end of the process.
class OutputFolder {
 public:
  /// Creates the folder options.out unless this path is empty. Removes the ledger and the results
  /// of an earlier run if options.restart is true.
  /// @throws std::runtime_error naming the folder if it cannot be created, or another process holds
  ///   it; and, before the folder changes, as CheckPlan().
  OutputFolder(const ExperimentOptions& options, const EvaluationPlan& plan);
  ~OutputFolder();
  OutputFolder(OutputFolder&&) noexcept;
  OutputFolder& operator=(OutputFolder&&) noexcept;

 private:
  struct Lock;
  std::unique_ptr<Lock> lock_;
};

/// Throws std::runtime_error if TrialRunner::Film() cannot write a film of the unit to the file.
using CheckFilm =
    std::function<void(const EvaluationUnit& unit, const std::filesystem::path& film)>;

/// Runs the plan, or options.shard of it, with a progress bar and a ledger in options.out, for
/// which an OutputFolder must exist. Writes there:
/// - run.toml, from options.configuration;
/// - for the whole plan, summary.json, which is identical for any number of threads, shards and
///   machines with the same instruction set, and times.json, which is not.
///
/// With options.rerun, repeats that episode of the run in options.out with TrialRunner::Run() and
/// Film(), and prints its outcome, which must match the ledger. Returns std::nullopt for a shard or
/// a rerun. `check_film` runs before the unit of a film is learned. After SIGTERM or SIGUSR1 no new
/// unit starts; the same signal again ends the process.
/// @param settings  everything that determines the results, except the plan.
/// @throws as Evaluate() and SaveSummary() do.
[[nodiscard]] std::optional<ExperimentResult> RunExperiment(
    const std::string& name, const EvaluationPlan& plan, const MakeTrialRunner& make,
    const std::map<std::string, std::string>& settings, const ExperimentOptions& options,
    const CheckFilm& check_film = {});

}  // namespace dfr::experiment
