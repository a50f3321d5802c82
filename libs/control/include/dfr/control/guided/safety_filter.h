#pragma once

#include <Eigen/Core>
#include <limits>

#include "dfr/control/controller.h"
#include "dfr/control/guided/guided_options.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/control/response/local_fit.h"

namespace dfr::control {

/// Steps 1 to 4 of GuidedController: passes, changes or replaces a learned control. Results depend
/// only on the arguments, not on previous calls. Never allocates, locks or throws; one object
/// belongs to one thread.
class SafetyFilter {
 public:
  /// Borrows everything that `task` borrows. The options must have passed Check().
  SafetyFilter(const TaskView& task, const GuidedOptions& options);

  struct Choice {
    Mode mode = Mode::kPolicy;
    double level = 0.0;  ///< Predicted level of v in the next phase.
    double learned = std::numeric_limits<double>::quiet_NaN();  ///< Level of the learned control.
    bool stays = false;  ///< v is the learned control, and the phase stays.
  };
  /// Changes the learned control `v`, which must be within the limits, to the control to apply in
  /// the state of `fit`. `target` is the next phase and its Levels::gate(). `v` is unchanged if its
  /// predicted level in the next phase is at least `pass_level`, or if its level in the present
  /// phase is at least `stay_level` and higher than in the next phase. With least intervention, in
  /// a world at rest, and if `to_depth`, `pass_level` minus the pass depth suffices. It does not
  /// suffice if all of these hold: a corrected control is predicted to end inside, `v` is not a
  /// resting control (guided::kResting), and its level is below `pass_level` by more than
  /// Levels::prediction_error() or guided::kShallowDepth times the exit level. `v` is also
  /// unchanged if the corrected control would still end below `pass_level`, differs by at most
  /// guided::kIdle (in a world at rest, if `v` does not lower the level, kIdleAtRest), gains no
  /// more than target.level - pass_level, and does not lead back inside. The mode is kRecovery if
  /// `v` does not come from the learned control, and kProbe if `v` is a probe.
  [[nodiscard]] Choice Filter(LocalFit& fit, const StepTarget& target, double pass_level,
                              Eigen::VectorXd& v,
                              double stay_level = std::numeric_limits<double>::infinity(),
                              bool to_depth = true) noexcept;

  /// Returns the exit level >= 0: a control that passes may end outside by at most this level.
  [[nodiscard]] double max_exit_level() const noexcept { return max_exit_level_; }

 private:
  /// Raises `v` by AscendSupport(). With least intervention, guided::kLocalReach limits entries,
  /// and entries that change by more than guided::kLeastHedged make only the fraction
  /// LocalFit::Agreement() of their change. In a moving world, a raise that ends outside keeps the
  /// signs that `v` and `other` share (guided::kClearSign; nullptr: none). `v` stays unchanged if
  /// these rules lower its level.
  /// @returns the predicted level of `v`.
  double Raise(LocalFit& fit, const LocalModel& model, const StepTarget& target,
               const Eigen::VectorXd* other, Eigen::VectorXd& v) noexcept;
  /// Sets entries of `v` that a raise has reversed to the nearer of the two controls whose sign
  /// they had. @returns true if it changed `v`.
  bool KeepSigns(const Eigen::VectorXd& other, Eigen::VectorXd& v) const noexcept;
  [[nodiscard]] Choice Correct(LocalFit& fit, const LocalModel& model, const StepTarget& target,
                               Eigen::VectorXd& v) noexcept;
  /// Returns true if the drift of the features is small, and no model of a disturbance is active.
  [[nodiscard]] bool Rests(const LocalFit& fit) const noexcept;
  [[nodiscard]] bool Idle(const LocalFit& fit, const Choice& choice, const StepTarget& target,
                          double pass_level, const Eigen::VectorXd& v) const noexcept;
  [[nodiscard]] bool Probe(LocalFit& fit, const LocalModel& model, const StepTarget& target,
                           Eigen::VectorXd& v, double& level) noexcept;

  TaskView task_;
  StepLimits limits_;
  double max_exit_level_;
  double probe_size_;
  bool demonstrates_;     ///< Tries demonstrated controls first.
  double pass_depth_;     ///< Levels::pass_depth(), at most max_exit_level_. 0 without least_.
  double shallow_depth_;  ///< Depth down to which all controls pass, at most pass_depth_.
  bool least_;            ///< Least intervention.
  bool disturbed_;
  Eigen::VectorXd trial_;
  Eigen::VectorXd demonstrated_;
  Eigen::VectorXd learned_;  ///< The learned control before its correction.
  Eigen::VectorXd from_;     ///< The control before Raise().
};

}  // namespace dfr::control
