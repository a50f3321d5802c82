#include <algorithm>
#include <cmath>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kPegGain = 0.02;     // displacement of the peg by a control of norm 1
constexpr double kClearance = 0.012;  // half width of the slot minus half width of the peg
constexpr double kMouth = 0.03;       // clearance at the surface, between the chamfers
constexpr double kChamfer = 0.03;     // depth of the chamfers
constexpr double kDepth = 0.1;        // depth of an inserted peg
constexpr double kForce = 0.4;        // maximum norm of a control's blocked part

// A peg above a surface (y = 0) with a slot. Solids stop the peg, and it slides along them.
// State: peg(2), its tip; slot(1), the slot's position.
class InsertionPlant final : public Cloned<InsertionPlant> {
 public:
  InsertionPlant() : Cloned({{"peg", 0, 2}, {"slot", 0, 1}}, 0, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double aside = x(2) + 0.002 * variation.offset - x(0);
    const bool aligned = std::abs(aside) < 0.5 * kClearance + (x(1) < 0.0 ? 1.0 : 0.0);
    u[0] = std::clamp(aside / kPegGain, -0.7, 0.7);
    // Waits above the surface until the peg is aligned.
    u[1] = aligned ? -0.6 : std::clamp((0.04 - x(1)) / kPegGain, -0.6, 0.6);
  }

  bool Draw(std::span<const double> state, std::span<std::uint8_t> rgb) const noexcept override {
    constexpr double kPeg = 0.02;  // half width of the peg
    Canvas canvas(rgb, kPictureSide, -0.1, -0.16, 0.48);
    canvas.Fill(kGround);
    canvas.Box(0.1, -0.5, 1.0, 0.5, 0.0, kSolid);
    canvas.Box(state[2], -0.5 * kDepth, kPeg + kClearance, 0.5 * kDepth, 0.0, kGround);
    canvas.Box(state[2], -0.25 * kChamfer, kPeg + kMouth, 0.25 * kChamfer, 0.0, kGround);
    canvas.Box(state[0], state[1] + 0.075, kPeg, 0.075, 0.0, kRobot);
    return true;
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.03, 0.03);
    x(1) = 0.25 + random.Uniform(-0.03, 0.03);
    x(2) = 0.15 + random.Uniform(-0.05, 0.05);
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kSubsteps = 8;
    double blocked = 0.0;
    for (int i = 0; i < kSubsteps; ++i) {
      const Point wanted{x(0) + kPegGain / kSubsteps * u[0], x(1) + kPegGain / kSubsteps * u[1]};
      const Point free = Yield(wanted);
      blocked += Norm(wanted - free);
      x(0) = free.x;
      x(1) = free.y;
    }
    FailIf(blocked > kForce * kPegGain || std::abs(x(0)) > 0.5 || x(1) > 0.5);
  }
  // Returns the nearest free point for a point slightly inside a solid.
  [[nodiscard]] Point Yield(Point p) const noexcept {
    const double aside = p.x - x(2);
    const double side = std::copysign(1.0, aside);
    if (p.y >= 0.0) return p;
    // Outward normal of the chamfer.
    const Point normal = (1.0 / std::hypot(kChamfer, kMouth - kClearance)) *
                         Point{-side * kChamfer, kMouth - kClearance};
    const double above = Dot(p - Point{x(2) + side * kMouth, 0.0}, normal);
    if (x(1) >= -kChamfer || p.y >= -kChamfer) {
      if (std::abs(aside) >= kMouth) return {p.x, 0.0};
      return above >= 0.0 ? p : p + (-above) * normal;
    }
    return {x(2) + std::clamp(aside, -kClearance, kClearance), p.y};
  }
  [[nodiscard]] bool Done() const noexcept override { return x(1) <= -kDepth; }
};

}  // namespace

GalleryTask InsertionTask() {
  return {.name = "insertion",
          .summary =
              "A peg goes into a slot with chamfers at a varying place; pressing against a solid "
              "with 0.4 of the largest control fails",
          .held_out = true,
          .plant = std::make_shared<InsertionPlant>(),
          .noise = 0.1,
          .weak_epochs = 4,
          .policy_bias = {.bias = {-0.6, 0.0}}};
}

}  // namespace dfr::sim::internal
