#include "dfr/control/published/gradient_recovery.h"

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

using core::AsSpan;

GradientRecovery::GradientRecovery(const TaskView& task, double control_limit)
    : task_((CheckFits(task), task)),
      limits_{Eigen::VectorXd::Constant(task.response().control_dim(),
                                        control_limit / task.response().control_unit())},
      // Algorithm 1 recovers at rest: only its controls cause motion.
      estimate_(task.response().prior(), {}, /*drift=*/false),
      fit_(estimate_.MakeFit()),
      z_(Eigen::VectorXd::Zero(task.features().num_features())),
      dz_(z_),
      v_(Eigen::VectorXd::Zero(task.response().control_dim())) {
  DFR_THROW_UNLESS(control_limit > 0.0, "control_limit must be positive, not " << control_limit);
}

void GradientRecovery::Reset(std::uint64_t /*seed*/) noexcept { estimate_.Reset(); }

Mode GradientRecovery::Next(const RecoverySituation& situation, std::span<double> u) noexcept {
  task_.features().Apply(situation.x, AsSpan(z_));
  if (situation.iteration > 0) {
    dz_ = z_ - core::AsVector(fit_.z());
    estimate_.Update(fit_, AsSpan(v_), AsSpan(dz_));
  }
  estimate_.FitAt(situation.t, AsSpan(z_), fit_);
  v_.setZero();
  static_cast<void>(AscendSupport({task_.support(), fit_},
                                  {situation.t, task_.levels().gate(situation.t)}, limits_, v_));
  core::AsVector(u) = v_ * task_.response().control_unit();
  return v_.isZero(0.0) ? Mode::kHalt : Mode::kRecovery;
}

}  // namespace dfr::control
