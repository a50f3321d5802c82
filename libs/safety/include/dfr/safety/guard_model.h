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
#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/reduction/choose_components.h"
#include "dfr/reduction/state_reduction.h"
#include "dfr/safety/action_space.h"
#include "dfr/safety/constants.h"
#include "dfr/safety/task_model.h"

namespace dfr::safety {

/// Treatment of a policy's action near the boundary of the support.
enum class Strategy {
  /// Least intervention: the policy's action passes, unchanged bit for bit, if it is predicted to
  /// end inside. Otherwise it is corrected, if possible by the nominal action of nearby
  /// demonstrations (GuidedController).
  kGuard,
  /// Demonstrations drive: the policy's action passes only if it is predicted to end deep inside.
  /// Intended for a bad policy, or for use without a policy.
  kController,
  kDfr,            ///< Derivative-Free Recovery, as published (SwitchingController).
  kEarlyStopping,  ///< Halts instead of recovering.
  kMonitor,        ///< Only raises alarms, and clamps actions to the limits.
  /// Applies only actions that provably raise no alarm under the assumptions of a certificate
  /// (docs/certificates.md), otherwise halts.
  kCertified,
};

/// Returns "guard", "controller", "dfr", "early-stopping", "monitor" or "certified".
[[nodiscard]] const char* Name(Strategy strategy) noexcept;
/// @throws std::invalid_argument listing the valid names.
[[nodiscard]] Strategy ParseStrategy(std::string_view name);

/// Settings of a guard, stored in its file. GuardModel::With() changes them after a fit.
struct GuardSettings {
  Strategy strategy = Strategy::kGuard;
  int horizon = 100;       ///< Time step, > 0, at which the guard halts; waiting does not count.
  int max_actions = 1200;  ///< Maximum number of actions of any kind, > 0; the guard then halts.
  /// Largest absolute value of each entry of an applied action, >= 0: one per entry, or one for
  /// all. Zero keeps an entry at rest.
  std::vector<double> action_limit = {1.0};
  double alarm_level = 0.2;  ///< Alarm if l, the logarithmic form of g, is below -alarm_level.
  /// For kCertified: eps >= 0 in |dz - J u| <= eps |u|, the largest error of the predicted response
  /// of the whitened features, per unit of action. 0: unknown.
  double direction_error = 0.0;
  /// Allows the nominal action of nearby demonstrations to replace an action of the policy. A fit
  /// turns it off if the features do not determine the actions of left-out demonstrations
  /// (GuardSummary::explained, action_error). The guard then corrects the policy's action or halts.
  bool demonstrated = true;
};

/// Results of a fit, stored in the file.
struct GuardSummary {
  std::string source = {};   ///< Origin of the demonstrations, if given by the caller.
  std::string version = {};  ///< Version of the library that fitted the model.
  int demonstrations = 0;
  int transitions = 0;  ///< Number of actions in all demonstrations.
  double nu = 0.0;
  double gamma = 0.0;
  // Results from cross-validation, or from held-out demonstrations, at the time steps of Levels().
  double acceptance = 0.0;               ///< Fraction of states inside.
  double inside_throughout = 0.0;        ///< Fraction of demonstrations that stay inside.
  kernel::ModeSeparationTest gaps = {};  ///< Result for the support with this gamma.
  /// Largest probability that a further demonstration raises an alarm: on average over fits if
  /// `confidence` is 0, otherwise for this fit with that confidence. Exact if demonstrations were
  /// `held_out`; otherwise approximate, because other supports determined the level.
  double false_alarms = 0.0;
  double confidence = 0.0;
  int held_out = 0;      ///< Number of demonstrations held out of the fit.
  int support_fits = 0;  ///< Number of fitted supports, which take most of the time.
  /// Alarm level from supports fitted without a contiguous part of the recording, and the
  /// probability of so large a difference from cross-validation by chance (Wilcoxon's signed-rank
  /// test).
  double drift_level = 0.0;
  double drift_chance = 1.0;
  /// eps and K in |dz - J u| <= eps |u| and |dz| <= K |u|, in whitened features.
  control::EstimatedConstant direction_error = {};
  control::EstimatedConstant gain = {};
  double changed = 0.0;       ///< Fraction of left-out actions that strategy kGuard would change.
  double ends_outside = 0.0;  ///< Fraction of left-out actions that are predicted to end outside.
  /// Fraction of left-out actions that are predicted to end below control::Levels::pass(). Files do
  /// not store it.
  double below_pass = 0.0;
  /// Fraction of the variance of left-out actions that nearby demonstrations explain.
  double explained = 1.0;
  double action_error = 0.0;  ///< Squared error of predicted left-out actions / squared actions.
  /// action_error for the entry of the action that varies most. Files do not store it.
  double entry_error = 0.0;
  /// Scores of each number of components of the reduced blocks, and the reason for the choice,
  /// if the fit chose the number.
  std::vector<reduction::ComponentsScore> components = {};
  std::string components_reason = {};
  /// Warnings that require the demonstrations, not only the model; see Warnings().
  std::vector<std::string> fit_warnings = {};
};

/// Options for GuardModel::Fit().
struct GuardOptions {
  /// Entries of a state to use, in the syntax of core::FeatureSelection; "" for all. Omit entries
  /// that the robot cannot influence or that never differ; include positions of objects.
  /// "points:NAME[:K]" and "pca:NAME[:K]" denote components of a block (reduction::StateReduction).
  /// Without K the fit chooses their number, and fails if none suffices.
  std::string features = {};
  /// nu, gamma (in whitened units) and others. The fit doubles gamma if the support then covers
  /// more left-out states per volume (docs/recovery.md). It doubles gamma up to twice while a mode
  /// separation test finds too many points inside (fit::kMostInGaps). It doubles window_share up to
  /// twice while less than 85 % of the states of left-out demonstrations are inside and the test
  /// allows it.
  kernel::WhitenedSupportOptions support = {};
  Strategy strategy = Strategy::kGuard;
  /// GuardSettings::horizon, in [0, kLongestHorizon]. 0: twice the number of actions of the longest
  /// demonstration.
  int horizon = 0;
  static constexpr int kLongestHorizon = (1 << 30) / fit::kActionsPerStep;
  /// GuardSettings::action_limit. Empty: 1.5 times the largest demonstrated value of each entry,
  /// which can compensate for a reduction of the actions' effect to two thirds.
  std::vector<double> action_limit = {};
  double false_alarms = 0.1;  ///< Fraction of demonstrations that may raise an alarm, in (0, 1).
  double confidence = 0.0;    ///< GuardSummary::confidence, in [0, 1).
  int folds = 5;              ///< Number of cross-validation folds, >= 2.
  /// Fraction of the demonstrations, in [0, .5], that is held out of the fit and determines the
  /// alarm level and the constants of certificates. 0: cross-validation.
  double hold_out = 0.0;
  /// GuardSettings::direction_error as a multiple of the demonstrated error, > 0. The error of a
  /// policy's controls may be larger, because these controls differ from demonstrated ones.
  double error_factor = 2.0;
  /// Fits even if almost no state of left-out demonstrations is inside, or if a guard with
  /// components would stop the demonstrator. Such a guard halts almost every policy.
  bool accept_any = false;
  std::string source = {};  ///< Origin of the demonstrations, stored in the file.
  /// Called with the current stage and the completed fraction of the work; returning false stops
  /// the fit.
  std::function<bool(std::string_view stage, double share)> progress = {};
};

/// Result of GuardModel::Certify(). Lengths are in whitened features.
struct Certification {
  bool passes = false;  ///< True if the action provably raises no alarm in the next state.
  int step = 0;         ///< Time step of the demonstrations for the next state, within 3 of `t`.
  /// Predicted l minus the required l; negative if the action does not pass.
  double margin = 0.0;
  /// Changes of the features by at most this amount end inside. Negative if the state is outside.
  double radius = 0.0;
  /// Radius of a ball in the support with centre features + shift: ball_radius = radius + |shift|.
  double ball_radius = 0.0;
  Eigen::VectorXd shift = {};
  Eigen::VectorXd effect = {};  ///< J u, the predicted change of the features.
};

/// Entries of a state that a frozen sensor or camera leaves exactly unchanged while the robot
/// moves. A standstill is counted in steps. A step with an ordinary or larger action counts 1, a
/// step with a smaller action its |a| (ActionSpace), and a step at rest 0.
struct SensorGroup {
  struct Range {
    int first = 0;
    int size = 0;
  };
  std::vector<Range> ranges = {};  ///< Ranges in states of GuardModel::layout(), ascending.
  double longest = 0.0;            ///< Longest demonstrated standstill.
  /// Returns the longest standstill that a guard accepts.
  [[nodiscard]] double limit() const noexcept;
};

/// Model of a task for guards: the features of a state and their scales, their support at each time
/// step, lambda, the response of states to actions, and the settings. Stored in one file. Its use
/// needs only Eigen and Highway.
///
/// Immutable; guards on several threads can share one model.
class GuardModel {
 public:
  /// Fits a model to demonstrations with states of this `layout`.
  ///
  /// A zero action must hold the robot still: actions are velocities or increments. The order of
  /// the demonstrations changes only GuardSummary::drift_level and drift_chance. Unit quaternions
  /// and angles that jump by a period are made continuous if features use them
  /// (core::FindRotations()), here and in every later state.
  /// @returns null if `options.progress` or `options.support.svm.progress` stopped the fit.
  /// @throws std::invalid_argument naming the cause: fewer than three demonstrations, different
  /// shapes, an option out of range, or an unknown feature. Also if almost no state of left-out
  /// demonstrations is inside, naming better features, unless options.accept_any.
  static std::shared_ptr<const GuardModel> Fit(const core::StateLayout& layout,
                                               std::span<const core::Trajectory> demonstrations,
                                               const GuardOptions& options = {});

