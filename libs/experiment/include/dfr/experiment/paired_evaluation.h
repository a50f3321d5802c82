#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/trajectory.h"
#include "dfr/experiment/progress.h"

namespace dfr::experiment {

/// What is compared: every method from every start state, at every data point of every trial.
struct EvaluationPlan {
  std::vector<std::string> methods;   ///< The reference (Baseline) first.
  std::vector<std::string> learners;  ///< Kinds of learned policies.
  std::vector<int> demonstrations;    ///< Data points: how many demonstrations, ascending.
  int trials = 10;                    ///< Independent repetitions of everything.
  /// How many supervisors take turns: trial t has supervisor t % supervisors. From 5 on intervals
  /// are clustered by supervisor, not by trial.
  int supervisors = 1;
  int episodes = 60;  ///< Start states per trial and data point.
  std::uint64_t seed = 0;
  /// Gives up with an error after this many start states in a row that are not accepted.
  int max_redraws = 10'000;
};

/// What is learned once and then evaluated.
struct EvaluationUnit {
  int trial = 0;
  int demonstrations = 0;
  std::string learner;
  bool operator==(const EvaluationUnit&) const = default;
};

struct EpisodeResult {
  core::Outcome outcome = core::Outcome::kHalted;
  /// Why it halted, or who chose the control that collided. Empty for completed ones.
  std::string cause;
  int controls = 0;           ///< All applied controls.
  int recovery_controls = 0;  ///< Applied by recoveries, probes included.
  int changed_controls = 0;   ///< Not the policy's to the bit, those of recoveries included.
  double seconds = 0.0;       ///< Processor time.
  /// Sum of control::Step::change over the changed controls whose size is known.
  double change = 0.0;
  int sized_changes = 0;  ///< Number of these controls.
  bool operator==(const EpisodeResult&) const = default;
};

/// One unit, learned and ready to run, on one thread.
class TrialRunner {
 public:
  virtual ~TrialRunner() = default;
  /// Whether the start state that follows from the seed is inside the estimated support: no control
  /// could mend one outside. Must not depend on the method.
  [[nodiscard]] virtual bool Accepts(std::uint64_t start_seed) = 0;
  /// One episode of plan.methods[method]. `controller_seed` is the same for all methods.
  [[nodiscard]] virtual EpisodeResult Run(int method, std::uint64_t start_seed,
                                          std::uint64_t controller_seed) = 0;
  /// Writes pictures of one episode of each of `methods`, places in plan.methods, side by side.
  /// @returns whether there are pictures of such episodes.
  /// @throws std::runtime_error naming a file that cannot be written or whose ending is unknown.
  [[nodiscard]] virtual bool Film(const std::vector<int>& /*methods*/, std::uint64_t /*start_seed*/,
                                  std::uint64_t /*controller_seed*/,
                                  const std::filesystem::path& /*path*/) {
    return false;
  }
  /// Further figures of this unit, to be averaged over trials ("overlap", "training loss").
  [[nodiscard]] virtual std::map<std::string, double> Measures() { return {}; }
  /// Lists of counts of this unit, to be pooled over units ("controls of each recovery").
  [[nodiscard]] virtual std::map<std::string, std::vector<int>> Counts() { return {}; }
};

/// Learns what a unit needs. Called by worker threads, several at once.
using MakeTrialRunner = std::function<std::unique_ptr<TrialRunner>(const EvaluationUnit&)>;

struct UnitResult {
  EvaluationUnit unit;
  int redrawn = 0;                                   ///< Start states that were not accepted.
  std::vector<std::uint64_t> starts;                 ///< Seeds of those that were.
  std::vector<std::vector<EpisodeResult>> episodes;  ///< [method][start]
  std::map<std::string, double> measures;
  std::map<std::string, std::vector<int>> counts = {};
  bool operator==(const UnitResult&) const = default;
};

/// The seed of the start state that is drawn for episode `start` of `trial` after `attempt` others
/// were not accepted.
[[nodiscard]] std::uint64_t StartSeed(const EvaluationPlan& plan, int trial, int start,
                                      int attempt) noexcept;

/// The seed of the controllers in episode `start` of `trial`: to run one of Evaluate()'s episodes
/// again, for a video say, from UnitResult::starts.
[[nodiscard]] std::uint64_t ControllerSeed(const EvaluationPlan& plan, int trial,
                                           int start) noexcept;

/// A part of a plan: of all units in their order, block `index` of `count` whose sizes differ by
/// one at most. Blocks are contiguous, so that units which share demonstrations mostly stay
/// together.
struct Shard {
  int index = 1;  ///< From 1 to count.
  int count = 1;
  bool operator==(const Shard&) const = default;
};

/// The shard that "2/7" names. @throws std::invalid_argument for other texts.
[[nodiscard]] Shard ParseShard(std::string_view text);

/// A run that was asked to stop between two units.
class Interrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct EvaluationOptions {
  int threads = 0;   ///< 0: one per core.
  Shard shard = {};  ///< What to run of the plan. Default: all.
  /// Where finished units are written, one line each, and read back by a later run of the same
  /// plan and settings, which then goes on where this one ended. Empty: nowhere.
  std::filesystem::path ledger = {};
  /// All else that decides the results, by name: what a ledger is compared by, as is the commit of
  /// this build. Numbers as Exactly() writes them, files that were read as HashOfFile().
  std::map<std::string, std::string> settings = {};
  bool salvage = false;  ///< Damaged lines of the ledger are dropped, and their units run again.
  std::function<void(const std::string&)> notice = {};  ///< Is told what was dropped. May be empty.
  ProgressCallback progress = {};                       ///< In episodes. May be empty.
  /// Where this becomes true, units under way are finished and no further one begins. May be null.
  const std::atomic<bool>* stop = nullptr;
};

/// Runs the plan, or a shard of it, units spread over threads, and returns them in the order trial,
/// demonstrations, learner. Everything but `seconds` is the same for any number of threads or
/// shards, and for a run that was killed and resumed, which loses at most the units under way.
///
/// The start state i of a trial is the first of the seeds DeriveSeed(seed, {0, trial, i, 0}),
/// {0, trial, i, 1}, ... that the runner accepts, so methods, learners and, as far as each support
/// accepts them, data points share their start states. The controller's is {1, trial, i}.
/// @throws std::invalid_argument for a plan that cannot be run; std::runtime_error for a ledger of
///   other settings (names the first that differs), a damaged one, one that another process writes,
///   or one that cannot be written; Interrupted; and whatever a runner throws.
[[nodiscard]] std::vector<UnitResult> Evaluate(const EvaluationPlan& plan,
                                               const MakeTrialRunner& make,
                                               const EvaluationOptions& options = {});

}  // namespace dfr::experiment
