#include "dfr/sim/gallery/canvas.h"

#include <algorithm>
#include <cmath>

namespace dfr::sim {

Canvas::Canvas(std::span<std::uint8_t> rgb, int side, double left, double bottom,
               double size) noexcept
    : rgb_(rgb), side_(side), left_(left), bottom_(bottom), pixel_(size / side) {}

void Canvas::Fill(const Colour& colour) noexcept {
  for (std::size_t i = 0; i < rgb_.size(); ++i) rgb_[i] = colour[i % colour.size()];
}

template <typename Distance>
void Canvas::Paint(const Distance& distance, const Colour& colour) noexcept {
  auto pixel = rgb_.begin();
  for (int row = 0; row < side_; ++row) {
    const double y = bottom_ + pixel_ * (side_ - row - 0.5);
    for (int column = 0; column < side_; ++column) {
      const double x = left_ + pixel_ * (column + 0.5);
      const double covered = std::clamp(0.5 - distance(x, y) / pixel_, 0.0, 1.0);
      for (const std::uint8_t channel : colour) {
        *pixel = static_cast<std::uint8_t>(std::lround(*pixel + covered * (channel - *pixel)));
        ++pixel;
      }
    }
  }
}

void Canvas::Disc(double x, double y, double radius, const Colour& colour) noexcept {
  Paint([=](double px, double py) { return std::hypot(px - x, py - y) - radius; }, colour);
}

void Canvas::Segment(double x0, double y0, double x1, double y1, double half_width,
                     const Colour& colour) noexcept {
  const double dx = x1 - x0;
  const double dy = y1 - y0;
  const double length = dx * dx + dy * dy;
  Paint(
      [=](double px, double py) {
        const double along =
            length > 0.0 ? std::clamp(((px - x0) * dx + (py - y0) * dy) / length, 0.0, 1.0) : 0.0;
        return std::hypot(px - x0 - along * dx, py - y0 - along * dy) - half_width;
      },
      colour);
}

void Canvas::Box(double x, double y, double half_x, double half_y, double angle,
                 const Colour& colour) noexcept {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  Paint(
      [=](double px, double py) {
        const double beyond_x = std::abs(c * (px - x) + s * (py - y)) - half_x;
        const double beyond_y = std::abs(-s * (px - x) + c * (py - y)) - half_y;
        return std::hypot(std::max(beyond_x, 0.0), std::max(beyond_y, 0.0)) +
               std::min(std::max(beyond_x, beyond_y), 0.0);
      },
      colour);
}

}  // namespace dfr::sim
