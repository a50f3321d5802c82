#include <utility>
#include <vector>

#include "geometry.h"
#include "tasks.h"

namespace dfr::sim::internal {
namespace {

/// A way to the goal, taken with this probability. Its points between start and goal are shifted
/// along `side` by the habit's offset.
struct Route {
  double probability;
  std::vector<Point> points;
  Point side = {0.0, 1.0};
};

struct PointOptions {
  double gain = 0.04;  ///< A control of norm 1 moves the point by this far.
  double speed = 0.8;  ///< Norm of the supervisor's control.
  Point start_spread = {0.05, 0.05};
  Disc goal = {{1.0, 0.0}, 0.05};
  std::vector<Disc> discs = {};
  std::vector<Box> boxes = {};
  std::vector<Route> routes = {};
  double offset_spread = 0.02;
};

// A point that starts near the origin and goes where it is told. State: point(2).
class PointPlant final : public Cloned<PointPlant> {
 public:
  explicit PointPlant(PointOptions options)
      : Cloned({{"point", 0, 2}}, 0, 2), options_(std::move(options)) {}

  void Supervise(const Habit& habit, std::span<double> u) const noexcept override {
    std::size_t way = 0;
    double rest = habit.way;
    while (way + 1 < options_.routes.size() && rest >= options_.routes[way].probability) {
      rest -= options_.routes[way++].probability;
    }
    const Route& route = options_.routes[way];
    const Point p{x(0), x(1)};
    const Point shift = options_.offset_spread * habit.offset * route.side;
    const double ahead = 2.0 * options_.gain;
    Point aim = Ahead(route.points, p - shift, ahead) + shift;
    if (Norm(options_.goal.centre - p) < 3.0 * options_.gain) aim = options_.goal.centre;
    const Point direction = Shortened((1.0 / options_.gain) * (aim - p), options_.speed);
    u[0] = direction.x;
    u[1] = direction.y;
  }

 private:
  void Start(core::Random& random) noexcept override {
    x(0) = options_.start_spread.x * random.Uniform(-1.0, 1.0);
    x(1) = options_.start_spread.y * random.Uniform(-1.0, 1.0);
  }
  void Step(std::span<const double> u) noexcept override {
    constexpr int kLooks = 4;  // so that no corner is cut unseen
    for (int look = 0; look < kLooks; ++look) {
      x(0) += options_.gain / kLooks * u[0];
      x(1) += options_.gain / kLooks * u[1];
      const Point p{x(0), x(1)};
      for (const Disc& disc : options_.discs) FailIf(disc.Contains(p));
      for (const Box& box : options_.boxes) FailIf(box.Contains(p));
      FailIf(!Box{{-0.4, -0.8}, {1.4, 0.8}}.Contains(p));
    }
  }
  [[nodiscard]] bool Done() const noexcept override { return options_.goal.Contains({x(0), x(1)}); }

  PointOptions options_;
};

std::shared_ptr<const GalleryPlant> MakePoint(PointOptions options) {
  return std::make_shared<PointPlant>(std::move(options));
}

}  // namespace

std::vector<GalleryTask> PointTasks() {
  const Disc pillar{{0.55, 0.0}, 0.2};
  const auto over = [](double probability, double y) {
    return Route{probability,
                 {{0.0, 0.0}, {0.35, 0.85 * y}, {0.55, y}, {0.75, 0.85 * y}, {1.0, 0.0}}};
  };
  std::vector<GalleryTask> tasks;
  tasks.push_back({.name = "reach",
                   .summary = "A point goes round a pillar, always over it; touching it fails",
                   .plant = MakePoint({.discs = {pillar}, .routes = {over(1.0, 0.28)}}),
                   .weak_epochs = 7,
                   .flaw = {.bias = {0.0, -0.2}}});
  tasks.push_back(
      {.name = "two-ways",
       .summary = "The same, over the pillar or under it, at random",
       .plant = MakePoint({.discs = {pillar}, .routes = {over(0.5, 0.3), over(0.5, -0.3)}}),
       .weak_epochs = 20,
       .flaw = {.bias = {0.0, 0.2}}});
  tasks.push_back(
      {.name = "passage",
       .summary = "A narrow bent passage between walls; touching them fails",
       .judgement = true,
       .plant = MakePoint({.boxes = {{{0.3, -0.8}, {0.7, 0.12}}, {{0.3, 0.22}, {0.7, 0.8}}},
                           .routes = {{1.0, {{0.0, 0.0}, {0.25, 0.17}, {0.75, 0.17}, {1.0, 0.0}}}},
                           .offset_spread = 0.01}),
       .noise = 0.12,
       .weak_epochs = 7,
       .flaw = {.late = 3}});
  return tasks;
}

}  // namespace dfr::sim::internal
