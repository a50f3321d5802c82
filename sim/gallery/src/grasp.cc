#include <cmath>

#include "geometry.h"
#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kGain = 0.03;     // displacement of the gripper by a control of 1
constexpr double kHeight = 0.05;   // height of the object
constexpr double kSlack = 0.015;   // maximum offset of an object between the fingers
constexpr double kFingers = 0.05;  // minimum offset of fingers beside the object
constexpr double kLetsGo = 0.8;    // opening at which the object falls
constexpr double kLifted = 0.15;

// A gripper takes an object from a table. Closing takes 3 to 8 steps, at random.
// State: gripper(2), closed(1) in [0, 1], object(2); hidden: fraction closed by a control of 1,
// whether the object is held.
class GraspPlant final : public Cloned<GraspPlant> {
 public:
  GraspPlant() : Cloned({{"gripper", 0, 2}, {"closed", 0, 1}, {"object", 0, 2}}, 2, 3) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    const double aside = x(3) + 0.002 * habit.offset - x(0);
    const bool above = std::abs(aside) < 0.5 * kSlack;
    const bool down = x(1) < 0.025 && above;
    u[0] = held() ? 0.0 : std::clamp(aside / kGain, -0.7, 0.7);
    if (held()) {
      u[1] = 0.7;
    } else if (down) {
      u[1] = (0.015 - x(1)) / kGain;
    } else {
      u[1] = std::clamp(((above ? 0.015 : 0.1) - x(1)) / kGain, -0.6, 0.6);
    }
    u[2] = held() || down ? 1.0 : -0.5;
  }

 private:
  [[nodiscard]] bool held() const noexcept { return x(6) > 0.5; }
  [[nodiscard]] bool between() const noexcept {
    return std::abs(x(0) - x(3)) < kSlack && x(1) - x(4) < 0.04;
  }

  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.03, 0.03);
    x(1) = 0.2 + random.Uniform(-0.03, 0.03);
    x(3) = 0.3 + random.Uniform(-0.08, 0.08);
    x(5) = 1.0 / random.Uniform(3.0, 8.0);
  }
  void Step(std::span<const double> u) noexcept override {
    x(0) += kGain * u[0];
    x(1) += kGain * u[1];
    x(2) = std::clamp(x(2) + x(5) * u[2], 0.0, 1.0);
    if (held()) {
      x(3) += kGain * u[0];
      x(4) = std::max(0.0, x(4) + kGain * u[1]);
      if (x(2) < kLetsGo) {
        FailIf(x(4) > 0.01);
        x(4) = x(6) = 0.0;
      }
    } else {
      if (x(2) >= 1.0 && between()) x(6) = 1.0;
      const double aside = std::abs(x(0) - x(3));
      // A finger hits the object.
      FailIf(x(1) < kHeight && aside > kSlack && aside < kFingers);
      // Half closed, the gripper can neither pass over the object nor leave it.
      FailIf(!between() && x(2) > 0.4 && aside < kFingers && x(1) < 2.0 * kHeight);
    }
    FailIf(x(1) < -0.005 || x(1) > 0.5 || std::abs(x(0)) > 0.8);
  }
  [[nodiscard]] bool Done() const noexcept override { return held() && x(4) >= kLifted; }
};

}  // namespace

GalleryTask GraspTask() {
  return {.name = "grasp",
          .summary =
              "A gripper goes over an object, down, waits until it is closed, which takes "
              "3 to 8 steps at random, and lifts; hitting, dropping and leaving early fail",
          .plant = std::make_shared<GraspPlant>(),
          .noise = 0.1,
          .weak_hidden = {16},
          .weak_epochs = 25,
          .flaw = {.bias = {0.1, 0.0, 0.0}}};
}

}  // namespace dfr::sim::internal
