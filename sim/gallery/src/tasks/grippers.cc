#include <algorithm>
#include <cmath>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

// A gripper takes an object from a table. Closing takes 3 to 8 steps, at random.
// State: gripper(2), closed(1) in [0, 1], object(2); hidden: fraction closed by a control of 1,
// whether the object is held.
class GraspPlant final : public Cloned<GraspPlant> {
  static constexpr double kGain = 0.03;     // displacement of the gripper by a control of 1
  static constexpr double kHeight = 0.05;   // height of the object
  static constexpr double kSlack = 0.015;   // maximum offset of an object between the fingers
  static constexpr double kFingers = 0.05;  // minimum offset of fingers beside the object
  static constexpr double kLetsGo = 0.8;    // value of `closed` below which the object falls
  static constexpr double kLifted = 0.15;

 public:
  GraspPlant() : Cloned({{"gripper", 0, 2}, {"closed", 0, 1}, {"object", 0, 2}}, 2, 3) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const double aside = x(3) + 0.002 * variation.offset - x(0);
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

  bool Draw(std::span<const double> state, std::span<std::uint8_t> rgb) const noexcept override {
    constexpr double kHalf = 0.012;  // half width of the object and of a finger
    Canvas canvas(rgb, kPictureSide, -0.1, -0.06, 0.54);
    canvas.Fill(kGround);
    canvas.Box(0.2, -0.5, 1.0, 0.5, 0.0, kSolid);
    canvas.Box(state[3], state[4] + 0.5 * kHeight, kHalf, 0.5 * kHeight, 0.0, kObject);
    const double aside = kFingers + state[2] * (2.0 * kHalf - kFingers);
    for (const double side : {-1.0, 1.0}) {
      canvas.Box(state[0] + side * aside, state[1] + 0.035, kHalf, 0.035, 0.0, kRobot);
    }
    canvas.Box(state[0], state[1] + 0.08, kFingers + kHalf, 0.012, 0.0, kRobot);
    return true;
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
      // A half-closed gripper can neither pass over the object nor leave it.
      FailIf(!between() && x(2) > 0.4 && aside < kFingers && x(1) < 2.0 * kHeight);
    }
    FailIf(x(1) < -0.005 || x(1) > 0.5 || std::abs(x(0)) > 0.8);
  }
  [[nodiscard]] bool Done() const noexcept override { return held() && x(4) >= kLifted; }
};

// A gripper lifts a lid by its handle, which moves on a circle.
// State: gripper(2), closed(1) in [0, 1], lid(1) in rad; hidden: whether the handle is held.
class LidPlant final : public Cloned<LidPlant> {
  static constexpr double kGain = 0.03;      // displacement of the gripper by a control of 1
  static constexpr double kGripRate = 0.25;  // closing of the gripper by a control of 1
  static constexpr double kRadius = 0.4;     // radius of the handle around the hinge, the origin
  static constexpr double kGap = 0.03;       // distance from the circle at which the handle slips
  static constexpr double kOpen = 1.2;       // rad

 public:
  LidPlant() : Cloned({{"gripper", 0, 2}, {"closed", 0, 1}, {"lid", 0, 1}}, 1, 3) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    Point motion{};
    if (held()) {
      const Point out = (1.0 / Norm(p)) * p;
      motion = 0.7 * Point{-out.y, out.x} + ((kRadius - Norm(p)) / kGain) * out;
    } else {
      motion = Shortened((1.0 / kGain) * (Point{kRadius, 0.003 * variation.offset} - p), 0.7);
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
      // Collision with the chest below the lid, or of a closed gripper with the handle.
      FailIf((x(1) < -0.02 && x(0) < kRadius + 0.02) || (x(2) > 0.8 && distance >= kGap));
    }
    FailIf(Norm(p) > 1.0);
  }
  [[nodiscard]] bool Done() const noexcept override { return held() && x(3) >= kOpen; }
};

