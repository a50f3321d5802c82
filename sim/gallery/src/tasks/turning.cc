#include <algorithm>
#include <cmath>
#include <numbers>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

// A hand grasps a door handle, turns it until the latch is free, and pulls the door open. State:
// hand(2), handle(4) as a unit quaternion w, x, y, z with w >= 0, whose sign flips when the angle
// passes pi; door(1) in rad. Hidden: the angle, and whether the handle is held and the latch is
// free.
class DoorPlant final : public Cloned<DoorPlant> {
  static constexpr double kGain = 0.03;   // displacement of the hand by a control of 1
  static constexpr double kTurn = 0.1;    // rad, turn of the hand by a control of 1
  static constexpr double kRadius = 0.4;  // radius of the handle around the hinge, the origin
  static constexpr double kGap = 0.03;    // maximum distance of the hand from the held handle
  static constexpr double kFree = 3.5;    // rad, angle at which the latch becomes free
  static constexpr double kBreak = 4.1;   // rad, angle at which the handle breaks
  static constexpr double kOpen = 1.0;    // rad

 public:
  DoorPlant() : Cloned({{"hand", 0, 2}, {"handle", 0, 4}, {"door", 0, 1}}, 3, 3) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    const double wanted = kFree + 0.2 + 0.02 * variation.offset;
    Point motion = Shortened((1.0 / kGain) * (Point{kRadius, 0.0} - p), 0.7);
    u[2] = held() ? std::clamp((wanted - x(7)) / kTurn, -0.7, 0.7) : 0.0;
    if (held() && x(7) > kFree + 0.1) {
      const Point out = (1.0 / Norm(p)) * p;
      motion = 0.7 * Point{-out.y, out.x} + ((kRadius - Norm(p)) / kGain) * out;
    }
    u[0] = motion.x;
    u[1] = motion.y;
  }

  bool Draw(std::span<const double> state, std::span<std::uint8_t> rgb) const noexcept override {
    Canvas canvas(rgb, kPictureSide, -0.1, -0.15, 0.8);
    canvas.Fill(kGround);
    const Point handle = Turned({kRadius, 0.0}, state[6]);
    canvas.Segment(0.0, 0.0, handle.x, handle.y, 0.015, kSolid);
    canvas.Disc(handle.x, handle.y, 0.03, kObject);
    // Draws a pointer at the handle's angle, which does not depend on the quaternion's sign.
    const double turn = 2.0 * std::atan2(0.6 * state[3] + 0.8 * state[5], state[2]);
    const Point end = handle + Turned({0.12, 0.0}, turn);
    canvas.Segment(handle.x, handle.y, end.x, end.y, 0.012, kObject);
    canvas.Disc(state[0], state[1], 0.02, kRobot);
    return true;
  }

 private:
  [[nodiscard]] bool held() const noexcept { return x(8) > 0.5; }
  [[nodiscard]] bool free() const noexcept { return x(9) > 0.5; }
  void Place() noexcept {
    const double half = 0.5 * x(7);
    const double sign = std::cos(half) < 0.0 ? -1.0 : 1.0;
    x(2) = sign * std::cos(half);
    x(3) = sign * 0.6 * std::sin(half);
    x(4) = 0.0;
    x(5) = sign * 0.8 * std::sin(half);
  }
  void Start(core::Random& random) noexcept override {
    x(0) = 0.55 + random.Uniform(-0.05, 0.05);
    x(1) = 0.2 + random.Uniform(-0.05, 0.05);
    x(7) = 2.5 + random.Uniform(-0.1, 0.1);
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    x(0) += kGain * u[0];
    x(1) += kGain * u[1];
    x(7) += kTurn * u[2];
    Place();
    const Point p{x(0), x(1)};
    if (!held()) {
      if (Norm(p - Point{kRadius, 0.0}) < 0.012) x(8) = 1.0;
      // The hand touches the door, or turns too far before it holds the handle.
      FailIf(x(1) < -0.03 || x(7) > kFree);
    } else {
      if (x(7) > kFree) x(9) = 1.0;
      if (free()) x(6) = std::max(0.0, std::atan2(p.y, p.x));
      // The hand slips, or pulls a latched door.
      FailIf(Norm(p - Turned({kRadius, 0.0}, x(6))) > kGap);
      // The latch springs back if the handle is released before the door is open.
      FailIf(free() && x(6) < 0.1 && x(7) < kFree - 0.3);
    }
    FailIf(x(7) > kBreak || x(7) < 2.0 || Norm(p) > 1.0);
  }
  [[nodiscard]] bool Done() const noexcept override { return x(6) >= kOpen; }
};

