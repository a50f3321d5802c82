#include <array>
#include <cmath>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

// A frictionless mass accelerated by forces. State: point(2), velocity(2).
class InertiaPlant final : public Cloned<InertiaPlant> {
  static constexpr double kStep = 0.1;  // time step
  static constexpr double kForce = 1.0;
  static constexpr Box kWall{{0.45, -0.8}, {0.55, 0.15}};
  static constexpr Disc kGoal{{1.0, 0.0}, 0.06};

 public:
  InertiaPlant() : Cloned({{"point", 0, 2}, {"velocity", 0, 2}}, 0, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double y = 0.28 + 0.02 * variation.offset;
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

// The cart and pole of Barto, Sutton and Anderson (1983), with their masses and lengths. Explicit
// Euler: a force moves cart and pole one step later.
// State: cart(2) as position in m and speed, pole(2) as angle in rad and speed; hidden: the clock.
class BalancePlant final : public Cloned<BalancePlant> {
  static constexpr double kStep = 0.04;  // s
  static constexpr int kSteps = 120;

 public:
  BalancePlant() : Cloned({{"cart", 0, 2}, {"pole", 0, 2}}, 1, 1) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    u[0] = 0.12 * (x(0) - 0.02 * variation.offset) + 0.25 * x(1) + 2.6 * x(2) + 0.55 * x(3);
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.5, 0.5);
    x(1) = random.Uniform(-0.1, 0.1);
    x(2) = random.Uniform(-0.08, 0.08);
    x(3) = random.Uniform(-0.1, 0.1);
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr double kPole = 0.1;  // kg, part of the total of 1.1 kg
    constexpr double kMass = 1.1;
    constexpr double kHalf = 0.5;  // m
    const double c = std::cos(x(2));
    const double s = std::sin(x(2));
    const double push = (10.0 * u[0] + kPole * kHalf * x(3) * x(3) * s) / kMass;
    const double turn = (9.8 * s - c * push) / (kHalf * (4.0 / 3.0 - kPole * c * c / kMass));
    const double drive = push - kPole * kHalf * turn * c / kMass;
    x(0) += kStep * x(1);
    x(2) += kStep * x(3);
    x(1) += kStep * drive;
    x(3) += kStep * turn;
    x(4) += 1.0;
    FailIf(std::abs(x(2)) > 0.35 || std::abs(x(0)) > 1.0);
  }
  [[nodiscard]] bool Done() const noexcept override { return x(4) >= kSteps; }
};

// Moore's car in a valley (1990), with a wall on the left. A control lasts three of Moore's steps.
// State: car(2) as position and speed.
class CarPlant final : public Cloned<CarPlant> {
  static constexpr double kWall = -1.15;
  static constexpr double kTop = 0.45;
  static constexpr double kForce = 0.0015;
  static constexpr double kGravity = 0.0025;

 public:
  CarPlant() : Cloned({{"car", 0, 2}}, 0, 1) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    // Accelerates in the direction of motion, but decelerates in time to stop before the wall.
    const double turn = kWall + 0.12 + 0.02 * variation.offset;
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

GalleryTask InertiaTask() {
  return {.name = "inertia",
          .summary =
              "A mass that forces accelerate flies round a wall and stops at the goal; zero "
              "control lets it fly on",
          .plant = std::make_shared<InertiaPlant>(),
          .horizon = 150,
          .settle_steps = 50,
          .noise = 0.2,
          .weak_epochs = 10,
          .policy_bias = {.turn = 0.5}};
}

GalleryTask BalanceTask() {
  return {.name = "balance",
          .summary =
              "A cart balances a pole for 120 steps and goes to the middle of its track; "
              "without control the pole falls",
          .held_out = true,
          .plant = std::make_shared<BalancePlant>(),
          .horizon = 120,
          .settle_steps = 60,
          .noise = 0.1,
          .weak_epochs = 4,
          .policy_bias = {.late = 2}};
}

GalleryTask CarTask() {
  return {.name = "car",
          .summary =
              "A car swings up a valley that is too steep for it; hitting the wall on the left "
              "fails; without control it rolls",
          .plant = std::make_shared<CarPlant>(),
          .settle_steps = 60,
          .noise = 0.15,
          .weak_epochs = 4,
          .policy_bias = {.bias = {-0.8}}};
}

}  // namespace dfr::sim::internal
