// Your own way to recover, as a control::Controller: here, back the way the state came.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/policy.h"

namespace {

using dfr::control::HaltCause;
using dfr::control::Mode;
using dfr::control::Step;

class Retreat final : public dfr::control::Controller {
 public:
  Retreat(const dfr::core::Policy& policy, const dfr::core::DecisionFunction& support,
          double margin)
      : policy_(&policy), support_(&support), margin_(margin) {
    way_.reserve(kMemory);  // Next() must not allocate
  }
  int state_dim() const noexcept override { return policy_->state_dim(); }
  int control_dim() const noexcept override { return policy_->control_dim(); }

 private:
  static constexpr std::size_t kMemory = 1000;

  void DoReset(std::uint64_t) noexcept override {
    t_ = 0;
    way_.clear();
  }
  // States of a wrong size or with a NaN never get here, and a NaN in u halts: Controller's part.
  Step DoNext(std::span<const double> x, std::span<double> u) noexcept override {
    Step step;
    step.t = t_;
    step.g = support_->Decision(t_, x);
    step.threshold = margin_;
    if (step.g > margin_ && way_.size() < kMemory) {
      policy_->Control(t_++, x, u);
      way_.push_back({u[0], u[1]});
      step.mode = Mode::kPolicy;
    } else if (!way_.empty()) {
      for (std::size_t k = 0; k < 2; ++k) u[k] = -way_.back()[k];
      way_.pop_back();
      step.mode = Mode::kRecovery;
    } else {
      step.cause = HaltCause::kNoDirection;  // mode is kHalt
    }
    return step;
  }

  const dfr::core::Policy* policy_;
  const dfr::core::DecisionFunction* support_;
  double margin_;
  int t_ = 0;
  std::vector<std::array<double, 2>> way_;
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
  double lipschitz_bound(int) const noexcept override { return 1.0; }
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
  Retreat controller(policy, support, /*margin=*/0.3);
  controller.Reset(/*seed=*/1);
  std::array<double, 2> x = {0.0, 0.0};
  std::array<double, 2> u{};
  int retreats = 0;
  for (int i = 0; i < 20; ++i) {
    const Step step = controller.Next(x, u);
    retreats += step.mode == Mode::kRecovery ? 1 : 0;
    for (std::size_t k = 0; k < 2; ++k) x[k] += u[k];
    if (support.Decision(0, x) < 0.0) return 1;
  }
  std::printf("%d of 20 controls were retreats; at x = %.1f\n", retreats, x[0]);
  return retreats > 0 ? 0 : 1;
}
