#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim {

/// Options for CorridorPlant. Lengths share one arbitrary unit.
struct CorridorOptions {
  double length = 4.0;     ///< The goal is at x >= length.
  double amplitude = 0.5;  ///< Centre line y = amplitude sin(2 pi x / wavelength).
  double wavelength = 3.0;
  double half_width = 0.2;     ///< Leaving it collides: the distance to the centre line.
  double start_spread = 0.06;  ///< Start y is normal around 0 with this standard deviation.
  double gain = 0.1;           ///< K: a control of norm 1 moves the point by this far.
  double rotation = 0.6;  ///< rad: by how much the control is turned. Controllers are not told.
};

/// A point in a curved corridor: x' = x + K R u, the smallest system that satisfies
/// |x' - x| <= K |u| (Sec. IV-C) with a control whose direction has to be found out.
///
/// State: point(2). Start: x = 0, y normal, drawn anew until it is 0.7 half widths from the centre
/// line at most. The supervisor follows the centre line at a fixed speed: it aims at the point of
/// the line a little ahead.
class CorridorPlant final : public GalleryPlant {
 public:
  /// @throws std::invalid_argument naming the option out of range.
  explicit CorridorPlant(const CorridorOptions& options = {});

  [[nodiscard]] const CorridorOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void Supervise(const Habit& habit, std::span<double> u) const noexcept override;

  /// Distance of (x, y) to the centre line, negated beyond the half width: > 0 inside.
  [[nodiscard]] double Clearance(double x, double y) const noexcept;
  /// Points along the wall on one side (1: above the centre line, -1: below), for drawing: those
  /// whose x lies in [left, right], a twentieth of a unit apart along the centre line.
  [[nodiscard]] std::vector<std::array<double, 2>> Wall(double side, double left,
                                                        double right) const;

 private:
  void Start(core::Random& random) noexcept override;
  void Step(std::span<const double> u) noexcept override;
  [[nodiscard]] bool Done() const noexcept override;

  CorridorOptions options_;
  std::vector<std::array<double, 2>> centre_;  ///< The centre line as a polygon.
};

}  // namespace dfr::sim
