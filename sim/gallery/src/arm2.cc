#include <array>

#include "geometry.h"
#include "tasks.h"

namespace dfr::sim::internal {
namespace {

constexpr double kLink = 0.5;
constexpr double kStep = 0.25;  // rad, joint rotation by a control of 1
const Disc kPillar{{0.327, 0.642}, 0.16};
const Point kGoal{-0.417, 0.712};

Point Elbow(double shoulder) noexcept { return Turned({kLink, 0.0}, shoulder); }
Point Tip(double shoulder, double elbow) noexcept {
  return Elbow(shoulder) + Turned({kLink, 0.0}, shoulder + elbow);
}

// A planar arm of two links. State: joints(2), tip(2).
class Arm2Plant final : public Cloned<Arm2Plant> {
 public:
  Arm2Plant() : Cloned({{"joints", 0, 2}, {"tip", 0, 2}}, 0, 2) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    // Folds the elbow before the pillar and unfolds it behind the pillar.
    const double fold = 2.15 + 0.03 * habit.offset;
    const std::array<Point, 4> path{{{-0.3, 0.9}, {-0.2, fold}, {1.0, fold}, {1.5, 1.2}}};
    const Point q{x(0), x(1)};
    const Point wanted = Shortened((1.0 / kStep) * (Ahead(path, q, kStep) - q), 1.0);
    u[0] = wanted.x;
    u[1] = wanted.y;
  }

 private:
  void Place() noexcept {
    const Point tip = Tip(x(0), x(1));
    x(2) = tip.x;
    x(3) = tip.y;
  }
  void Start(core::Random& random) noexcept override {
    x(0) = -0.3 + random.Uniform(-0.06, 0.06);
    x(1) = 0.9 + random.Uniform(-0.06, 0.06);
    Place();
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;
    for (int look = 0; look < kLooks; ++look) {
      x(0) += kStep / kLooks * u[0];
      x(1) += kStep / kLooks * u[1];
      Place();
      const Point elbow = Elbow(x(0));
      const Point c = kPillar.centre;
      FailIf(kPillar.Contains(Nearest({}, elbow, c)) ||
             kPillar.Contains(Nearest(elbow, {x(2), x(3)}, c)));
      FailIf(std::abs(x(0)) > 2.0 || std::abs(x(1)) > 2.9);
    }
  }
  [[nodiscard]] bool Done() const noexcept override {
    return Norm(Point{x(2), x(3)} - kGoal) < 0.08;
  }
};

}  // namespace

GalleryTask Arm2Task() {
  return {.name = "arm2",
          .summary =
              "An arm of two joints folds past a pillar; an action is longer than the "
              "demonstrations are apart; any part touching the pillar fails",
          .plant = std::make_shared<Arm2Plant>(),
          .features = "joints",
          .horizon = 60,
          .noise = 0.15,
          .weak_hidden = {4},
          .weak_epochs = 20,
          .flaw = {.late = 4}};
}

}  // namespace dfr::sim::internal
