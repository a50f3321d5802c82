#pragma once

#include <array>
#include <cstdint>
#include <span>

namespace dfr::sim {

/// Red, green, blue.
using Colour = std::array<std::uint8_t, 3>;

/// Paints discs, segments and boxes with smooth edges on a square picture, rows from the top.
///
/// The covered fraction of a pixel is clamp(0.5 - d, 0, 1), where d is the signed distance of its
/// centre to the shape in pixels. Arguments are lengths and angles in the painted world. Borrows
/// the pixels. Never allocates or throws.
class Canvas {
 public:
  /// @param rgb    side x side x 3 bytes.
  /// @param left, bottom, size  the square of the world that the picture shows.
  Canvas(std::span<std::uint8_t> rgb, int side, double left, double bottom, double size) noexcept;

  void Fill(const Colour& colour) noexcept;
  void Disc(double x, double y, double radius, const Colour& colour) noexcept;
  /// Paints a line with round ends, twice `half_width` wide.
  void Segment(double x0, double y0, double x1, double y1, double half_width,
               const Colour& colour) noexcept;
  /// Paints a box around (x, y), rotated by `angle`, rad.
  void Box(double x, double y, double half_x, double half_y, double angle,
           const Colour& colour) noexcept;

 private:
  template <typename Distance>
  void Paint(const Distance& distance, const Colour& colour) noexcept;

  std::span<std::uint8_t> rgb_;
  int side_;
  double left_, bottom_;
  double pixel_;  // size of a pixel in the world
};

}  // namespace dfr::sim
