#include <cmath>

#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kWall = -1.15;
constexpr double kTop = 0.45;
constexpr double kForce = 0.0015;
constexpr double kGravity = 0.0025;

// Moore's car in a valley (1990), three of its steps per control, with a wall on the left.
// State: car(2) as position and speed.
class CarPlant final : public Cloned<CarPlant> {
 public:
  CarPlant() : Cloned({{"car", 0, 2}}, 0, 1) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    // Accelerates with the motion, but only to a speed at which the brakes can stop before the
    // wall.
    const double turn = kWall + 0.12 + 0.02 * habit.offset;
    const double room =
        kForce * (x(0) - turn) + kGravity / 3.0 * (std::sin(3.0 * turn) - std::sin(3.0 * x(0)));
    u[0] = x(1) < 0.0 && 0.5 * x(1) * x(1) > 0.7 * room ? 1.0 : std::copysign(0.8, x(1));
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.62, -0.42);
    x(1) = random.Uniform(-0.005, 0.005);
  }
  void Step(std::span<const double> u) noexcept override {
    for (int i = 0; i < 3; ++i) {
      x(1) += kForce * u[0] - kGravity * std::cos(3.0 * x(0));
      x(0) += x(1);
      FailIf(x(0) < kWall);
    }
  }
  [[nodiscard]] bool Done() const noexcept override { return x(0) >= kTop; }
};

}  // namespace

GalleryTask CarTask() {
  return {.name = "car",
          .summary =
              "A car swings up a valley that is too steep for it; the wall on the left "
              "fails; it rolls where nothing is done",
          .plant = std::make_shared<CarPlant>(),
          .aftermath = 60,
          .noise = 0.15,
          .weak_epochs = 4,
          .flaw = {.bias = {-0.8}}};
}

}  // namespace dfr::sim::internal
