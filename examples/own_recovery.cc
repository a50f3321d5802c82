// Your own recovery as a control::RecoveryStrategy. This one climbs the gradient of the support,
// which is correct if a control is a change of the state.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>

#include "dfr/control/published/recovery_strategy.h"
#include "dfr/control/published/switching_controller.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/policy.h"

namespace {

using dfr::control::Mode;

class Inward final : public dfr::control::RecoveryStrategy {
 public:
  Inward(const dfr::core::DecisionFunction& support, double size)
      : support_(&support), size_(size) {}
  void Reset(std::uint64_t) noexcept override {}
  // Writes one control of a recovery. The calling controller checks states and controls.
  Mode Next(const dfr::control::RecoverySituation& situation,
            std::span<double> u) noexcept override {
    support_->Gradient(situation.t, situation.x, u);
    double norm = 0.0;
    for (const double entry : u) norm = std::hypot(norm, entry);
    if (norm == 0.0) return Mode::kHalt;  // no direction to go
    for (double& entry : u) entry *= size_ / norm;
    return Mode::kRecovery;
  }

 private:
  const dfr::core::DecisionFunction* support_;
  double size_;
};

class Disk final : public dfr::core::DecisionFunction {
 public:
  int state_dim() const noexcept override { return 2; }
  int num_steps() const noexcept override { return 1; }
  double Decision(int, std::span<const double> x) const noexcept override {
    return 1.0 - std::hypot(x[0], x[1]);
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    const double r = std::hypot(x[0], x[1]);
    for (std::size_t i = 0; i < 2; ++i) g[i] = r > 0.0 ? -x[i] / r : 0.0;
    return Decision(t, x);
  }
};

class Outward final : public dfr::core::Policy {
 public:
  int state_dim() const noexcept override { return 2; }
  int control_dim() const noexcept override { return 2; }
  void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
    u[0] = 0.2;
    u[1] = 0.0;
  }
};

}  // namespace

int main() {
  const Disk support;
  const Outward policy;
  const std::array<double, 1> lambda = {1.0};
  dfr::control::SwitchingController controller(policy, support, lambda,
                                               std::make_unique<Inward>(support, /*size=*/0.1));
  controller.Reset(/*seed=*/1);
  std::array<double, 2> x = {0.0, 0.0};
  std::array<double, 2> u{};
  int recoveries = 0;
  for (int i = 0; i < 20; ++i) {
    const dfr::control::Step step = controller.Next(x, u);
    recoveries += step.mode == Mode::kRecovery ? 1 : 0;
    for (std::size_t k = 0; k < 2; ++k) x[k] += u[k];
    if (support.Decision(0, x) < 0.0) return 1;
  }
  std::printf("%d of 20 controls were recoveries; at x = %.1f\n", recoveries, x[0]);
  return recoveries > 0 ? 0 : 1;
}
