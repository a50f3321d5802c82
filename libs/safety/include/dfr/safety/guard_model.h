#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/control/certified/certificate.h"
#include "dfr/control/certified/certificate_constants.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/reduction/choose_components.h"
#include "dfr/reduction/state_reduction.h"
#include "dfr/safety/action_space.h"
#include "dfr/safety/task_model.h"

namespace dfr::safety {

/// What a guard does with a policy's action near the boundary of what was demonstrated.
enum class Strategy {
  /// Lets the policy drive: its action passes, to the bit, while it is predicted to end inside.
  /// Otherwise it is corrected, by what demonstrations did nearby first (GuidedController).
  kGuard,
  /// Lets the demonstrations drive: the policy's action passes only while it is predicted to end
  /// deep inside. For a policy that is known to be bad, or for none at all.
  kController,
  kDfr,            ///< Derivative-Free Recovery, as published (SwitchingController).
  kEarlyStopping,  ///< Halts.
  kMonitor,        ///< Passes it: looks and raises alarms alone.
  /// Applies what provably ends where no alarm is raised, as long as the assumptions of a
  /// certificate hold (docs/certificates.md), and halts otherwise.
  kCertified,
};

/// "guard", "controller", "dfr", "early-stopping", "monitor", "certified".
[[nodiscard]] const char* Name(Strategy strategy) noexcept;
/// @throws std::invalid_argument naming what there is.
[[nodiscard]] Strategy ParseStrategy(std::string_view name);

/// How a guard behaves: part of its file, and free to be changed after a fit.
struct GuardSettings {
  Strategy strategy = Strategy::kGuard;
  int horizon = 100;       ///< Actions of the policy in an episode, > 0; the guard then halts.
  int max_actions = 1200;  ///< Actions of any kind, > 0; the guard then halts.
  /// Each entry of an applied action is within +- its own, >= 0: one for each, or a single one for
  /// all. Zero keeps an entry at rest.
  std::vector<double> action_limit = {1.0};
  double alarm_level = 0.2;  ///< Alarm where l, the log form of g, falls below - this.
  /// For kCertified: eps >= 0 of |dz - J u| <= eps |u|: what the answer of the whitened features to
  /// an action may differ from the predicted one, per unit of action. 0: not known.
  double direction_error = 0.0;
  /// Whether what demonstrations did nearby may replace an action of the policy. A fit turns it off
  /// where the features do not tell the actions of left-out demonstrations
  /// (GuardSummary::explained, action_error): the guard then corrects the policy's own action, or
  /// halts.
  bool demonstrated = true;
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
  double acceptance = 0.0;               ///< the share of states inside,
  double inside_throughout = 0.0;        ///< and of demonstrations that never leave.
  kernel::ModeSeparationTest gaps = {};  ///< What the support with this gamma makes of gaps.
  /// A further demonstration of the same kind raises an alarm with this probability at most: on
  /// average over fits where `confidence` is 0, else of this fit with that confidence. Exactly so
  /// for demonstrations that were `held_out`; otherwise approximately, for the supports that found
  /// the level are not the one that is used.
  double false_alarms = 0.0;
  double confidence = 0.0;
  int held_out = 0;      ///< Demonstrations that levels were taken from and nothing was fitted to.
  int support_fits = 0;  ///< Supports that were fitted in all, most of the time of a fit.
  /// The alarm level that supports ask for which have not seen a whole stretch of the recording,
  /// and how likely it is that so many demonstrations are further outside of these by chance.
  double drift_level = 0.0;
  double drift_chance = 1.0;
  /// eps and K of |dz| <= K |u|, in whitened features per unit of action.
  control::EstimatedConstant direction_error = {};
  control::EstimatedConstant gain = {};
  double changed = 0.0;       ///< Share of left-out actions that strategy kGuard would change,
  double ends_outside = 0.0;  ///< that are predicted to end outside.
  /// Share of the variance of left-out actions that what other demonstrations did nearby explains.
  double explained = 1.0;
  double action_error = 0.0;  ///< Its squared error, as a share of the squared actions.
  /// What is known of each number of components of the blocks behind "pca:", if the guard chose it;
  /// and why it chose this one.
  std::vector<reduction::ComponentsScore> components = {};
  std::string components_reason = {};
  /// What the demonstrations say against the guard, which the model alone does not tell: see
  /// Warnings().
  std::vector<std::string> fit_warnings = {};
};

/// Options for GuardModel::Fit().
struct GuardOptions {
  /// Which entries of a state are looked at, as core::FeatureSelection takes them; "" for all.
  /// Leave out what the robot cannot influence and what never differs; put in where objects are.
  /// "pca:NAME[:K]" stands for principal components of a block: reduction::StateReduction. Without
  /// K their number is chosen, and refused where none does (GuardModel::Fit()).
  std::string features = {};
  /// nu, gamma (in whitened units) and the rest. gamma is doubled, twice at most, while a gap
  /// test has more points inside than 5 % of its points, and of the time steps. window_share is
  /// doubled, twice at most, while fewer than 85 % of the states of left-out demonstrations are
  /// inside and the gap test allows it.
  kernel::WhitenedSupportOptions support = {};
  Strategy strategy = Strategy::kGuard;
  int horizon = 0;  ///< 0: twice as many actions as the longest demonstration has.
  /// GuardSettings::action_limit. Empty: 1.5 times the largest demonstrated value of each entry, so
  /// that actions that do two thirds as much can be made up for.
  std::vector<double> action_limit = {};
  double false_alarms = 0.1;  ///< Demonstrations that may raise an alarm, in (0, 1).
  double confidence = 0.0;    ///< GuardSummary::confidence, in [0, 1).
  int folds = 5;              ///< Groups that demonstrations are left out in, >= 2.
  /// Share of the demonstrations that nothing is fitted to and all levels are taken from, in
  /// [0, .5]. 0: none; demonstrations are left out of fits in turn.
  double hold_out = 0.0;
  /// GuardSettings::direction_error as a multiple of the one that demonstrations show, > 0: a
  /// policy asks for controls that no demonstration would have made.
  double error_factor = 2.0;
  /// Fit even where next to no state of left-out demonstrations is inside, or where components hold
  /// up the demonstrator. Such a guard halts nearly everything.
  bool accept_any = false;
  std::string source = {};  ///< Kept in the file: where the demonstrations came from.
  /// Called with what is being done and the share of the work that is behind; false stops.
  std::function<bool(std::string_view stage, double share)> progress = {};
};

/// What GuardModel::Certify() finds. Lengths are in whitened features.
struct Certification {
  bool passes = false;  ///< The action provably ends where no alarm is raised,
  int step = 0;         ///< at this time step of the demonstrations, within three of the one given.
  /// By how much l at the predicted state is above what it must be; negative if it does not pass.
  double margin = 0.0;
  /// Whatever changes the features by no more than this ends inside; negative outside.
  double radius = 0.0;
  /// The ball around features + shift that is inside, of which `radius` is left in every direction.
  double ball_radius = 0.0;
  Eigen::VectorXd shift = {};
  Eigen::VectorXd effect = {};  ///< J u, how the features are predicted to change.
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
  /// Actions must be such that zero holds the robot still: velocities or increments. The order of
  /// the demonstrations changes no bit of what is fitted, and only GuardSummary::drift_level and
  /// drift_chance.
  /// @returns nothing if `options.progress` stopped it.
  /// Unit quaternions and angles that jump by a period are made continuous where features look at
  /// them (core::FindRotations()), in these demonstrations and in every later state.
  /// @throws std::invalid_argument if there are fewer than three demonstrations, they do not fit
  ///   each other, an option is out of range or a feature does not exist; the message names which.
  ///   Also if next to no state of left-out demonstrations is inside, naming the features to
  ///   choose, unless options.accept_any.
  static std::shared_ptr<const GuardModel> Fit(const core::StateLayout& layout,
                                               std::span<const core::Trajectory> demonstrations,
                                               const GuardOptions& options = {});

