#include <algorithm>
#include <cmath>
#include <numbers>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kGain = 0.04;  // displacement of a point by a control of norm 1

// A rope, held at its end, is wound counter-clockwise around a peg and put on a hook. State:
// end(2), free(1), the length of rope that is not wound. Hidden: the angle around the peg since the
// start, without wrapping.
class RopePlant final : public Cloned<RopePlant> {
  static constexpr double kPeg = 0.1;     // radius of the peg at the origin
  static constexpr double kLength = 1.7;  // length of the rope, all of it free at the start
  static constexpr double kWound = 0.1;   // length of rope wound per rad
  static constexpr Disc kHook{{0.6, 0.3}, 0.05};
  static constexpr double kTurned = 9.0;  // rad, angle at the hook, about a turn and a half

 public:
  RopePlant() : Cloned({{"end", 0, 2}, {"free", 0, 1}}, 1, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    const Point out = (1.0 / Norm(p)) * p;
    const double radius = 0.26 + 0.01 * variation.offset;
    Point motion = Shortened((1.0 / kGain) * (kHook.centre - p), 0.8);
    if (x(3) < kTurned - 0.6) {
      const double inward = std::clamp((radius - Norm(p)) / kGain, -0.55, 0.55);
      motion = Shortened(0.75 * Point{-out.y, out.x} + inward * out, 0.8);
    }
    u[0] = motion.x;
    u[1] = motion.y;
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = -0.6 + random.Uniform(-0.04, 0.04);
    x(1) = -0.3 + random.Uniform(-0.04, 0.04);
    x(2) = kLength;
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      const Point before{x(0), x(1)};
      const Point p = before + (kGain / kLooks) * Point{u[0], u[1]};
      x(0) = p.x;
      x(1) = p.y;
      x(3) += std::atan2(Cross(before, p), Dot(before, p));
      x(2) = kLength - kWound * std::max(0.0, x(3));
      // Collision with the peg, a turn in the wrong direction, or the end of the rope.
      FailIf(Norm(p) < kPeg || x(3) < -1.0 || Norm(p) > x(2));
    }
  }
  [[nodiscard]] bool Done() const noexcept override {
    return x(3) > kTurned && kHook.Contains({x(0), x(1)});
  }
};

// A point follows a figure eight within a corridor. The point passes the middle twice, on crossing
// paths. State: point(2), heading(2), a mean of the last motions. Hidden: the position along the
// figure.
class EightPlant final : public Cloned<EightPlant> {
  static constexpr double kBegin = -0.5;
  static constexpr double kEnd = std::numbers::pi + 0.9;
  static constexpr double kWidth = 0.09;  // half width of the corridor

 public:
  EightPlant() : Cloned({{"point", 0, 2}, {"heading", 0, 2}}, 1, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    const Point on = Along(x(4) + 0.1);
    const Point ahead = Along(x(4) + 0.2) - on;
    const Point aside = (0.012 * variation.offset / Norm(ahead)) * Point{-ahead.y, ahead.x};
    const Point motion = Shortened((1.0 / kGain) * (on + aside - p), 0.8);
    u[0] = motion.x;
    u[1] = motion.y;
  }

 private:
  static Point Along(double s) noexcept { return {0.5 * std::sin(s), 0.3 * std::sin(2.0 * s)}; }

  void Start(core::Random& random) noexcept override {
    x(4) = kBegin;
    const Point p = Along(kBegin);
    x(0) = p.x + random.Uniform(-0.03, 0.03);
    x(1) = p.y + random.Uniform(-0.03, 0.03);
    const Point ahead = Along(kBegin + 0.1) - p;
    x(2) = ahead.x / Norm(ahead);
    x(3) = ahead.y / Norm(ahead);
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      x(0) += kGain / kLooks * u[0];
      x(1) += kGain / kLooks * u[1];
      Follow();
    }
    const double norm = std::hypot(u[0], u[1]);
    const double keeps = 1.0 - 0.5 * std::min(1.0, norm);  // a zero control keeps the heading
    x(2) = keeps * x(2) + (norm > 0.0 ? (1.0 - keeps) * u[0] / norm : 0.0);
    x(3) = keeps * x(3) + (norm > 0.0 ? (1.0 - keeps) * u[1] / norm : 0.0);
    FailIf(Norm(Point{x(0), x(1)} - Along(x(4))) > kWidth);
  }
  // Advances the position along the figure eight to the place nearest to the point. The short
  // search cannot jump to the other branch at the crossing.
  void Follow() noexcept {
    const Point p{x(0), x(1)};
    double nearest = Norm(p - Along(x(4)));
    const double from = x(4);
    constexpr int kTries = 10;
    for (int i = 1; i <= kTries; ++i) {
      const double s = from + 0.01 * i;
      const double distance = Norm(p - Along(s));
      if (distance >= nearest) continue;
      nearest = distance;
      x(4) = s;
    }
  }
  [[nodiscard]] bool Done() const noexcept override { return x(4) >= kEnd; }
};

