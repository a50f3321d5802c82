#include <algorithm>
#include <cmath>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kToolGain = 0.02;  // displacement of the tool by a control of norm 1
constexpr double kSpring = 0.012;   // depth at which the force is 1
constexpr double kMost = 1.5;       // maximum force
constexpr double kWipes = 0.2;      // minimum force with which the tool wipes
constexpr double kSkip = 0.03;      // maximum step between wiped points
constexpr double kLength = 0.6;

// A tool wipes a curved surface along x. The state includes the force, but neither the height nor
// the slope of the surface. State: tool(2), force(1), wiped(1), the end of the wiped part; hidden:
// the surface's offset and slope.
class WipePlant final : public Cloned<WipePlant> {
 public:
  WipePlant() : Cloned({{"tool", 0, 2}, {"force", 0, 1}, {"wiped", 0, 1}}, 2, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double wanted = 0.7 + 0.03 * variation.offset;
    const bool touches = x(2) > 0.0;
    // Moves down to the surface at the end of the wiped part, then along it as fast as the force
    // allows.
    const double off = x(2) - wanted;
    u[0] = !touches ? std::clamp((x(3) - x(0)) / kToolGain, -0.5, 0.5)
                    : 0.5 * std::clamp(1.0 - 1.5 * std::abs(off), 0.0, 1.0);
    u[1] = !touches ? -0.35 : std::clamp(0.7 * kSpring / kToolGain * off, -0.3, 0.5);
  }

 private:
  [[nodiscard]] double Surface(double along) const noexcept {
    return x(4) + x(5) * along + 0.02 * std::sin(6.0 * along);
  }
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.02, 0.02);
    x(1) = 0.15 + random.Uniform(-0.02, 0.02);
    x(4) = random.Uniform(-0.015, 0.015);
    x(5) = random.Uniform(-0.08, 0.08);
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      x(0) += kToolGain / kLooks * u[0];
      x(1) += kToolGain / kLooks * u[1];
      x(2) = std::max(0.0, (Surface(x(0)) - x(1)) / kSpring);
      FailIf(x(2) > kMost);
      const double ahead = x(0) - x(3);
      if (x(2) >= kWipes && ahead > 0.0 && ahead < kSkip) x(3) = x(0);
    }
    FailIf(x(0) < -0.2 || x(0) > kLength + 0.2 || x(1) > 0.3);
  }
  [[nodiscard]] bool Done() const noexcept override { return x(3) >= kLength; }
};

}  // namespace

GalleryTask WipeTask() {
  return {.name = "wipe",
          .summary =
              "A tool wipes a bent surface of unknown height and slope; pressing harder than "
              "twice the usual force fails",
          .plant = std::make_shared<WipePlant>(),
          .horizon = 200,
          .noise = 0.08,
          .weak_epochs = 5,
          .policy_bias = {.bias = {0.0, -0.17}}};
}

}  // namespace dfr::sim::internal