  /// Writes one file, bit for bit what is in memory, with a checksum.
  /// @throws std::runtime_error naming the file and what the system said.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and why it is refused: truncated, damaged, of
  ///   another kind or version.
  static std::shared_ptr<const GuardModel> Load(const std::filesystem::path& path);
  /// The same knowledge with other settings. @throws std::invalid_argument naming which is out of
  ///   range.
  [[nodiscard]] std::shared_ptr<const GuardModel> With(const GuardSettings& settings) const;

  /// The layout of states as Guard::Filter() takes them.
  [[nodiscard]] const core::StateLayout& layout() const noexcept {
    return reduction_ ? reduction_->layout() : layout_;
  }
  [[nodiscard]] int state_dim() const noexcept { return layout().state_dim(); }
  /// How states become those of task() and support(); null where they are the same.
  [[nodiscard]] const reduction::StateReduction* reduction() const noexcept {
    return reduction_.get();
  }
  /// The layout of the states of task() and support().
  [[nodiscard]] const core::StateLayout& task_layout() const noexcept { return layout_; }
  /// Each row as a state of task() and support(). Rows of NaN, where
  /// reduction::StateReduction::Apply() has something against one.
  /// @throws std::invalid_argument if states are not state_dim() wide.
  [[nodiscard]] core::Matrix TaskStates(const core::Matrix& states) const;
  [[nodiscard]] int action_dim() const noexcept { return actions_->dim(); }
  /// What demonstrations show of each entry of an action.
  [[nodiscard]] const ActionSpace& actions() const noexcept { return *actions_; }
  /// Time steps that have an estimate of their own; later ones use the last.
  [[nodiscard]] int num_steps() const noexcept { return task_->feature_support().num_steps(); }
  [[nodiscard]] const GuardSettings& settings() const noexcept { return settings_; }
  [[nodiscard]] const GuardSummary& summary() const noexcept { return summary_; }
  /// Its controls are the steered entries of an action, in the units of actions().
  [[nodiscard]] const TaskModel& task() const noexcept { return *task_; }
  /// g_t of whole states, and its log form l_t; of TaskStates(), where there is a reduction().
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