// A point crosses a lane on which a shuttle moves back and forth with a random phase. State:
// point(2), shuttle(2) as position along the lane and speed. Hidden: the phase.
class CrossingPlant final : public Cloned<CrossingPlant> {
  static constexpr double kLane = 0.5;       // x
  static constexpr double kAmplitude = 0.5;  // amplitude of the shuttle's y
  static constexpr double kRate = 0.12;      // rad per step
  static constexpr double kRadius = 0.14;    // distance below which point and shuttle collide
  static constexpr double kKerb = 0.28;      // x at which the point waits
  static constexpr double kSpeed = 0.8;
  static constexpr Disc kGoal{{0.9, 0.0}, 0.05};

 public:
  CrossingPlant() : Cloned({{"point", 0, 2}, {"shuttle", 0, 2}}, 1, 2) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    const Point p{x(0), x(1)};
    const Point aim{x(0) < 0.8 ? x(0) + 0.1 : kGoal.centre.x,
                    x(0) < 0.8 ? 0.015 * variation.offset : kGoal.centre.y};
    Point motion = Shortened((1.0 / kGain) * (aim - p), kSpeed);
    if (x(0) < kKerb + 0.03 && !Free()) motion.x = std::min(motion.x, (kKerb - x(0)) / kGain);
    u[0] = motion.x;
    u[1] = motion.y;
  }

 private:
  // Returns true if the point, moving on from here, passes the shuttle with a margin.
  [[nodiscard]] bool Free() const noexcept {
    double phase = x(4);
    double along = x(0);
    while (along < kLane + 0.25) {
      const Point shuttle{kLane, kAmplitude * std::sin(phase)};
      if (Norm(Point{along, x(1)} - shuttle) < kRadius + 0.08) return false;
      phase += kRate;
      along += kGain * kSpeed;
    }
    return true;
  }
  void Place() noexcept {
    x(2) = kAmplitude * std::sin(x(4));
    x(3) = kAmplitude * kRate * std::cos(x(4));
  }
  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-0.05, 0.05);
    x(1) = random.Uniform(-0.05, 0.05);
    x(4) = random.Uniform(0.0, 2.0 * std::numbers::pi);
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      x(0) += kGain / kLooks * u[0];
      x(1) += kGain / kLooks * u[1];
      x(4) += kRate / kLooks;
      Place();
      const Point p{x(0), x(1)};
      FailIf(Norm(p - Point{kLane, x(2)}) < kRadius);
      FailIf(!Box{{-0.3, -0.4}, {1.2, 0.4}}.Contains(p));
    }
  }
  [[nodiscard]] bool Done() const noexcept override { return kGoal.Contains({x(0), x(1)}); }
};

}  // namespace

GalleryTask RopeTask() {
  return {.name = "rope",
          .summary =
              "A rope is wound round a peg by a turn and a half, counter-clockwise, and put on a "
              "hook; touching the peg, turning the wrong way or pulling the rope taut fails",
          .held_out = true,
          .plant = std::make_shared<RopePlant>(),
          .horizon = 200,
          .weak_epochs = 7,
          .policy_bias = {.turn = 0.4}};
}

GalleryTask EightTask() {
  return {.name = "figure-eight",
          .summary =
              "A figure eight in a corridor that crosses itself: the guard meets the same place at "
              "two times; leaving the corridor or turning off at the middle fails",
          .plant = std::make_shared<EightPlant>(),
          .features = "point",
          .horizon = 150,
          .weak_hidden = {16},
          .weak_epochs = 8,
          .policy_bias = {.turn = 0.5}};
}

GalleryTask CrossingTask() {
  return {.name = "crossing",
          .summary =
              "A point crosses a lane before or behind a shuttle of random phase, or waits for "
              "it; touching the shuttle fails",
          .held_out = true,
          .plant = std::make_shared<CrossingPlant>(),
          .horizon = 150,
          .settle_steps = 60,
          .weak_hidden = {16},
          .weak_epochs = 10,
          .policy_bias = {.late = 8}};
}

}  // namespace dfr::sim::internal
