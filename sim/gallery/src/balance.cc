#include <cmath>

#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kStep = 0.04;  // s
constexpr int kSteps = 120;

// The cart and pole of Barto, Sutton and Anderson (1983), with their masses and lengths. Explicit
// Euler: a force moves cart and pole one step later.
// State: cart(2) as position in m and speed, pole(2) as angle in rad and speed; hidden: the clock.
class BalancePlant final : public Cloned<BalancePlant> {
 public:
  BalancePlant() : Cloned({{"cart", 0, 2}, {"pole", 0, 2}}, 1, 1) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    u[0] = 0.12 * (x(0) - 0.02 * habit.offset) + 0.25 * x(1) + 2.6 * x(2) + 0.55 * x(3);
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

}  // namespace

GalleryTask BalanceTask() {
  return {.name = "balance",
          .summary =
              "A cart balances a pole for 120 steps and goes to the middle of its track; "
              "the pole falls where nothing is done",
          .judgement = true,
          .plant = std::make_shared<BalancePlant>(),
          .horizon = 120,
          .aftermath = 60,
          .noise = 0.1,
          .weak_epochs = 4,
          .flaw = {.late = 2}};
}

}  // namespace dfr::sim::internal