  /// What is certain of the next state at `state`, in time step `t`, under the assumptions of a
  /// certificate with this model's constants; of `action` with the J of the demonstrations alone.
  /// @throws std::invalid_argument if sizes differ, the model is in single precision, or no
  ///   settings().direction_error is known.
  [[nodiscard]] Certification Certify(int t, std::span<const double> state,
                                      std::span<const double> action) const;
  /// For strategy kCertified. @throws std::invalid_argument as Certify().
  [[nodiscard]] control::Certificate certificate() const;

 private:
  GuardModel() = default;
  static std::shared_ptr<GuardModel> FitStates(const core::StateLayout& layout,
                                               std::span<const core::Trajectory> demonstrations,
                                               const GuardOptions& options);
  static std::shared_ptr<GuardModel> FitReduced(const core::StateLayout& layout,
                                                std::span<const core::Trajectory> demonstrations,
                                                const GuardOptions& options);
  /// Adds a warning if this guard on components corrects and they do not explain the actions. With
  /// `watch` it becomes a monitor.
  void DoubtCorrections(bool watch);
  void Complete(core::StateLayout layout, std::shared_ptr<const ActionSpace> actions,
                std::shared_ptr<const TaskModel> task, GuardSettings settings);

  core::StateLayout layout_;  // The layout of the task's states.
  std::shared_ptr<const reduction::StateReduction> reduction_;
  std::shared_ptr<const ActionSpace> actions_;
  GuardSettings settings_;
  GuardSummary summary_;
  std::shared_ptr<const TaskModel> task_;
};

}  // namespace dfr::safety
