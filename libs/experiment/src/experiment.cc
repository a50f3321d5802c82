#include "dfr/experiment/experiment.h"

#include <stdexcept>
#include <system_error>
#include <utility>

#include "dfr/core/build_info.h"

namespace dfr::experiment {
namespace {

std::filesystem::path LedgerOf(const ExperimentOptions& options) {
  return options.out / "ledger.jsonl";
}

}  // namespace

EvaluationPlan ApplyTo(EvaluationPlan preset, const ExperimentOptions& options) {
  preset.seed = options.seed;
  if (!options.methods.empty()) preset.methods = options.methods;
  if (options.trials > 0) preset.trials = options.trials;
  if (options.episodes > 0) preset.episodes = options.episodes;
  return preset;
}

void PrepareFolder(const ExperimentOptions& options) {
  std::error_code error;
  std::filesystem::create_directories(options.out, error);
  if (error) {
    throw std::runtime_error(options.out.string() +
                             ": the folder cannot be made: " + error.message());
  }
  if (options.restart) std::filesystem::remove(LedgerOf(options));
}

ExperimentResult RunExperiment(const std::string& name, const EvaluationPlan& plan,
                               const MakeTrialRunner& make,
                               const std::map<std::string, std::string>& settings,
                               const ExperimentOptions& options,
                               const BootstrapOptions& bootstrap) {
  ProgressBar bar(name);
  ExperimentResult result;
  result.units = Evaluate(plan, make,
                          {.threads = options.threads,
                           .ledger = LedgerOf(options),
                           .settings = settings,
                           .progress = [&bar](const Progress& progress) { bar.Show(progress); }});
  result.summary = Summarize(plan, result.units,
                             {.experiment = name,
                              .preset = options.preset,
                              .commit = core::BuildCommit(),
                              .bootstrap = bootstrap});
  SaveSummary(result.summary, options.out / "summary.json");
  return result;
}

}  // namespace dfr::experiment