// A gripper picks an object and places it on the spot at kPlace. The first three entries of a
// control are in metres. The last entry opens (< 0) or closes (> 0) the gripper, at one speed.
// State: gripper(3) in m, closed(1) in [0, 1], object(3) in m; hidden: whether the object is held.
class PickPlant final : public Cloned<PickPlant> {
  // Fraction of its range by which the gripper opens or closes in a step.
  static constexpr double kRate = 0.25;
  static constexpr double kSlack = 0.012;   // m, maximum offset of an object between the fingers
  static constexpr double kFingers = 0.04;  // m, minimum offset of fingers beside the object
  static constexpr double kHeight = 0.04;   // m, height of the object
  static constexpr double kStep = 0.018;    // m
  static constexpr Disc kPlace{{0.3, 0.0}, 0.03};

 public:
  PickPlant() : Cloned({{"gripper", 0, 3}, {"closed", 0, 1}, {"object", 0, 3}}, 1, 4) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    const Point aim = held() ? kPlace.centre : Point{x(4), x(5) + 0.0015 * variation.offset};
    // Near the table the gripper continues down; above, it first moves over the aim.
    const bool above = Norm(aim - p) < (x(2) < 0.08 ? 0.02 : 0.006);
    const bool low = x(2) < 0.014;
    const double height = above ? 0.008 : 0.12;
    const bool lifts = !above && x(2) < 0.07;
    const Point motion = lifts ? Point{} : Shortened(aim - p, kStep);
    u[0] = motion.x;
    u[1] = motion.y;
    u[2] = std::clamp(height - x(2), -kStep, kStep);
    u[3] = (held() ? !(above && low) : above && low) ? 1.0 : -1.0;
  }

 private:
  [[nodiscard]] bool held() const noexcept { return x(7) > 0.5; }
  [[nodiscard]] bool between() const noexcept {
    return std::hypot(x(0) - x(4), x(1) - x(5)) < kSlack && x(2) - x(6) < 0.02;
  }
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.03, 0.03);
    x(1) = random.Uniform(-0.03, 0.03);
    x(2) = 0.15 + random.Uniform(-0.03, 0.03);
    x(4) = 0.06 + random.Uniform(-0.06, 0.06);
    x(5) = random.Uniform(-0.08, 0.08);
  }
  void Step(std::span<const double> u) noexcept override {
    for (int i = 0; i < 3; ++i) x(i) += u[static_cast<std::size_t>(i)];
    x(3) = std::clamp(x(3) + (u[3] > 0.0 ? kRate : u[3] < 0.0 ? -kRate : 0.0), 0.0, 1.0);
    if (held()) {
      x(4) += u[0];
      x(5) += u[1];
      x(6) = std::max(0.0, x(6) + u[2]);
      if (x(3) < 0.8) {
        FailIf(x(6) > 0.015);  // dropped
        x(6) = x(7) = 0.0;
      }
    } else {
      if (x(3) >= 1.0 && between()) x(7) = 1.0;
      const double aside = std::hypot(x(0) - x(4), x(1) - x(5));
      // A finger hits the object.
      FailIf(x(2) < kHeight && aside > kSlack && aside < kFingers);
    }
    FailIf(x(2) < 0.0 || x(2) > 0.3 || std::abs(x(1)) > 0.25 || x(0) < -0.2 || x(0) > 0.5);
  }
  [[nodiscard]] bool Done() const noexcept override {
    return !held() && kPlace.Contains({x(4), x(5)});
  }
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
          .policy_bias = {.bias = {0.1, 0.0, 0.0}}};
}

GalleryTask LidTask() {
  return {.name = "lid",
          .summary =
              "A gripper takes the handle of a lid and lifts it along its circle; slipping "
              "off, letting go, closing beside it or hitting the chest fails",
          .held_out = true,
          .plant = std::make_shared<LidPlant>(),
          .noise = 0.1,
          .weak_epochs = 20,
          .policy_bias = {.turn = 0.35}};
}

GalleryTask PickTask() {
  return {.name = "pick",
          .summary =
              "A gripper picks an object and places it; actions are metres and a gripper command "
              "of +-1; "
              "hitting the object or the table, dropping and leaving the region fail",
          .plant = std::make_shared<PickPlant>(),
          .horizon = 150,
          .noise = 0.1,
          .units = {0.02, 0.02, 0.02, 1.0},
          .switches = {3},
          .weak_hidden = {32},
          .weak_epochs = 60,
          .policy_bias = {.bias = {0.006}}};
}

}  // namespace dfr::sim::internal