  /// Writes one file with a checksum. Load() restores the model bit for bit.
  /// @throws std::runtime_error naming the file and the system's error.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and its defect: truncated, damaged, of another kind
  /// or version.
  static std::shared_ptr<const GuardModel> Load(const std::filesystem::path& path);
  /// Returns a copy that shares the fitted data and uses `settings`. @throws std::invalid_argument
  /// naming the setting that is out of range.
  [[nodiscard]] std::shared_ptr<const GuardModel> With(const GuardSettings& settings) const;

  /// Returns the layout of the states of Guard::Filter().
  [[nodiscard]] const core::StateLayout& layout() const noexcept {
    return reduction_ ? reduction_->layout() : layout_;
  }
  [[nodiscard]] int state_dim() const noexcept { return layout().state_dim(); }
  /// Returns the map from states to the states of task() and support(); null for the identity.
  [[nodiscard]] const reduction::StateReduction* reduction() const noexcept {
    return reduction_.get();
  }
  /// Returns the layout of the states of task() and support().
  [[nodiscard]] const core::StateLayout& task_layout() const noexcept { return layout_; }
  /// Maps each row to a state of task() and support(). A row becomes NaN if
  /// reduction::StateReduction::Apply() rejects it.
  /// @throws std::invalid_argument if states are not state_dim() wide.
  [[nodiscard]] core::Matrix TaskStates(const core::Matrix& states) const;
  /// Returns the features of task() at one state; NaN if TaskStates() gives NaN.
  /// @throws std::invalid_argument unless the state has state_dim() entries.
  [[nodiscard]] Eigen::VectorXd Features(std::span<const double> state) const;
  [[nodiscard]] int action_dim() const noexcept { return actions_->dim(); }
  /// Returns the units and ranges of the entries of an action.
  [[nodiscard]] const ActionSpace& actions() const noexcept { return *actions_; }
  /// Returns the number of time steps with an estimate; later time steps use the last estimate.
  [[nodiscard]] int num_steps() const noexcept { return task_->feature_support().num_steps(); }
  [[nodiscard]] const GuardSettings& settings() const noexcept { return settings_; }
  [[nodiscard]] const GuardSummary& summary() const noexcept { return summary_; }
  /// Returns the task model. Its controls are the steered entries of an action, in the units of
  /// actions().
  [[nodiscard]] const TaskModel& task() const noexcept { return *task_; }
  /// Returns g_t and its logarithmic form l_t, for whole states or, if there is a reduction(), for
  /// TaskStates().
  [[nodiscard]] const core::LogDecisionFunction& support() const noexcept {
    return task_->guided_support();
  }
  /// Returns lambda_t, the demonstrated change of g_t per unit of action: the threshold of kDfr and
  /// kEarlyStopping is lambda_t |u|.
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return task_->lambda(); }

