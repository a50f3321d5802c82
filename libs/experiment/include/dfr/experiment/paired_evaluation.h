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

/// Definition of a comparison: every method from every start state, at every data point of every
/// trial.
struct EvaluationPlan {
  /// Names of the methods, starting with the reference (Baseline).
  std::vector<std::string> methods;
  std::vector<std::string> learners;  ///< Kinds of learned policies.
  std::vector<int> demonstrations;    ///< Data points: numbers of demonstrations, ascending.
  int trials = 10;                    ///< Independent repetitions of the whole evaluation.
  /// Number of supervisors: trial t has supervisor t % supervisors. With 5 or more, intervals are
  /// clustered by supervisor, not by trial.
  int supervisors = 1;
  int episodes = 60;  ///< Start states per trial and data point.
  std::uint64_t seed = 0;
  /// Evaluate() fails after this many consecutive rejected start states.
  int max_redraws = 10'000;
  /// Methods that run a policy other than the reference's. They have no share of passed controls
  /// and no verdict.
  std::vector<std::string> policies = {};
};

/// @throws std::invalid_argument for an invalid plan, such as a method that is named twice.
void CheckPlan(const EvaluationPlan& plan);

/// A part of the plan that is learned once and evaluated with all methods.
struct EvaluationUnit {
  int trial = 0;
  int demonstrations = 0;
  std::string learner;
  bool operator==(const EvaluationUnit&) const = default;
};

struct EpisodeResult {
  core::Outcome outcome = core::Outcome::kHalted;
  /// Cause of the halt, or source of the control that collided. Empty for completed episodes.
  std::string cause;
  int controls = 0;           ///< Number of all applied controls.
  int recovery_controls = 0;  ///< Number of controls applied by recoveries, including probes.
  /// Number of controls that differ from the policy's in any bit, including recovery controls.
  int changed_controls = 0;
  double seconds = 0.0;  ///< Processor time.
  /// Sum of control::Step::change over the changed controls whose size is known.
  double change = 0.0;
  int sized_changes = 0;  ///< Number of changes included in `change`.
  bool operator==(const EpisodeResult&) const = default;
};

/// One learned unit, ready to run on one thread.
class TrialRunner {
 public:
  virtual ~TrialRunner() = default;
  /// Returns true if the start state drawn with the seed is inside the estimated support. Other
  /// start states are drawn again. The result must not depend on the method.
  [[nodiscard]] virtual bool Accepts(std::uint64_t start_seed) = 0;
  /// Runs one episode of plan.methods[method]. `controller_seed` is the same for all methods.
  [[nodiscard]] virtual EpisodeResult Run(int method, std::uint64_t start_seed,
                                          std::uint64_t controller_seed) = 0;
  /// Writes pictures of one episode of each of `methods`, indices into plan.methods, side by side.
  /// @returns false if this runner provides no pictures.
  /// @throws std::runtime_error naming a file that cannot be written or whose extension is unknown.
  [[nodiscard]] virtual bool Film(const std::vector<int>& /*methods*/, std::uint64_t /*start_seed*/,
                                  std::uint64_t /*controller_seed*/,
                                  const std::filesystem::path& /*path*/) {
    return false;
  }
  /// Returns further quantities of this unit, to be averaged over trials ("overlap", "training
  /// loss").
  [[nodiscard]] virtual std::map<std::string, double> Measures() { return {}; }
  /// Returns lists of counts of this unit, to be pooled over units ("controls of each recovery").
  [[nodiscard]] virtual std::map<std::string, std::vector<int>> Counts() { return {}; }
};

/// Learns a unit. Called concurrently by worker threads.
using MakeTrialRunner = std::function<std::unique_ptr<TrialRunner>(const EvaluationUnit&)>;

struct UnitResult {
  EvaluationUnit unit;
  /// Number of rejected start states.
  int redrawn = 0;
  std::vector<std::uint64_t> starts;                 ///< Seeds of the accepted start states.
  std::vector<std::vector<EpisodeResult>> episodes;  ///< [method][start]
  std::map<std::string, double> measures;
  std::map<std::string, std::vector<int>> counts = {};
  bool operator==(const UnitResult&) const = default;
};

/// Returns the seed of the start state drawn for episode `start` of `trial` after `attempt`
/// rejected draws.
[[nodiscard]] std::uint64_t StartSeed(const EvaluationPlan& plan, int trial, int start,
                                      int attempt) noexcept;

/// A start state that a runner accepts, and the number of start states rejected before it.
struct DrawnStart {
  std::uint64_t seed = 0;
  int rejected = 0;
};
/// Draws start states for episode `start` of `unit` until the runner accepts one.
/// @throws std::runtime_error after EvaluationPlan::max_redraws attempts.
[[nodiscard]] DrawnStart DrawStart(const EvaluationPlan& plan, const EvaluationUnit& unit,
                                   int start, TrialRunner& runner);

/// Returns the seed of the controllers in episode `start` of `trial`. With this seed and
/// UnitResult::starts, a caller can repeat an episode, for example for a video.
[[nodiscard]] std::uint64_t ControllerSeed(const EvaluationPlan& plan, int trial,
                                           int start) noexcept;

/// A part of a plan: block `index` of `count` contiguous blocks of its units, in order, whose sizes
/// differ by at most one. Contiguous blocks mostly keep units with the same demonstrations
/// together.
struct Shard {
  int index = 1;  ///< Number of the shard, from 1 to count.
  int count = 1;
  bool operator==(const Shard&) const = default;
};

/// Parses a shard such as "2/7". @throws std::invalid_argument for other texts.
[[nodiscard]] Shard ParseShard(std::string_view text);

/// Thrown if a run is stopped between two units.
class Interrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct EvaluationOptions {
  int threads = 0;   ///< Number of threads; 0: one per core.
  Shard shard = {};  ///< Part of the plan to run. Default: all.
  /// File of finished units, one line each. A later run of the same plan and settings reads it and
  /// continues. Empty: no file.
  std::filesystem::path ledger = {};
  /// All other settings that determine the results, by name. These and the commit of this build
  /// must match the ledger. Write numbers with Exactly(), and input files with HashOfFile().
  std::map<std::string, std::string> settings = {};
  bool salvage = false;  ///< Drops damaged lines of the ledger and repeats their units.
  /// Reports dropped lines, and the resumption of a run by a build whose commit is unknown. May be
  /// empty.
  std::function<void(const std::string&)> notice = {};
  /// Progress, counted in episodes. May be empty.
  ProgressCallback progress = {};
  /// Once true, running units finish and no new unit starts. May be nullptr.
  const std::atomic<bool>* stop = nullptr;
};

/// Runs the plan, or a shard of it, with units spread over threads, and returns them in the order
/// trial, demonstrations, learner. Everything except `seconds` is identical for any number of
/// threads or shards, and after a kill and resumption. A killed run loses at most the running
/// units.
///
/// The start state i of a trial is the first of the seeds DeriveSeed(seed, {0, trial, i, 0}), {0,
/// trial, i, 1}, ... that the runner accepts. Methods and learners therefore share start states,
/// and so do data points as far as each support accepts them. The controller's seed is
/// DeriveSeed(seed, {1, trial, i}).
/// @throws as CheckPlan(); std::runtime_error if the ledger has other settings (naming the first
///   that differs), is damaged, is in use by another process, or cannot be written; Interrupted;
///   and any exception of a runner.
[[nodiscard]] std::vector<UnitResult> Evaluate(const EvaluationPlan& plan,
                                               const MakeTrialRunner& make,
                                               const EvaluationOptions& options = {});

}  // namespace dfr::experiment
