#include <cmath>

#include "geometry.h"
#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kGain = 0.03;      // displacement of the gripper by a control of 1
constexpr double kGripRate = 0.25;  // closing of the gripper by a control of 1
constexpr double kRadius = 0.4;     // radius of the handle around the hinge, the origin
constexpr double kGap = 0.03;       // distance from the circle at which the handle slips
constexpr double kOpen = 1.2;       // rad

// A gripper lifts a lid by its handle, which moves on a circle.
// State: gripper(2), closed(1) in [0, 1], lid(1) in rad; hidden: whether the handle is held.
class LidPlant final : public Cloned<LidPlant> {
 public:
  LidPlant() : Cloned({{"gripper", 0, 2}, {"closed", 0, 1}, {"lid", 0, 1}}, 1, 3) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    Point motion{};
    if (held()) {
      const Point out = (1.0 / Norm(p)) * p;
      motion = 0.7 * Point{-out.y, out.x} + ((kRadius - Norm(p)) / kGain) * out;
    } else {
      motion = Shortened((1.0 / kGain) * (Point{kRadius, 0.003 * habit.offset} - p), 0.7);
    }
    u[0] = motion.x;
    u[1] = motion.y;
    const bool close = held() || Norm(p - Point{kRadius, 0.0}) < 0.015;
    u[2] = close ? 0.8 : -0.3;
  }

 private:
  [[nodiscard]] bool held() const noexcept { return x(4) > 0.5; }

  void Start(core::Random& random) noexcept override {
    x(0) = 0.55 + random.Uniform(-0.05, 0.05);
    x(1) = 0.25 + random.Uniform(-0.05, 0.05);
  }
  void Step(std::span<const double> u) noexcept override {
    x(0) += kGain * u[0];
    x(1) += kGain * u[1];
    x(2) = std::clamp(x(2) + kGripRate * u[2], 0.0, 1.0);
    const Point p{x(0), x(1)};
    if (held()) {
      x(3) = std::max(0.0, std::atan2(x(1), x(0)));
      // The handle slips or is released: the lid falls.
      FailIf(std::abs(Norm(p) - kRadius) > kGap || x(1) < -kGap || x(2) < 0.5);
    } else {
      const double distance = Norm(p - Point{kRadius, 0.0});
      if (x(2) > 0.8 && distance < kGap) x(4) = 1.0;
      // The chest below the lid. A closed gripper collides with the handle.
      FailIf((x(1) < -0.02 && x(0) < kRadius + 0.02) || (x(2) > 0.8 && distance >= kGap));
    }
    FailIf(Norm(p) > 1.0);
  }
  [[nodiscard]] bool Done() const noexcept override { return held() && x(3) >= kOpen; }
};

}  // namespace

GalleryTask LidTask() {
  return {.name = "lid",
          .summary =
              "A gripper takes the handle of a lid and lifts it along its circle; slipping "
              "off, letting go, closing beside it or hitting the chest fails",
          .judgement = true,
          .plant = std::make_shared<LidPlant>(),
          .noise = 0.1,
          .weak_epochs = 20,
          .flaw = {.turn = 0.35}};
}

}  // namespace dfr::sim::internal
