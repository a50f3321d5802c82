#include <array>
#include <cmath>

#include "dfr/control/published/switching_controller.h"

namespace {

// A support that is a disk of radius 1, and a policy that runs to the right.
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

class Right final : public dfr::core::Policy {
 public:
  int state_dim() const noexcept override { return 2; }
  int control_dim() const noexcept override { return 2; }
  void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
    u[0] = 0.2;
    u[1] = 0.0;
  }
};

}  // namespace

// Within the disk the policy is applied; where its step could leave the disk, it is not.
int main() {
  const Disk support;
  const Right policy;
  dfr::control::SwitchingController controller(policy, support, /*lambda=*/1.0);
  controller.Reset(/*seed=*/1);
  std::array<double, 2> u{};
  const auto inner = controller.Next(std::array{0.0, 0.0}, u);
  const bool applied = inner.mode == dfr::control::Mode::kPolicy && u[0] == 0.2;
  const auto outer = controller.Next(std::array{0.9, 0.0}, u);
  return applied && outer.mode == dfr::control::Mode::kProbe ? 0 : 1;
}
