#include "dfr/sim/gallery/corridor.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "dfr/core/contract.h"

namespace dfr::sim {
namespace {

constexpr double kPolygonStep = 0.05;
// A control moves the point by at most 0.14 in the default scene, a twentieth of the wavelength.
// This number of checks per motion detects a shortcut across a bend.
constexpr int kLooks = 4;
constexpr double kSpeed = 0.6;  // norm of the supervisor's control

double Centre(const CorridorOptions& options, double x) noexcept {
  return options.amplitude * std::sin(2.0 * std::numbers::pi * x / options.wavelength);
}

}  // namespace

CorridorPlant::CorridorPlant(const CorridorOptions& options)
    : GalleryPlant({{"point", 0, 2}}, 0, 2), options_(options) {
  DFR_THROW_UNLESS(options.length > 0.0 && options.length <= 1000.0,
                   "length must lie in (0, 1000], not " << options.length);
  DFR_THROW_UNLESS(options.amplitude >= 0.0,
                   "amplitude must not be negative: " << options.amplitude);
  DFR_THROW_UNLESS(options.wavelength > 0.0,
                   "wavelength must be positive, not " << options.wavelength);
  DFR_THROW_UNLESS(options.half_width > 0.0,
                   "half_width must be positive, not " << options.half_width);
  DFR_THROW_UNLESS(options.start_spread >= 0.0,
                   "start_spread must not be negative: " << options.start_spread);
  DFR_THROW_UNLESS(options.gain > 0.0, "gain must be positive, not " << options.gain);
  DFR_THROW_UNLESS(std::isfinite(options.rotation), "rotation must be finite");
  // The line extends beyond both ends: a step past the goal is not a collision.
  const int points = static_cast<int>(std::ceil((options.length + 2.0) / kPolygonStep));
  for (int i = 0; i < points; ++i) {
    const double x = -1.0 + kPolygonStep * i;
    centre_.push_back({x, Centre(options, x)});
  }
}

double CorridorPlant::Clearance(double x, double y) const noexcept {
  // Only the part of the line within a half width of x can be nearer than the wall.
  const double reach = options_.half_width + 2.0 * kPolygonStep;
  const auto index = [&](double at) {
    return static_cast<std::size_t>(
        std::clamp((at + 1.0) / kPolygonStep, 0.0, static_cast<double>(centre_.size() - 2)));
  };
  double nearest = reach * reach;
  for (std::size_t i = index(x - reach); i <= index(x + reach); ++i) {
    const double dx = centre_[i + 1][0] - centre_[i][0];
    const double dy = centre_[i + 1][1] - centre_[i][1];
    const double px = x - centre_[i][0];
    const double py = y - centre_[i][1];
    const double s = std::clamp((px * dx + py * dy) / (dx * dx + dy * dy), 0.0, 1.0);
    nearest = std::min(nearest, (px - s * dx) * (px - s * dx) + (py - s * dy) * (py - s * dy));
  }
  return options_.half_width - std::sqrt(nearest);
}

std::vector<std::array<double, 2>> CorridorPlant::Wall(double side, double left,
                                                       double right) const {
  std::vector<std::array<double, 2>> wall;
  for (std::size_t i = 0; i + 1 < centre_.size(); ++i) {
    const double dx = centre_[i + 1][0] - centre_[i][0];
    const double dy = centre_[i + 1][1] - centre_[i][1];
    const double offset = side * options_.half_width / std::hypot(dx, dy);
    const double x = 0.5 * (centre_[i][0] + centre_[i + 1][0]) - offset * dy;
    const double y = 0.5 * (centre_[i][1] + centre_[i + 1][1]) + offset * dx;
    // Inside a bend tighter than the half width, the offset line doubles back.
    if (x < left || x > right || Clearance(x, y) > 1e-3) continue;
    wall.push_back({x, y});
  }
  return wall;
}

void CorridorPlant::Start(core::Random& random) noexcept {
  do {
    x(1) = options_.start_spread * random.Normal();
  } while (Clearance(x(0), x(1)) < 0.3 * options_.half_width);
}

void CorridorPlant::Step(std::span<const double> u) noexcept {
  const double a = options_.gain * u[0];
  const double b = options_.gain * u[1];
  const double cosine = std::cos(options_.rotation);
  const double sine = std::sin(options_.rotation);
  const double dx = cosine * a - sine * b;
  const double dy = sine * a + cosine * b;
  const double from_x = x(0);
  const double from_y = x(1);
  for (int look = 1; look <= kLooks; ++look) {
    const double share = static_cast<double>(look) / kLooks;
    x(0) = from_x + share * dx;
    x(1) = from_y + share * dy;
    FailIf(Clearance(x(0), x(1)) < 0.0);
  }
}

bool CorridorPlant::Done() const noexcept { return x(0) >= options_.length; }

std::unique_ptr<core::SimulatedPlant> CorridorPlant::Clone() const {
  return std::make_unique<CorridorPlant>(*this);
}

void CorridorPlant::Supervise(const SupervisorVariation& /*variation*/,
                              std::span<double> u) const noexcept {
  // Aims two steps ahead: near enough to follow the bends, far enough not to zigzag.
  const double ahead = x(0) + 2.0 * kSpeed * options_.gain;
  const double dx = ahead - x(0);
  const double dy = Centre(options_, ahead) - x(1);
  const double scale = kSpeed / std::hypot(dx, dy);
  const double cosine = std::cos(options_.rotation);
  const double sine = std::sin(options_.rotation);
  u[0] = scale * (cosine * dx + sine * dy);
  u[1] = scale * (-sine * dx + cosine * dy);
}

}  // namespace dfr::sim
