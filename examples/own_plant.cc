// Your robot as a core::Plant, for rollouts, recoveries and experiments.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "dfr/control/published/switching_controller.h"
#include "dfr/control/rollout.h"

namespace {

using dfr::core::PlantStatus;

// A cart on a rail that must stop at x = 1 and must not pass 1.2.
class Cart final : public dfr::core::Plant {
 public:
  Cart() { layout_.Add("cart", 1); }
  const dfr::core::StateLayout& layout() const noexcept override { return layout_; }
  int control_dim() const noexcept override { return 1; }
  void Reset(std::uint64_t seed) override { x_ = 0.001 * static_cast<double>(seed % 100); }
  PlantStatus Apply(std::span<const double> control) noexcept override {
    if (control.size() != 1 || !std::isfinite(control[0])) return PlantStatus::kRefused;
    x_ += std::clamp(control[0], -0.1, 0.1);  // send it and wait until the robot is at rest
    return PlantStatus::kOk;                  // kFault if it does not answer
  }
  void Observe(std::span<double> state) const noexcept override { state[0] = x_; }
  bool completed() const noexcept override { return std::abs(x_ - 1.0) < 0.05; }
  bool collided() const noexcept override { return x_ > 1.2; }
  void Halt() noexcept override {}

 private:
  dfr::core::StateLayout layout_;
  double x_ = 0.0;
};

class Forward final : public dfr::core::Policy {
 public:
  int state_dim() const noexcept override { return 1; }
  int control_dim() const noexcept override { return 1; }
  void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
    u[0] = 0.08;
  }
};

// The support [-0.3, 1.1]. TimeVaryingSupport::Fit() fits a support to demonstrations.
class Rail final : public dfr::core::DecisionFunction {
 public:
  int state_dim() const noexcept override { return 1; }
  int num_steps() const noexcept override { return 1; }
  double Decision(int, std::span<const double> x) const noexcept override {
    return 0.7 - std::abs(x[0] - 0.4);
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    g[0] = x[0] > 0.4 ? -1.0 : 1.0;
    return Decision(t, x);
  }
};

}  // namespace

int main() {
  Cart cart;
  const Forward policy;
  const Rail support;
  dfr::control::SwitchingController controller(policy, support, /*lambda=*/1.0);
  const auto result = dfr::control::Rollout(cart, controller, {.plant_seed = 7});
  std::printf("%s after %d controls\n", Name(result.outcome), result.controls());
  return result.outcome == dfr::core::Outcome::kCompleted ? 0 : 1;
}