  /// Returns the number of requested features that are constant in all demonstrations. They are not
  /// part of support and response.
  [[nodiscard]] int num_constants() const noexcept { return static_cast<int>(constants_.size()); }
  /// Returns the first entry of a finite state of task() that was constant in all demonstrations
  /// and now differs, by more than fit::kConstantTolerance; -1 if there is none, or if the state
  /// has a quaternion that StateMap::FindInvalid() rejects. Real-time safe.
  /// @param values  num_constants() entries; receives the compared entries.
  [[nodiscard]] int FindChangedConstant(std::span<const double> task_state,
                                        std::span<double> values) const noexcept;
  /// Returns the first entry of a finite state of task() that is an angle with jumps and more than
  /// 1e6 periods from zero, which no robot reports; -1 if there is none. Real-time safe.
  [[nodiscard]] int FindImmeasurableAngle(std::span<const double> task_state) const noexcept;
  /// Returns the period of each entry of a state of layout() that is an angle with jumps; 0 for
  /// other entries, and in pictures.
  [[nodiscard]] const std::vector<double>& Periods() const noexcept { return periods_; }
  /// Returns the map from a state of task() to the context of demonstrated controls: entries that
  /// only the unsteered entries of an action move. Null: none.
  [[nodiscard]] const core::FeatureTransform* context() const noexcept {
    return context_ ? &*context_ : nullptr;
  }
  /// Returns the entries that features use, in groups: each picture or other reduced block alone,
  /// then all others except those that only advance with time.
  [[nodiscard]] const std::vector<SensorGroup>& sensor_groups() const noexcept {
    return sensor_groups_;
  }

