#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/task_model.h"

namespace dfr::safety {

/// What a guard does with a policy's action near the boundary of what was demonstrated.
enum class Strategy {
  kGuided,         ///< Changes it as little as keeps the state inside, or recovers (GuidedPolicy).
  kDfr,            ///< Derivative-Free Recovery, as published (SwitchingPolicy).
  kEarlyStopping,  ///< Halts.
  kMonitor,        ///< Passes it: looks and raises alarms alone.
};

/// "guided", "dfr", "early-stopping", "monitor".
[[nodiscard]] const char* Name(Strategy strategy) noexcept;
/// @throws std::invalid_argument naming what there is.
[[nodiscard]] Strategy ParseStrategy(std::string_view name);

/// How a guard behaves: part of its file, and free to be changed after a fit.
struct GuardSettings {
  Strategy strategy = Strategy::kGuided;
  int horizon = 100;          ///< Actions of the policy in an episode, > 0; the guard then halts.
  int max_actions = 1200;     ///< Actions of any kind, > 0; the guard then halts.
  double action_limit = 1.0;  ///< Each entry of an applied action is within +- this, > 0.
  double alarm_level = 0.2;   ///< Alarm where l, the log form of g, falls below - this.
};

/// What a fit found, kept in the file.
struct GuardSummary {
  std::string source = {};   ///< Where the demonstrations came from, if the caller said so.
  std::string version = {};  ///< The library that fitted.
  int demonstrations = 0;
  int transitions = 0;  ///< Actions in all of them.
  double nu = 0.0;
  double gamma = 0.0;
  /// On demonstrations left out of a fit in turn, each followed through the time steps:
  double acceptance = 0.0;         ///< the share of states inside,
  double inside_throughout = 0.0;  ///< and of demonstrations that never leave.
  /// A further demonstration of the same kind raises an alarm with this probability at most.
  double false_alarms = 0.0;
};

/// Options for GuardModel::Fit().
struct GuardOptions {
  /// Which entries of a state are looked at, as core::FeatureSelection takes them; "" for all.
  /// Leave out what the robot cannot influence and what never differs; put in where objects are.
  std::string features = {};
  /// nu, gamma (in whitened units) and the rest.
  kernel::WhitenedSupportOptions support = {};
  Strategy strategy = Strategy::kGuided;
  int horizon = 0;            ///< 0: twice as many actions as the longest demonstration has.
  double action_limit = 0.0;  ///< 0: 1, or the largest entry demonstrated where that is more.
  double false_alarms = 0.1;  ///< Demonstrations that may raise an alarm, in (0, 1).
  int folds = 5;              ///< Groups that demonstrations are left out in, >= 2.
  std::string source = {};    ///< Kept in the file: where the demonstrations came from.
  /// Called with what is being done and the share of the work that is behind; false stops.
  std::function<bool(std::string_view stage, double share)> progress = {};
};

/// All that a guard knows of a task: which entries of a state matter and how they are scaled, the
/// support of the demonstrated ones at each time step, lambda, how states answered actions, and the
/// settings. One file holds it; what uses it needs nothing but Eigen and Highway.
///
/// Immutable; guards on several threads share one.
class GuardModel {
 public:
  /// Learns from demonstrations whose states are laid out as `layout` says.
  ///
  /// Actions must be such that zero holds the robot still: velocities or increments.
  /// @returns nothing if `options.progress` stopped it.
  /// @throws std::invalid_argument if there are fewer than three demonstrations, they do not fit
  ///   each other, an option is out of range or a feature does not exist; the message names which.
  static std::shared_ptr<const GuardModel> Fit(const core::StateLayout& layout,
                                               std::span<const core::Trajectory> demonstrations,
                                               const GuardOptions& options = {});

  /// Writes one file, bit for bit what is in memory, with a checksum.
  /// @throws std::runtime_error naming the file and what the system said.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and why it is refused: truncated, damaged, of
  ///   another kind, or written by a newer version.
  static std::shared_ptr<const GuardModel> Load(const std::filesystem::path& path);
  /// The same knowledge with other settings. @throws std::invalid_argument naming which is out of
  ///   range.
  [[nodiscard]] std::shared_ptr<const GuardModel> With(const GuardSettings& settings) const;

  [[nodiscard]] const core::StateLayout& layout() const noexcept { return layout_; }
  [[nodiscard]] int state_dim() const noexcept { return layout_.state_dim(); }
  [[nodiscard]] int action_dim() const noexcept { return recovery().model().control_dim(); }
  /// Time steps that have an estimate of their own; later ones use the last.
  [[nodiscard]] int num_steps() const noexcept { return recovery().support().num_steps(); }
  [[nodiscard]] const GuardSettings& settings() const noexcept { return settings_; }
  [[nodiscard]] const GuardSummary& summary() const noexcept { return summary_; }
  [[nodiscard]] const TaskModel& task() const noexcept { return *task_; }
  [[nodiscard]] const GuidedRecovery& recovery() const noexcept { return task_->guided(); }
  /// g_t of whole states, and its log form l_t.
  [[nodiscard]] const core::LogDecisionFunction& support() const noexcept {
    return task_->guided_support();
  }
  /// lambda_t, the demonstrated change of g_t per unit of action: the threshold of kDfr and
  /// kEarlyStopping is lambda_t |u|.
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return task_->lambda(); }

  /// l of each state of an episode, rows in order of time, each at the time step near its own that
  /// fits it best, as an alarm sees it. `steps`, if given, receives those time steps.
  /// @throws std::invalid_argument if states are not state_dim() wide.
  [[nodiscard]] std::vector<double> Levels(const core::Matrix& states,
                                           std::vector<int>* steps = nullptr) const;

 private:
  GuardModel() = default;
  void Complete(core::StateLayout layout, std::shared_ptr<const TaskModel> task,
                const GuardSettings& settings);

  core::StateLayout layout_;
  GuardSettings settings_;
  GuardSummary summary_;
  std::shared_ptr<const TaskModel> task_;
};

/// What speaks against using a guard, each with its remedy: too few demonstrations to tell ways
/// apart, states of left-out demonstrations that are mostly outside, an alarm level far outside, an
/// action limit far beyond the demonstrated actions. Empty if nothing does.
[[nodiscard]] std::vector<std::string> Findings(const GuardModel& model);

/// The feature list of a command line, "obs/object,obs/tip[0:2]", as FeatureSelection takes it:
/// without the "obs/" or "observations/" that stands before a name in a file.
[[nodiscard]] std::string StripObservationPrefixes(std::string_view features);

}  // namespace dfr::safety
