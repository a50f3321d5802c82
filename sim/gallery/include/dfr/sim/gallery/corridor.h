#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim {

/// Options for CorridorPlant. Lengths share one arbitrary unit.
struct CorridorOptions {
  double length = 4.0;     ///< Goal: x >= length.
  double amplitude = 0.5;  ///< Centre line y = amplitude sin(2 pi x / wavelength).
  double wavelength = 3.0;
  double half_width = 0.2;  ///< Maximum distance to the centre line; beyond it, the point collides.
  double start_spread = 0.06;  ///< Standard deviation of the start y, normal around 0.
  double gain = 0.1;           ///< K: displacement by a control of norm 1.
  double rotation = 0.6;       ///< Rotation of the control, rad, unknown to controllers.
};

/// A point in a curved corridor: x' = x + K R u, the simplest system with |x' - x| <= K |u| (Sec.
/// IV-C) and an unknown rotation R of the control.
///
/// State: point(2). Start: x = 0, y normal, resampled until it is at most 0.7 half widths from the
/// centre line. The supervisor follows the centre line at a fixed speed by aiming at a point
/// slightly ahead on the line.
class CorridorPlant final : public GalleryPlant {
 public:
  /// @throws std::invalid_argument naming the option out of range.
  explicit CorridorPlant(const CorridorOptions& options = {});

  [[nodiscard]] const CorridorOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void Supervise(const SupervisorVariation& variation, std::span<double> u) const noexcept override;

  /// Returns half_width minus the distance of (x, y) to the centre line: > 0 inside.
  [[nodiscard]] double Clearance(double x, double y) const noexcept;
  /// Returns points along the wall on one side (1: above the centre line, -1: below) for drawing.
  /// The points have x in [left, right] and lie a twentieth of a unit apart along the centre line.
  [[nodiscard]] std::vector<std::array<double, 2>> Wall(double side, double left,
                                                        double right) const;

 private:
  void Start(core::Random& random) noexcept override;
  void Step(std::span<const double> u) noexcept override;
  [[nodiscard]] bool Done() const noexcept override;

  CorridorOptions options_;
  std::vector<std::array<double, 2>> centre_;  ///< Centre line as a polyline.
};

}  // namespace dfr::sim
