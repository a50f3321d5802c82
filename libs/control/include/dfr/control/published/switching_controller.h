#pragma once

#include <memory>
#include <span>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/control/published/derivative_free_recovery.h"
#include "dfr/control/published/recovery_strategy.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// What SwitchingController does near the boundary of the support: the methods of Sec. V-A.
enum class Recovery {
  kNone,           ///< Baseline: the learned policy alone. Never looks at g.
  kEarlyStopping,  ///< Halts.
  kDfr,            ///< DerivativeFreeRecovery.
};

/// "baseline", "early-stopping", "dfr".
[[nodiscard]] const char* Name(Recovery recovery) noexcept;

/// Options for SwitchingController. Defaults are the constants of the paper's experiments.
struct SwitchingControllerOptions {
  Recovery recovery = Recovery::kDfr;
  int horizon = 100;         ///< T: the policy's controls in an episode, > 0.
  int first_step = 0;        ///< t of an episode's first control, in [0, T): to begin in mid-task.
  int max_iterations = 500;  ///< In one recovery, > 0; the policy then halts.
  DfrOptions dfr = {};
};

/// Algorithm 1, one control at a time. In state x at time step t, with u = pi(x):
///   g_t(x) > lambda_t |u|   applies u, then t <- t + 1 (after T of them: halts, kTimeUp);
///   g_t(x) <= 0             halts, kOutsideSupport;
///   otherwise               recovers: t stays, and the gate is looked at again after each
///   iteration
///                           with a new u; after max_iterations of them it halts, kIterationLimit.
///                           Early stopping halts at once, kEarlyStopping.
///
/// Where this is more than, or apart from, the printed algorithm:
/// - It says nothing of g <= 0. The size of its probe, g/lambda up to a factor, is then zero or
///   meaningless: nothing that it may do can bring the state back, so it halts, as its authors did.
/// - The limit of iterations is in the text (Sec. V-A), not in the algorithm.
/// - The proof of Prop. IV.3 takes g_{t+1}(x_{t+1}) >= g_t(x_t) - LK|u_t|, yet Lipschitz continuity
///   bounds the change of one g. The guarantee therefore holds for supports that do not depend on
///   t, or as long as t does not advance. With one estimate per time step the gate is, as printed,
///   on g_t alone; the state after a step is still in B_t, and hence safe if B_t is, but need not
///   be in B_{t+1}, where this policy then halts.
class SwitchingController final : public Controller {
 public:
  /// Borrows policy and support, which must outlive this. `lambda` has one value per time step, as
  /// from EstimateLambda(), or just one; later time steps use the last. Recovery::kNone ignores
  /// support's values and lambda.
  /// @throws std::invalid_argument if sizes differ, a lambda is not positive and finite, or an
  ///   option is out of range; the message names which.
  SwitchingController(const core::Policy& policy, const core::DecisionFunction& support,
                      std::span<const double> lambda,
                      const SwitchingControllerOptions& options = {});
  /// The same with any strategy, which must not be null; `options.recovery` and `options.dfr` are
  /// ignored.
  SwitchingController(const core::Policy& policy, const core::DecisionFunction& support,
                      std::span<const double> lambda, std::unique_ptr<RecoveryStrategy> strategy,
                      const SwitchingControllerOptions& options = {});
  /// The same lambda at all time steps.
  SwitchingController(const core::Policy& policy, const core::DecisionFunction& support,
                      double lambda, const SwitchingControllerOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;
  [[nodiscard]] Step Recover(Step step, std::span<const double> x, std::span<double> u) noexcept;
  [[nodiscard]] double lambda(int t) const noexcept;

  const core::Policy* policy_;
  const core::DecisionFunction* support_;
  std::vector<double> lambda_;
  SwitchingControllerOptions options_;
  std::unique_ptr<RecoveryStrategy> strategy_;

  int t_ = 0;
  int iteration_ = 0;
  bool probing_ = false;
  double threshold_ = 0.0;
};

}  // namespace dfr::control
