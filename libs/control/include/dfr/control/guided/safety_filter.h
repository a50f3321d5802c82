#pragma once

#include <Eigen/Core>
#include <limits>
#include <span>

#include "dfr/control/controller.h"
#include "dfr/control/guided/guided_options.h"
#include "dfr/control/guided/response_estimate.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/control/guided/task_view.h"

namespace dfr::control {

/// The recovery of GuidedController, its steps 1 to 4: decides whether a learned control passes,
/// and what takes its place. What it knows comes from the estimate of J; nothing is remembered from
/// one call to the next. Never allocates, locks or throws; one object belongs to one thread.
class SafetyFilter {
 public:
  /// Borrows what `task` does. The options are checked ones.
  SafetyFilter(const TaskView& task, const GuidedOptions& options);

  struct Choice {
    Mode mode = Mode::kPolicy;
    double level = 0.0;  ///< That v is predicted to reach in the next phase; 0 where tolerated.
    double learned = std::numeric_limits<double>::quiet_NaN();  ///< The same of the learned one.
  };
  /// At features `z`, about which `estimate` was computed last, with the learned control `v` within
  /// the limits: `v` becomes the control that is to be applied. `target` is the next phase, and hi
  /// there; a `v` that is predicted to reach `pass` there is left as it is, and so is one whose
  /// correction would be idle: it would end outside too, would change `v` by no more than
  /// guided::kIdle and gain no more than target.level - pass. kRecovery: `v` does not come from the
  /// learned control. kProbe: `v` is there to find out what it does.
  [[nodiscard]] Choice Filter(ResponseEstimate& estimate, std::span<const double> z,
                              const StepTarget& target, double pass, Eigen::VectorXd& v) noexcept;

  /// GuidedOptions::max_exit_ratio as a level: how far outside a support what passes may end, >= 0.
  [[nodiscard]] double max_exit_level() const noexcept { return max_exit_level_; }

 private:
  [[nodiscard]] Choice Correct(ResponseEstimate& estimate, const LocalModel& model,
                               const StepTarget& target, Eigen::VectorXd& v) noexcept;
  [[nodiscard]] bool Idle(const Choice& choice, double margin,
                          const Eigen::VectorXd& v) const noexcept;
  [[nodiscard]] bool Probe(ResponseEstimate& estimate, const LocalModel& model,
                           const StepTarget& target, Eigen::VectorXd& v, double& level) noexcept;

  TaskView task_;
  StepLimits limits_;
  double max_exit_level_;
  double probe_size_;
  bool demonstrates_;  ///< Demonstrated controls are tried.
  bool disturbed_;
  Eigen::VectorXd trial_;
  Eigen::VectorXd demonstrated_;
  Eigen::VectorXd learned_;  ///< The control that a correction began with.
};

}  // namespace dfr::control
