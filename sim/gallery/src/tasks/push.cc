#include <algorithm>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kHalf = 0.05;         // half the side of the box
constexpr double kPusher = 0.012;      // radius
constexpr double kPusherGain = 0.012;  // displacement of the pusher by a control of norm 1
constexpr double kTurning = 0.035;     // characteristic length of the box's limit surface
constexpr double kGoal = 0.35;

// Quasi-static: the pusher moves in small substeps. On contact, the box moves along the
// frictionless contact normal and rotates according to the ellipsoidal limit surface. State:
// pusher(2), box(3) as x, y and angle.
class PushPlant final : public Cloned<PushPlant> {
 public:
  PushPlant() : Cloned({{"pusher", 0, 2}, {"box", 0, 3}}, 0, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point local = Turned(Point{x(0) - x(2), x(1) - x(3)}, -x(4));
    // Pushes off-centre to turn the box towards its target.
    const double angle = std::clamp(-3.0 * (x(3) - 0.004 * variation.offset), -0.35, 0.35);
    const double side = std::clamp(-0.08 * (angle - x(4)), -0.03, 0.03);
    const double gap = -kHalf - kPusher - local.x;  // > 0 outside the box
    const double forward = std::abs(side - local.y) > 0.02 && gap < 0.01 ? 0.2 : 0.7;
    const Point wanted =
        Turned({forward, std::clamp((side - local.y) / kPusherGain, -0.7, 0.7)}, x(4));
    u[0] = wanted.x;
    u[1] = wanted.y;
  }

  bool Draw(std::span<const double> state, std::span<std::uint8_t> rgb) const noexcept override {
    Canvas canvas(rgb, kPictureSide, -0.17, -0.32, 0.64);
    canvas.Fill(kGround);
    for (const double side : {-1.0, 1.0}) {
      canvas.Box(0.15, side * (0.04 + kHalf + 0.01), 0.4, 0.01, 0.0, kSolid);
    }
    canvas.Box(kGoal + kHalf, 0.0, 0.008, 0.04 + kHalf, 0.0, kTarget);
    canvas.Box(state[2], state[3], kHalf, kHalf, state[4], kObject);
    canvas.Disc(state[0], state[1], kPusher, kRobot);
    return true;
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = -0.1;
    x(1) = random.Uniform(-0.01, 0.01);
    x(3) = random.Uniform(-0.015, 0.015);
    x(4) = random.Uniform(-0.15, 0.15);
  }
  void Step(std::span<const double> u) noexcept override {
    if (u[0] == 0.0 && u[1] == 0.0) return;  // moves nothing, despite any overlap
    constexpr int kSubsteps = 8;
    for (int i = 0; i < kSubsteps; ++i) {
      x(0) += kPusherGain / kSubsteps * u[0];
      x(1) += kPusherGain / kSubsteps * u[1];
      Yield();
    }
    // Beyond the lane's edges, or at an angle from which the box cannot be turned back.
    FailIf(std::abs(x(3)) > 0.04 || std::abs(x(4)) > 0.6 || x(2) < -0.03);
    FailIf(std::abs(x(1)) > 0.15 || x(0) < -0.2 || x(0) > 0.5);
  }
  void Yield() noexcept {
    const Point local = Turned(Point{x(0) - x(2), x(1) - x(3)}, -x(4));
    Point surface{std::clamp(local.x, -kHalf, kHalf), std::clamp(local.y, -kHalf, kHalf)};
    Point away = local - surface;
    double distance = Norm(away);
    if (distance >= kPusher) return;
    if (distance < 1e-9) {  // inside: exits by the nearest side
      const bool by_x = kHalf - std::abs(local.x) < kHalf - std::abs(local.y);
      away =
          by_x ? Point{std::copysign(1.0, local.x), 0.0} : Point{0.0, std::copysign(1.0, local.y)};
      surface = by_x ? Point{std::copysign(kHalf, local.x), local.y}
                     : Point{local.x, std::copysign(kHalf, local.y)};
      distance = -Norm(surface - local);
    } else {
      away = (1.0 / distance) * away;
    }
    const Point normal = -1.0 * away;  // push direction of the box
    const double lever = Cross(surface, normal) / kTurning;
    const double motion = (kPusher - distance) / (1.0 + lever * lever);
    const Point shift = Turned(motion * normal, x(4));
    x(2) += shift.x;
    x(3) += shift.y;
    x(4) += motion * lever / kTurning;
  }
  [[nodiscard]] bool Done() const noexcept override { return x(2) >= kGoal; }
};

}  // namespace

GalleryTask PushTask() {
  return {.name = "push",
          .summary =
              "A pusher moves a box along a lane; the box turns unless it is pushed at its "
              "centre; leaving the lane or turning by more than 0.6 rad fails",
          .plant = std::make_shared<PushPlant>(),
          .horizon = 150,
          .noise = 0.1,
          .weak_epochs = 4,
          .policy_bias = {.bias = {0.0, 0.6}}};
}

}  // namespace dfr::sim::internal
