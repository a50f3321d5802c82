#include "dfr/sim/gallery/disc_push.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::sim {
namespace {

constexpr double kSubstep = 0.001;
constexpr double kLargestControl = 0.7;  // largest norm of the supervisor's control

}  // namespace

DiscPushPlant::DiscPushPlant(const DiscPushOptions& options)
    : GalleryPlant({{"pusher", 0, 2}, {"object", 0, 2}}, 0, 2), options_(options) {
  DFR_THROW_UNLESS(options.object_radius > 0.0 && options.pusher_radius > 0.0 &&
                       options.red_radius > 0.0 && options.goal_radius > 0.0,
                   "radii must be positive");
  DFR_THROW_UNLESS(options.start_x - 0.02 > options.object_radius + options.pusher_radius,
                   "start_x must leave room between pusher and object: " << options.start_x);
  DFR_THROW_UNLESS(options.start_y >= 0.0, "start_y must not be negative: " << options.start_y);
  DFR_THROW_UNLESS(options.gate_y > options.red_radius + options.object_radius,
                   "gate_y must let the object pass: " << options.gate_y);
  DFR_THROW_UNLESS(options.goal_x > options.gate_x && options.gate_x > options.start_x,
                   "start, gate and goal must follow one another along x");
  DFR_THROW_UNLESS(options.step > 0.0 && options.step < 0.1, "step must lie in (0, 0.1)");
  DFR_THROW_UNLESS(std::isfinite(options.rotation), "rotation must be finite");
}

void DiscPushPlant::Look() noexcept {
  const auto touches = [&](double px, double py, double radius) {
    const double dx = px - options_.gate_x;
    const double reach = radius + options_.red_radius;
    return std::hypot(dx, py - options_.gate_y) < reach ||
           std::hypot(dx, py + options_.gate_y) < reach;
  };
  FailIf(touches(x(0), x(1), options_.pusher_radius) ||
         touches(x(2), x(3), options_.object_radius));
}

void DiscPushPlant::Start(core::Random& random) noexcept {
  x(2) = options_.start_x + random.Uniform(-0.02, 0.02);
  x(3) = random.Uniform(-options_.start_y, options_.start_y);
  Look();
}

void DiscPushPlant::Step(std::span<const double> u) noexcept {
  const double a = options_.step * u[0];
  const double b = options_.step * u[1];
  const double cosine = std::cos(options_.rotation);
  const double sine = std::sin(options_.rotation);
  const double dx = cosine * a - sine * b;
  const double dy = sine * a + cosine * b;
  const int substeps = std::max(1, static_cast<int>(std::ceil(std::hypot(dx, dy) / kSubstep)));
  const double contact = options_.object_radius + options_.pusher_radius;
  for (int i = 0; i < substeps; ++i) {
    x(0) += dx / substeps;
    x(1) += dy / substeps;
    const double nx = x(2) - x(0);
    const double ny = x(3) - x(1);
    const double distance = std::hypot(nx, ny);
    if (distance < contact && distance > 0.0) {
      x(2) = x(0) + contact * nx / distance;
      x(3) = x(1) + contact * ny / distance;
    }
    Look();
  }
}

bool DiscPushPlant::Done() const noexcept {
  return std::hypot(x(2) - options_.goal_x, x(3)) <= options_.goal_radius;
}

std::unique_ptr<core::SimulatedPlant> DiscPushPlant::Clone() const {
  return std::make_unique<DiscPushPlant>(*this);
}

void DiscPushPlant::Supervise(const SupervisorVariation& /*variation*/,
                              std::span<double> u) const noexcept {
  // Steers the object to a point on the axis 0.1 m ahead, but not beyond the goal. The object
  // reaches the axis before the gate.
  const double aim_x = std::min(options_.goal_x + 0.02, x(2) + 0.1);
  const double length = std::hypot(aim_x - x(2), x(3));
  const double hx = (aim_x - x(2)) / length;
  const double hy = -x(3) / length;
  const double contact = options_.object_radius + options_.pusher_radius;
  // Position of the pusher relative to the object, along the heading and across it.
  const double along = (x(0) - x(2)) * hx + (x(1) - x(3)) * hy;
  const double across = -(x(0) - x(2)) * hy + (x(1) - x(3)) * hx;
  double forward = 1.0;
  double sideways = -6.0 * across / contact;
  if (std::abs(across) > 0.35 * contact) {
    // The pusher is not behind the object: it backs off before turning in, to avoid knocking the
    // object aside.
    forward = along > -1.25 * contact ? -1.0 : 0.0;
    sideways = along > -1.05 * contact ? 0.0 : (across > 0.0 ? -1.0 : 1.0);
  }
  const double scale = kLargestControl / std::max(1.0, std::hypot(forward, sideways));
  const double vx = scale * (forward * hx - sideways * hy);
  const double vy = scale * (forward * hy + sideways * hx);
  const double cosine = std::cos(options_.rotation);
  const double sine = std::sin(options_.rotation);
  u[0] = cosine * vx + sine * vy;
  u[1] = -sine * vx + cosine * vy;
}

}  // namespace dfr::sim
