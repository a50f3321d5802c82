#include <algorithm>
#include <utility>
#include <vector>

#include "geometry.h"
#include "tasks/tasks.h"

namespace dfr::sim::internal {
namespace {

/// A supervisor's route to the goal, and the probability of the route. SupervisorVariation::offset
/// shifts the points sideways. Close to the end, the supervisor aims at the goal itself.
struct Route {
  double probability;
  std::vector<Point> points;
};

struct PointOptions {
  double gain = 0.04;  ///< Displacement of the point by a control of norm 1.
  double speed = 0.8;  ///< Norm of the supervisor's control.
  double carry = 0.0;  ///< Fraction of a motion that carries over to the next one.
  double goal_x = 1.0;
  double belt = 0.0;  ///< Upward motion of the goal per control, until kBelt.
  std::vector<Disc> discs = {};
  std::vector<Box> boxes = {};
  std::vector<Route> routes = {};
  double offset_spread = 0.02;
};

constexpr double kSpread = 0.05;  // half the side of the square of start states
constexpr double kGoalRadius = 0.05;
constexpr double kPointRadius = 0.05;  // in pictures
constexpr double kBelt = 0.35;  // a moving goal starts between -kBelt and -0.05, ends at kBelt

// A point that starts near the origin and moves as commanded to (goal_x, 0) or to a goal on a belt.
// State: point(2), and goal(2) if the goal moves; hidden: the goal if at rest, and the last motion.
class PointPlant final : public Cloned<PointPlant> {
 public:
  explicit PointPlant(PointOptions options)
      : Cloned(options.belt > 0.0
                   ? std::vector<core::StateLayout::Block>{{"point", 0, 2}, {"goal", 0, 2}}
                   : std::vector<core::StateLayout::Block>{{"point", 0, 2}},
               options.belt > 0.0 ? 2 : 4, 2),
        options_(std::move(options)) {}

  void Supervise(const SupervisorVariation& variation,
                 std::span<double> u) const noexcept override {
    std::size_t way = 0;
    double rest = variation.way;
    while (way + 1 < options_.routes.size() && rest >= options_.routes[way].probability) {
      rest -= options_.routes[way++].probability;
    }
    const Point p{x(0), x(1)};
    const Point shift{0.0, options_.offset_spread * variation.offset};
    const std::vector<Point>& route = options_.routes[way].points;
    Point aim = Ahead(route, p - shift, 0.08) + shift;
    if (Norm(aim - route.back() - shift) < 0.01 || Norm(goal() - p) < 0.12) aim = goal();
    const Point direction = Shortened((1.0 / options_.gain) * (aim - p), options_.speed);
    u[0] = direction.x;
    u[1] = direction.y;
  }

  bool Draw(std::span<const double> state, std::span<std::uint8_t> rgb) const noexcept override {
    const double size = std::max(1.6, options_.goal_x + 0.6);
    Canvas canvas(rgb, kPictureSide, 0.5 * (options_.goal_x - size), -0.5 * size, size);
    canvas.Fill(kGround);
    for (const Disc& disc : options_.discs) {
      canvas.Disc(disc.centre.x, disc.centre.y, disc.radius, kSolid);
    }
    for (const Box& box : options_.boxes) {
      const Point centre = 0.5 * (box.low + box.high);
      canvas.Box(centre.x, centre.y, box.high.x - centre.x, box.high.y - centre.y, 0.0, kSolid);
    }
    const bool moving = options_.belt > 0.0;
    canvas.Disc(moving ? state[2] : options_.goal_x, moving ? state[3] : 0.0, kGoalRadius, kTarget);
    canvas.Disc(state[0], state[1], kPointRadius, kRobot);
    return true;
  }

 private:
  [[nodiscard]] Point goal() const noexcept { return {x(2), x(3)}; }

  void Start(core::Random& random) noexcept override {
    x(0) = random.Uniform(-kSpread, kSpread);
    x(1) = random.Uniform(-kSpread, kSpread);
    x(2) = options_.goal_x;
    x(3) = options_.belt > 0.0 ? random.Uniform(-kBelt, -0.05) : 0.0;
  }
  void Step(std::span<const double> u) noexcept override {
    for (int i = 0; i < 2; ++i) {
      const double wanted = options_.gain * u[static_cast<std::size_t>(i)];
      x(4 + i) = options_.carry * x(4 + i) + (1.0 - options_.carry) * wanted;
    }
    constexpr int kLooks = 4;  // detects shortcuts across corners
    for (int look = 0; look < kLooks; ++look) {
      x(0) += x(4) / kLooks;
      x(1) += x(5) / kLooks;
      const Point p{x(0), x(1)};
      for (const Disc& disc : options_.discs) FailIf(disc.Contains(p));
      for (const Box& box : options_.boxes) FailIf(box.Contains(p));
      FailIf(!Box{{-0.4, -0.8}, {options_.goal_x + 0.4, 0.8}}.Contains(p));
    }
    x(3) = std::min(x(3) + options_.belt, kBelt);
  }
  [[nodiscard]] bool Done() const noexcept override {
    return Norm(goal() - Point{x(0), x(1)}) < kGoalRadius;
  }