// A driver turns a screw in by two and a half turns and follows it down. Without pressure the
// driver slips off; with too much pressure it cracks the screw. State: driver(2) as cosine and
// sine, height(1) of its tip, head(1), the height of the screw's head. Hidden: the angle since the
// start, without wrapping; the angle at the start.
class ScrewPlant final : public Cloned<ScrewPlant> {
  static constexpr double kTurn = 0.3;   // rad
  static constexpr double kGain = 0.05;  // upward displacement of the driver by a control of 1
  static constexpr double kPitch = 0.2;
  static constexpr double kSpring = 0.1;  // depth at which the force is 1
  static constexpr double kMost = 1.5;    // maximum force
  static constexpr double kLeast = 0.1;   // minimum force for turning by more than kSlip
  static constexpr double kSlip = 0.1;    // rad
  static constexpr double kTurns = 2.5;

 public:
  ScrewPlant() : Cloned({{"driver", 0, 2}, {"height", 0, 1}, {"head", 0, 1}}, 2, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double force = (x(3) - x(2)) / kSpring;
    const bool pressed = force > 0.35;
    u[0] = pressed ? 0.7 : 0.0;
    const double sinks = pressed ? 0.7 * kTurn * kPitch / (2.0 * std::numbers::pi) : 0.0;
    const double wanted = x(3) - (0.7 + 0.03 * variation.offset) * kSpring - sinks;
    u[1] = std::clamp((wanted - x(2)) / kGain, -0.6, 0.6);
  }

 private:
  void Place() noexcept {
    x(0) = std::cos(x(5) + x(4));
    x(1) = std::sin(x(5) + x(4));
  }
  void Start(core::Random& random) noexcept override {
    x(5) = random.Uniform(-0.3, 0.3);
    x(3) = random.Uniform(-0.02, 0.02);
    x(2) = 0.3 + random.Uniform(-0.05, 0.05);
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    const double turn = kTurn * u[0];
    x(2) += kGain * u[1];
    const double force = (x(3) - x(2)) / kSpring;
    FailIf(force > kMost || (force < kLeast && std::abs(turn) > kSlip));
    if (force >= kLeast) {
      x(4) += turn;
      x(3) -= turn * kPitch / (2.0 * std::numbers::pi);
    }
    Place();
    FailIf(x(4) < -1.0 || x(2) > 0.6);
  }
  [[nodiscard]] bool Done() const noexcept override {
    return x(4) >= kTurns * 2.0 * std::numbers::pi;
  }
};

}  // namespace

GalleryTask DoorTask() {
  return {.name = "door",
          .summary =
              "A hand turns a door's handle, given as a unit quaternion whose sign flips, and "
              "pulls the door open; slipping off, pulling too soon and turning too far fail",
          .plant = std::make_shared<DoorPlant>(),
          .noise = 0.1,
          .weak_hidden = {16},
          .weak_epochs = 15,
          .policy_bias = {.turn = 0.35}};
}

GalleryTask ScrewTask() {
  return {.name = "screw",
          .summary =
              "A driver turns a screw in by two and a half turns, seen as cosine, sine and depth; "
              "slipping off and pressing too hard fail",
          .held_out = true,
          .plant = std::make_shared<ScrewPlant>(),
          .horizon = 150,
          .noise = 0.1,
          .weak_epochs = 20,
          .policy_bias = {.bias = {0.0, 0.3}}};
}

}  // namespace dfr::sim::internal
