#include "dfr/experiment/experiment.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <csignal>
#include <iostream>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "dfr/core/build_info.h"
#include "dfr/core/contract.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/usage_error.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/film.h"
#include "ledger/ledger_file.h"

namespace dfr::experiment {
namespace {

std::filesystem::path LedgerOf(const ExperimentOptions& options) {
  return options.out.empty() ? options.out : options.out / "ledger.jsonl";
}

// Results that --restart removes. The next run overwrites models and calibrations. The ledger comes
// last: a kill before then leaves a run that --restart still discards.
constexpr std::array kResults = {
    "report.html",  "summary.json",         "times.json",  "study.csv",
    "rollouts.mp4", "rollouts.png",         "best.mp4",    "median.mp4",
    "worst.mp4",    "ledger.jsonl.dropped", "ledger.jsonl"};

std::atomic<bool> stop_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free);

// Converts SIGTERM and SIGUSR1, which schedulers send before they end a job, into stop_requested.
// Ignores signals received before its lifetime: each run has a separate object.
class StopOnSignals {
 public:
  StopOnSignals() {
    stop_requested = false;
    struct sigaction action {};
    action.sa_handler = [](int /*signal*/) { stop_requested = true; };
    action.sa_flags = static_cast<int>(SA_RESETHAND | SA_RESTART);
    sigaction(SIGTERM, &action, &terminate_);
    sigaction(SIGUSR1, &action, &user_);
  }
  ~StopOnSignals() {
    sigaction(SIGTERM, &terminate_, nullptr);
    sigaction(SIGUSR1, &user_, nullptr);
  }
  StopOnSignals(const StopOnSignals&) = delete;
  StopOnSignals& operator=(const StopOnSignals&) = delete;

 private:
  struct sigaction terminate_ {};
  struct sigaction user_ {};
};

void RunAgain(const EvaluationPlan& plan, const MakeTrialRunner& make,
              const std::map<std::string, std::string>& settings, const ExperimentOptions& options,
              const CheckFilm& check_film) {
  const LedgerHeader now = {plan, settings, core::BuildCommit(), {}};
  const RecordedEpisode recorded = FindEpisode(options.out, options.rerun.episode, &now);
  std::vector<std::string> names = options.rerun.methods;
  if (std::ranges::count(names, recorded.id.method) == 0) names.push_back(recorded.id.method);
  std::vector<int> methods;
  methods.reserve(names.size());
  for (const std::string& name : names) {
    const auto found = std::ranges::find(plan.methods, name);
    if (found == plan.methods.end()) {
      std::string error = options.out.string();
      error.append(": the run has no method '").append(name).append("'; it has");
      for (const std::string& method : plan.methods) error.append(" ").append(method);
      throw core::UsageError(error);
    }
    methods.push_back(static_cast<int>(found - plan.methods.begin()));
  }
  const std::filesystem::path& film = options.rerun.film;
  if (film.has_parent_path()) std::filesystem::create_directories(film.parent_path());
  if (!film.empty() && check_film) check_film(recorded.id.unit, film);
  const std::unique_ptr<TrialRunner> runner = make(recorded.id.unit);
  for (std::size_t i = 0; i < names.size(); ++i) {
    EpisodeResult result = runner->Run(methods[i], recorded.start_seed, recorded.controller_seed);
    std::cout << core::Printable(
        core::Format("%-22s %s\n", names[i].c_str(), DescribeEnd(result).c_str()));
    result.seconds = recorded.result.seconds;
    // The order of summation depends on the instruction set.
    const double change = recorded.result.change;
    if (std::abs(result.change - change) <= 1e-9 * (1.0 + change)) result.change = change;
    if (names[i] == recorded.id.method && result != recorded.result) {
      throw std::runtime_error(options.out.string() + ": the ledger's result of the episode is " +
                               core::Name(recorded.result.outcome) + " after " +
                               std::to_string(recorded.result.controls) +
                               " controls; something other than the settings changed the result");
    }
  }
  if (film.empty()) return;
  if (!runner->Film(methods, recorded.start_seed, recorded.controller_seed, film)) {
    throw std::runtime_error("this program cannot draw episodes; leave out --film");
  }
  std::cout << film.string() << std::endl;
}

}  // namespace

struct OutputFolder::Lock {
  internal::Descriptor file;
};

EvaluationPlan ApplyTo(EvaluationPlan preset, const ExperimentOptions& options) {
  preset.seed = options.seed;
  if (!options.methods.empty()) preset.methods = options.methods;
  if (options.trials > 0) preset.trials = options.trials;
  if (options.episodes > 0) preset.episodes = options.episodes;
  return preset;
}

OutputFolder::OutputFolder(const ExperimentOptions& options, const EvaluationPlan& plan) {
  CheckPlan(plan);
  if (options.out.empty()) {
    DFR_THROW_UNLESS(options.shard == Shard(), "a shard needs --out, for its ledger");
    return;
  }
  std::error_code error;
  std::filesystem::create_directories(options.out, error);
  if (error) {
    throw std::runtime_error(options.out.string() +
                             ": the folder cannot be created: " + error.message());
  }
  lock_ = std::make_unique<Lock>(Lock{internal::OpenLocked(options.out / "lock")});
  if (!options.restart) return;
  for (const char* file : kResults) std::filesystem::remove(options.out / file);
}

OutputFolder::~OutputFolder() = default;
OutputFolder::OutputFolder(OutputFolder&&) noexcept = default;
OutputFolder& OutputFolder::operator=(OutputFolder&&) noexcept = default;

std::optional<ExperimentResult> RunExperiment(const std::string& name, const EvaluationPlan& plan,
                                              const MakeTrialRunner& make,
                                              const std::map<std::string, std::string>& settings,
                                              const ExperimentOptions& options,
                                              const CheckFilm& check_film) {
  if (!options.rerun.episode.empty()) {
    RunAgain(plan, make, settings, options, check_film);
    return std::nullopt;
  }
  const auto save_configuration = [&] {
    if (options.out.empty() || !options.configuration) return;
    core::ReplaceFile(options.out / "run.toml", options.configuration());
  };
  // Evaluate() rejects a ledger with other settings. run.toml must then stay unchanged.
  if (!std::filesystem::exists(LedgerOf(options))) save_configuration();
  std::vector<UnitResult> units;
  {
    const StopOnSignals signals;
    ProgressBar bar(name);
    units = Evaluate(
        plan, make,
        {.threads = options.threads,
         .shard = options.shard,
         .ledger = LedgerOf(options),
         .settings = settings,
         .salvage = options.salvage,
         .notice = [](const std::string& text) { std::cerr << core::Printable(text) << std::endl; },
         .progress = [&bar](const Progress& progress) { bar.Show(progress); },
         .stop = &stop_requested});
  }
  save_configuration();
  if (options.shard != Shard()) {
    std::cout << LedgerOf(options).string() << " has all " << units.size() << " units of shard "
              << options.shard.index << "/" << options.shard.count << std::endl;
    return std::nullopt;
  }
  ExperimentResult result;
  result.units = std::move(units);
  result.summary =
      Summarize(plan, result.units,
                {.experiment = name, .preset = options.preset, .commit = core::BuildCommit()});
  if (options.out.empty()) return result;
  SaveSummary(result.summary, options.out / "summary.json");
  SaveTimes(result.summary, options.out / "times.json");
  return result;
}

}  // namespace dfr::experiment
