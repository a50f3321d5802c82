#include "dfr/control/published/switching_controller.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

double Norm(std::span<const double> v) noexcept {
  return std::sqrt(std::inner_product(v.begin(), v.end(), v.begin(), 0.0));
}

// Returns options that create no strategy, because the caller provides one.
SwitchingControllerOptions WithoutStrategy(SwitchingControllerOptions options) {
  options.recovery = Recovery::kEarlyStopping;
  return options;
}

}  // namespace

const char* Name(Recovery recovery) noexcept {
  switch (recovery) {
    case Recovery::kNone:
      return "baseline";
    case Recovery::kEarlyStopping:
      return "early-stopping";
    case Recovery::kDfr:
      return "dfr";
  }
  return "unknown";
}

SwitchingController::SwitchingController(const core::Policy& policy,
                                         const core::DecisionFunction& support,
                                         std::span<const double> lambda,
                                         const SwitchingControllerOptions& options)
    : policy_(&policy),
      support_(&support),
      lambda_(lambda.begin(), lambda.end()),
      options_(options) {
  DFR_THROW_UNLESS(policy.state_dim() == support.state_dim(),
                   "the policy takes states of " << policy.state_dim()
                                                 << " entries, but the support takes "
                                                 << support.state_dim());
  DFR_THROW_UNLESS(!lambda_.empty(), "lambda needs at least one value");
  for (std::size_t t = 0; t < lambda_.size(); ++t) {
    DFR_THROW_UNLESS(lambda_[t] > 0.0 && std::isfinite(lambda_[t]),
                     "lambda must be positive and finite, not " << lambda_[t] << " at step " << t);
  }
  DFR_THROW_UNLESS(options.horizon > 0, "horizon must be positive, not " << options.horizon);
  DFR_THROW_UNLESS(options.first_step >= 0 && options.first_step < options.horizon,
                   "first_step must lie in [0, horizon), not " << options.first_step);
  DFR_THROW_UNLESS(options.max_iterations > 0,
                   "max_iterations must be positive, not " << options.max_iterations);
  if (options.recovery == Recovery::kDfr) {
    strategy_ = std::make_unique<DerivativeFreeRecovery>(policy.control_dim(), options.dfr);
  }
}

SwitchingController::SwitchingController(const core::Policy& policy,
                                         const core::DecisionFunction& support,
                                         std::span<const double> lambda,
                                         std::unique_ptr<RecoveryStrategy> strategy,
                                         const SwitchingControllerOptions& options)
    : SwitchingController(policy, support, lambda, WithoutStrategy(options)) {
  DFR_THROW_UNLESS(strategy != nullptr, "the recovery strategy is null");
  strategy_ = std::move(strategy);
}

SwitchingController::SwitchingController(const core::Policy& policy,
                                         const core::DecisionFunction& support, double lambda,
                                         const SwitchingControllerOptions& options)
    : SwitchingController(policy, support, std::span<const double>(&lambda, 1), options) {}

double SwitchingController::lambda(int t) const noexcept {
  return lambda_[std::min(static_cast<std::size_t>(t), lambda_.size() - 1)];
}

void SwitchingController::DoReset(std::uint64_t seed) noexcept {
  t_ = options_.first_step;
  iteration_ = 0;
  probing_ = false;
  threshold_ = 0.0;
  if (strategy_ != nullptr) strategy_->Reset(seed);
}

Step SwitchingController::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  Step step;
  step.t = t_;
  step.iteration = iteration_;
  if (probing_) {
    step.g = support_->Decision(t_, x);
    step.threshold = threshold_;
    if (!std::isfinite(step.g)) return Halted(step, HaltCause::kSupportInvalid);
    return Recover(step, x, u);
  }

  if (t_ >= options_.horizon) return Halted(step, HaltCause::kTimeUp);
  policy_->Control(t_, x, u);
  if (options_.recovery == Recovery::kNone) {
    step.mode = Mode::kPolicy;
    ++t_;
    return step;
  }

  step.g = support_->Decision(t_, x);
  threshold_ = lambda(t_) * Norm(u);
  step.threshold = threshold_;
  if (!std::isfinite(threshold_)) return Halted(step, HaltCause::kControlInvalid);
  if (!std::isfinite(step.g)) return Halted(step, HaltCause::kSupportInvalid);
  if (step.g > threshold_) {
    step.mode = Mode::kPolicy;
    step.iteration = 0;
    iteration_ = 0;
    ++t_;
    return step;
  }
  if (step.g <= 0.0) return Halted(step, HaltCause::kOutsideSupport);
  if (strategy_ == nullptr) return Halted(step, HaltCause::kEarlyStopping);
  if (iteration_ >= options_.max_iterations) return Halted(step, HaltCause::kIterationLimit);
  return Recover(step, x, u);
}

Step SwitchingController::Recover(Step step, std::span<const double> x,
                                  std::span<double> u) noexcept {
  step.mode = strategy_->Next({t_, iteration_, x, step.g, lambda(t_)}, u);
  if (step.mode == Mode::kHalt) return Halted(step, HaltCause::kNoDirection);
  probing_ = step.mode == Mode::kProbe;
  if (!probing_) ++iteration_;
  return step;
}

}  // namespace dfr::control
