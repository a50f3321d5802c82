#include <array>
#include <cmath>

#include "geometry.h"
#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr int kJoints = 7;
constexpr double kLink = 1.0 / kJoints;
constexpr double kStep = 0.1;  // rad, joint rotation by a control of 1
const Disc kPillar{{0.8, 0.0}, 0.12};
const Disc kGoal{{0.72, 0.36}, 0.05};
// Bent away from the pillar.
constexpr std::array<double, kJoints> kStart = {-1.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.2};

// A planar arm of seven joints. State: joints(7) in rad, tip(2).
class Arm7Plant final : public Cloned<Arm7Plant> {
 public:
  Arm7Plant() : Cloned({{"joints", 0, kJoints}, {"tip", 0, 2}}, 0, kJoints) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    const double inner = 0.52 + 0.015 * habit.offset;
    const std::array<Point, 4> path{{{0.72, -0.36}, {inner, -0.12}, {inner, 0.12}, kGoal.centre}};
    const Point tip{x(kJoints), x(kJoints + 1)};
    const Point wanted = Shortened(Ahead(path, tip, 0.06) - tip, 0.05);
    // J' (J J' + damping)^-1 of the tip's motion.
    std::array<Point, kJoints> columns;
    double a = 1e-3, b = 0.0, d = 1e-3;
    const auto points = Points();
    for (std::size_t i = 0; i < kJoints; ++i) {
      const Point r = tip - points[i];
      columns[i] = {-r.y, r.x};
      a += columns[i].x * columns[i].x;
      b += columns[i].x * columns[i].y;
      d += columns[i].y * columns[i].y;
    }
    const double det = a * d - b * b;
    const Point f{(d * wanted.x - b * wanted.y) / det, (a * wanted.y - b * wanted.x) / det};
    for (std::size_t i = 0; i < kJoints; ++i) u[i] = Dot(columns[i], f) / kStep;
  }

 private:
  // The joints, then the tip.
  [[nodiscard]] std::array<Point, kJoints + 1> Points() const noexcept {
    std::array<Point, kJoints + 1> points{};
    double angle = 0.0;
    for (std::size_t i = 0; i < kJoints; ++i) {
      angle += x(static_cast<int>(i));
      points[i + 1] = points[i] + Turned({kLink, 0.0}, angle);
    }
    return points;
  }
  void Place() noexcept {
    const Point tip = Points().back();
    x(kJoints) = tip.x;
    x(kJoints + 1) = tip.y;
  }
  void Start(core::Random& random) noexcept override {
    for (int i = 0; i < kJoints; ++i) {
      x(i) = kStart[static_cast<std::size_t>(i)] + random.Uniform(-0.04, 0.04);
    }
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 2;
    for (int look = 0; look < kLooks; ++look) {
      for (int i = 0; i < kJoints; ++i) {
        x(i) += kStep / kLooks * u[static_cast<std::size_t>(i)];
        FailIf(std::abs(x(i)) > 2.5);
      }
      const auto points = Points();
      for (std::size_t i = 0; i < kJoints; ++i) {
        FailIf(kPillar.Contains(Nearest(points[i], points[i + 1], kPillar.centre)));
      }
    }
    Place();
  }
  [[nodiscard]] bool Done() const noexcept override {
    return kGoal.Contains({x(kJoints), x(kJoints + 1)});
  }
};

}  // namespace

GalleryTask Arm7Task() {
  return {.name = "arm7",
          .summary =
              "An arm of seven joints takes its tip round a pillar, on the near side; any "
              "part touching it fails",
          .judgement = true,
          .plant = std::make_shared<Arm7Plant>(),
          .features = "joints",
          .noise = 0.1,
          .hidden = {32},
          .epochs = 60,
          .weak_epochs = 25,
          .flaw = {.bias = {-0.25}}};
}

}  // namespace dfr::sim::internal
