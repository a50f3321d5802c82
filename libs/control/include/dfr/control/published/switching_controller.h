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

/// Behaviour of SwitchingController near the boundary of the support: the methods of Sec. V-A.
enum class Recovery {
  kNone,           ///< Baseline: the learned policy alone. Never evaluates g.
  kEarlyStopping,  ///< Halts instead of recovering.
  kDfr,            ///< DerivativeFreeRecovery.
};

/// Returns "baseline", "early-stopping" or "dfr".
[[nodiscard]] const char* Name(Recovery recovery) noexcept;

/// Options for SwitchingController. Defaults are the constants of the paper's experiments.
struct SwitchingControllerOptions {
  Recovery recovery = Recovery::kDfr;
  int horizon = 100;         ///< T: number of the policy's controls in an episode, > 0.
  int first_step = 0;        ///< t of an episode's first control, in [0, T).
  int max_iterations = 500;  ///< Iterations of a recovery, > 0, after which the controller halts.
  DfrOptions dfr = {};
};

/// Algorithm 1, one control at a time. In state x at time step t, with u = pi(x):
///   g_t(x) > lambda_t |u|   applies u, then t <- t + 1 (halts at t = T, kTimeUp);
///   g_t(x) <= 0             halts, kOutsideSupport;
///   otherwise               recovers: t stays, and after each iteration the gate is checked with a
///                           new u. Halts after max_iterations, kIterationLimit. Early stopping
///                           halts at once, kEarlyStopping.
/// Differences from the printed algorithm:
/// - The paper does not treat g <= 0. The size of the probe, a multiple of g/lambda, is then zero
/// or negative, and no allowed control can bring the state back. This class halts, as the authors'
/// code does.
/// - The paper states the limit of iterations in Sec. V-A, not in the algorithm.
/// - The proof of Prop. IV.3 assumes g_{t+1}(x_{t+1}) >= g_t(x_t) - LK|u_t|, but Lipschitz
/// continuity bounds the change of one g. The guarantee therefore holds for supports that do not
/// depend on t, or while t does not advance. With one estimate per time step the gate uses g_t
/// alone, as printed. The state after a step is still in B_t, and safe if B_t is, but may be
/// outside B_{t+1}, where this controller halts.
class SwitchingController final : public Controller {
 public:
  /// Borrows policy and support, which must outlive this object. `lambda` has one value per time
  /// step, as EstimateLambda() returns, or a single value. Later time steps use the last value.
  /// Recovery::kNone ignores the support's values and lambda.
  /// @throws std::invalid_argument naming the argument whose size differs, the lambda that is not
  /// positive and finite, or the option that is out of range.
  SwitchingController(const core::Policy& policy, const core::DecisionFunction& support,
                      std::span<const double> lambda,
                      const SwitchingControllerOptions& options = {});
  /// Overload with any strategy, which must not be null. Ignores `options.recovery` and
  /// `options.dfr`.
  SwitchingController(const core::Policy& policy, const core::DecisionFunction& support,
                      std::span<const double> lambda, std::unique_ptr<RecoveryStrategy> strategy,
                      const SwitchingControllerOptions& options = {});
  /// Overload with one lambda for all time steps.
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