  PointOptions options_;
};

std::shared_ptr<const GalleryPlant> MakePoint(PointOptions options) {
  return std::make_shared<PointPlant>(std::move(options));
}

// Returns a route past a pillar at (0.55, 0), at height `y` there.
Route Over(double probability, double y) {
  return {probability, {{0.0, 0.0}, {0.35, 0.85 * y}, {0.55, y}, {0.75, 0.85 * y}, {1.0, 0.0}}};
}

// Returns a route past pillars at x = 0.85, at height `y` there. Routes diverge early.
Route Past(double probability, double y) {
  return {probability, {{0.0, 0.0}, {0.15, 0.3 * y}, {0.6, y}, {1.05, y}, {1.3, 0.0}}};
}

}  // namespace

std::vector<GalleryTask> PointTasks() {
  const Disc pillar{{0.55, 0.0}, 0.2};
  const std::vector<Box> gap = {{{0.3, -0.8}, {0.7, 0.12}}, {{0.3, 0.22}, {0.7, 0.8}}};
  const Route through{1.0, {{0.0, 0.0}, {0.25, 0.17}, {0.75, 0.17}, {1.0, 0.0}}};
  return {
      {.name = "reach",
       .summary = "A point goes round a pillar, always over it; touching it fails",
       .plant = MakePoint({.discs = {pillar}, .routes = {Over(1.0, 0.28)}}),
       .weak_epochs = 7,
       .policy_bias = {.bias = {0.0, -0.2}}},
      {.name = "two-ways",
       .summary = "Round the pillar of the task reach, over it or under it, at random",
       .plant = MakePoint({.discs = {pillar}, .routes = {Over(0.5, 0.3), Over(0.5, -0.3)}}),
       .weak_hidden = {16},
       .weak_epochs = 20,
       .policy_bias = {.bias = {0.0, 0.2}}},
      {.name = "unequal-ways",
       .summary =
           "Round the pillar of the task reach, over it in four of five demonstrations, else under",
       .held_out = true,
       .plant = MakePoint({.discs = {pillar}, .routes = {Over(0.8, 0.3), Over(0.2, -0.3)}}),
       .epochs = 200,
       .weak_hidden = {16},
       .weak_epochs = 20,
       .policy_bias = {.turn = -0.25}},
      {.name = "three-ways",
       .summary = "Over two pillars, under them or between them, with probabilities .3, .25, .45",
       .held_out = true,
       .plant = MakePoint({.goal_x = 1.3,
                           .discs = {{{0.85, 0.22}, 0.11}, {{0.85, -0.22}, 0.11}},
                           .routes = {Past(0.3, 0.42), Past(0.25, -0.42), Past(0.45, 0.0)},
                           .offset_spread = 0.015}),
       .noise = 0.15,
       .epochs = 200,
       .weak_hidden = {16},
       .weak_epochs = 20,
       .policy_bias = {.bias = {0.0, 0.2}}},
      {.name = "passage",
       .summary = "A narrow bent passage between walls; touching them fails",
       .held_out = true,
       .plant = MakePoint({.boxes = gap, .routes = {through}, .offset_spread = 0.01}),
       .noise = 0.12,
       .weak_epochs = 7,
       .policy_bias = {.late = 3}},
      {.name = "goal",
       .summary = "Over a pillar to a goal on a belt, which moves on until the belt's end",
       .plant = MakePoint({.belt = 0.006,
                           .discs = {{{0.5, 0.0}, 0.15}},
                           .routes = {{1.0, {{0.0, 0.0}, {0.3, 0.2}, {0.5, 0.24}, {0.7, 0.2}}}}}),
       .settle_steps = 60,
       .weak_epochs = 7,
       .policy_bias = {.bias = {0.0, -0.18}}},
      {.name = "paces",
       .summary = "Round a pillar at 30 Hz: hundreds of steps, demonstrated half as fast to twice "
                  "as fast as usual and with pauses",
       .plant =
           MakePoint({.gain = 0.01, .speed = 0.45, .discs = {pillar}, .routes = {Over(1.0, 0.28)}}),
       .horizon = 1000,
       .slowest = 0.5,
       .fastest = 2.0,
       .pause = 0.01,
       .epochs = 60,
       .weak_epochs = 2,
       .policy_bias = {.bias = {0.0, -0.1}}},
      {.name = "slow-passage",
       .summary = "The narrow passage at 30 Hz, at any pace and with pauses",
       .held_out = true,
       .plant = MakePoint(
           {.gain = 0.01, .speed = 0.45, .boxes = gap, .routes = {through}, .offset_spread = 0.01}),
       .horizon = 1000,
       .noise = 0.15,
       .slowest = 0.5,
       .fastest = 2.0,
       .pause = 0.01,
       .epochs = 60,
       .weak_epochs = 2,
       .policy_bias = {.turn = 0.15}},
      {.name = "targets",
       .summary = "Round two walls with targets for a servo, minus the present position: half of a "
                  "motion carries over to the next step",
       .held_out = true,
       .plant = MakePoint(
           {.carry = 0.5,
            .boxes = {{{0.25, -0.8}, {0.35, 0.08}}, {{0.65, -0.08}, {0.75, 0.8}}},
            .routes =
                {{1.0,
                  {{0.0, 0.0}, {0.2, 0.16}, {0.4, 0.16}, {0.6, -0.16}, {0.8, -0.16}, {1.0, 0.0}}}},
            .offset_spread = 0.015}),
       .settle_steps = 10,
       .weak_epochs = 15,
       .policy_bias = {.turn = 0.35}},
  };
}

}  // namespace dfr::sim::internal
