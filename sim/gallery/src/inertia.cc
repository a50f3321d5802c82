#include <array>

#include "geometry.h"
#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kStep = 0.1;  // time step
constexpr double kForce = 1.0;
const Box kWall{{0.45, -0.8}, {0.55, 0.15}};
const Disc kGoal{{1.0, 0.0}, 0.06};

// A frictionless mass accelerated by forces. State: point(2), velocity(2).
class InertiaPlant final : public Cloned<InertiaPlant> {
 public:
  InertiaPlant() : Cloned({{"point", 0, 2}, {"velocity", 0, 2}}, 0, 2) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    const double y = 0.28 + 0.02 * habit.offset;
    const std::array<Point, 5> path{{{0.0, 0.0}, {0.4, y}, {0.6, y}, kGoal.centre, kGoal.centre}};
    const Point p{x(0), x(1)};
    const Point wanted = Shortened(1.5 * (Ahead(path, p, 0.15) - p), 0.25);
    u[0] = 4.0 * (wanted.x - x(2)) / kForce;
    u[1] = 4.0 * (wanted.y - x(3)) / kForce;
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.05, 0.05);
    x(1) = random.Uniform(-0.05, 0.05);
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      for (int i = 0; i < 2; ++i) {
        x(2 + i) += kStep / kLooks * kForce * u[static_cast<std::size_t>(i)];
        x(i) += kStep / kLooks * x(2 + i);
      }
      const Point p{x(0), x(1)};
      FailIf(kWall.Contains(p) || !Box{{-0.4, -0.6}, {1.4, 0.8}}.Contains(p));
    }
  }
  [[nodiscard]] bool Done() const noexcept override {
    return kGoal.Contains({x(0), x(1)}) && std::hypot(x(2), x(3)) < 0.15;
  }
};

}  // namespace

GalleryTask InertiaTask() {
  return {.name = "inertia",
          .summary =
              "A mass that forces accelerate flies round a wall and stops at the goal; zero "
              "control lets it fly on",
          .plant = std::make_shared<InertiaPlant>(),
          .horizon = 150,
          .aftermath = 50,
          .noise = 0.2,
          .weak_epochs = 10,
          .flaw = {.turn = 0.5}};
}

}  // namespace dfr::sim::internal
