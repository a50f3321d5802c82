#include "apps/planar_page/scene.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"

namespace dfr::apps::planar_page {
namespace {

constexpr int kLooks = 4;  // Number of collision checks along each motion; detects cut corners.

Point Turned(const Point& p, double angle) {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  return {c * p[0] - s * p[1], s * p[0] + c * p[1]};
}

// Returns the distance to a box; inside it, minus the depth.
double Distance(const Box& box, const Point& p) {
  const double dx = std::max(box.low[0] - p[0], p[0] - box.high[0]);
  const double dy = std::max(box.low[1] - p[1], p[1] - box.high[1]);
  if (dx <= 0.0 && dy <= 0.0) return std::max(dx, dy);
  return std::hypot(std::max(dx, 0.0), std::max(dy, 0.0));
}

std::vector<Point> CorridorCentre() {
  const sim::CorridorOptions options;
  constexpr int kPoints = 80;
  std::vector<Point> centre;
  centre.reserve(kPoints + 1);
  for (int i = 0; i <= kPoints; ++i) {
    const double x = options.length * i / kPoints;
    centre.push_back({x, options.amplitude * std::sin(2.0 * M_PI * x / options.wavelength)});
  }
  return centre;
}

std::vector<Point> Round(double y) {
  return {{0.0, 0.0}, {0.6, 0.25 * y}, {1.2, 0.8 * y},  {1.7, y},
          {2.3, y},   {2.8, 0.8 * y},  {3.4, 0.25 * y}, {4.0, 0.0}};
}

std::vector<Scene> MakeScenes() {
  const std::vector<Point> corridor = CorridorCentre();
  return {
      {.name = "Two ways",
       .summary = "Half of the demonstrations pass above the pillar and half below. The policy "
                  "averages them, and hits it.",
       .start = {{0.0, 0.0}, 0.16},
       .goal = {{4.0, 0.0}, 0.16},
       .discs = {{{2.0, 0.0}, 0.45}},
       .routes = {Round(0.75), Round(-0.75)},
       .degree = 2},
      {.name = "Narrow gap",
       .summary = "The gap is only three steps wide. The policy bends too early, and "
                  "clips the wall.",
       .start = {{0.0, 0.0}, 0.16},
       .goal = {{4.0, 0.0}, 0.16},
       .boxes = {{{1.7, -1.2}, {2.2, 0.5}}, {{1.7, 0.8}, {2.2, 1.2}}},
       .routes = {{{0.0, 0.0}, {1.1, 0.0}, {1.55, 0.65}, {2.35, 0.65}, {2.8, 0.0}, {4.0, 0.0}}},
       .wander = 0.02,
       .degree = 2},
      {.name = "Corridor",
       .summary = "A corridor winds to the goal. The policy cuts its corners.",
       .start = {corridor.front(), 0.08},
       .goal = {corridor.back(), 0.16},
       .corridor = true,
       .routes = {corridor},
       .wander = 0.02,
       .degree = 2},
      {.name = "Your own",
       .summary = "No demonstration yet. Draw a line from the start to the goal, on any path you "
                  "like.",
       .start = {{0.0, 0.0}, 0.16},
       .goal = {{4.0, 0.0}, 0.16}},
  };
}

}  // namespace

double Norm(const Point& p) { return std::hypot(p[0], p[1]); }

Point Saturated(const Point& u) {
  return {std::clamp(u[0], -1.0, 1.0), std::clamp(u[1], -1.0, 1.0)};
}

const std::vector<Scene>& Scenes() {
  static const std::vector<Scene> scenes = MakeScenes();
  return scenes;
}

PointPlant::PointPlant(const Scene& scene)
    : scene_(scene), layout_{{{"point", 0, 2}}}, point_(scene.start.centre) {
  if (scene.corridor) corridor_.emplace();
}

void PointPlant::Reset(std::uint64_t seed) {
  core::Random random(seed);
  do {
    point_ = {random.Uniform(-1.0, 1.0), random.Uniform(-1.0, 1.0)};
  } while (Norm(point_) > 1.0);
  point_ = scene_.start.centre + scene_.start.radius * point_;
  collided_ = false;
}

void PointPlant::MoveTo(const Point& point) noexcept {
  point_ = point;
  collided_ = Clearance(point_) < 0.0;
}

core::PlantStatus PointPlant::Apply(std::span<const double> control) noexcept {
  if (control.size() != 2 || !std::isfinite(control[0]) || !std::isfinite(control[1])) {
    return core::PlantStatus::kRefused;
  }
  const Point motion = Displacement({control[0], control[1]});
  const Point from = point_;
  for (int look = 1; look <= kLooks; ++look) {
    point_ = from + (static_cast<double>(look) / kLooks) * motion;
    collided_ = collided_ || Clearance(point_) < 0.0;
  }
  return core::PlantStatus::kOk;
}

void PointPlant::Observe(std::span<double> state) const noexcept {
  std::copy(point_.begin(), point_.end(), state.begin());
}

bool PointPlant::completed() const noexcept {
  return !collided_ && Norm(point_ - scene_.goal.centre) <= scene_.goal.radius;
}

std::unique_ptr<core::SimulatedPlant> PointPlant::Clone() const {
  return std::make_unique<PointPlant>(*this);
}

void PointPlant::CopyStateFrom(const core::SimulatedPlant& other) noexcept {
  const auto& from = static_cast<const PointPlant&>(other);
  point_ = from.point_;
  collided_ = from.collided_;
}

double PointPlant::Clearance(const Point& p) const noexcept {
  double least = std::numeric_limits<double>::infinity();
  for (const Disc& disc : scene_.discs)
    least = std::min(least, Norm(p - disc.centre) - disc.radius);
  for (const Box& box : scene_.boxes) least = std::min(least, Distance(box, p));
  if (corridor_) least = std::min(least, corridor_->Clearance(p[0], p[1]));
  return least;
}

std::vector<Point> PointPlant::Wall(double side, double left, double right) const {
  return corridor_ ? corridor_->Wall(side, left, right) : std::vector<Point>{};
}

Point Displacement(const Point& control) noexcept {
  return PointPlant::kGain * Turned(Saturated(control), PointPlant::kRotation);
}

Point ControlFor(const Point& displacement) noexcept {
  return Saturated((1.0 / PointPlant::kGain) * Turned(displacement, -PointPlant::kRotation));
}

}  // namespace dfr::apps::planar_page