  /// Returns l of each state of an episode (rows in time order) at the nearby time step that fits
  /// it best, as for an alarm. `steps`, if given, receives these time steps.
  /// @throws std::invalid_argument if states are not state_dim() wide.
  [[nodiscard]] std::vector<double> Levels(const core::Matrix& states,
                                           std::vector<int>* steps = nullptr) const;

  /// Certifies the next state after `action` in `state` at time step `t`, which is clamped to time
  /// steps with an estimate. Uses this model's constants and the J of the demonstrations alone.
  /// @throws std::invalid_argument if sizes differ, the model is in single precision, or
  /// settings().direction_error is unknown.
  [[nodiscard]] Certification Certify(int t, std::span<const double> state,
                                      std::span<const double> action) const;
  /// Returns the certificate of strategy kCertified. @throws std::invalid_argument as Certify()
  /// does.
  [[nodiscard]] control::Certificate certificate() const;

 private:
  GuardModel() = default;
  /// Returns Periods() of a fit. `recorded` is the layout of `demonstrations`.
  [[nodiscard]] std::vector<double> FindPeriods(
      const core::StateLayout& recorded, std::span<const core::Trajectory> demonstrations) const;
  /// Calls visit(entry, period) for each angle with jumps in states of task().
  template <typename Visit>
  void EachAngle(const Visit& visit) const;
  /// @param may_narrow  allows doubling gamma to cover more left-out states per volume.
  static std::shared_ptr<GuardModel> FitStates(const core::StateLayout& layout,
                                               std::span<const core::Trajectory> demonstrations,
                                               const GuardOptions& options, bool may_narrow);
  static std::shared_ptr<GuardModel> FitReduced(const core::StateLayout& layout,
                                                std::span<const core::Trajectory> demonstrations,
                                                const GuardOptions& options);
  /// Adds a warning if this guard corrects and its components explain too little of the
  /// demonstrated actions. With `watch`, the guard becomes a monitor if they explain less than
  /// fit::kLeastTold or if too many actions are predicted to end outside.
  void DoubtCorrections(bool watch);
  void Complete(core::StateLayout layout, std::shared_ptr<const ActionSpace> actions,
                std::shared_ptr<const TaskModel> task, GuardSettings settings);

  core::StateLayout layout_;  // Layout of the task's states.
  std::shared_ptr<const reduction::StateReduction> reduction_;
  std::shared_ptr<const ActionSpace> actions_;
  GuardSettings settings_;
  GuardSummary summary_;
  std::shared_ptr<const TaskModel> task_;
  std::optional<core::FeatureSelection> constant_entries_;  // Empty if no entry is constant.
  std::vector<double> constants_;                           // Values of constant_entries_.
  std::optional<core::FeatureTransform> context_;
  std::vector<SensorGroup> sensor_groups_;
  std::vector<double> periods_;
};

}  // namespace dfr::safety
