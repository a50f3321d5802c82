#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/core/policy.h"

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
/// State: point(2). Control (2): entries saturate at +-1. One object belongs to one thread.
class CorridorPlant final : public core::SimulatedPlant {
 public:
  /// @throws std::invalid_argument naming the option out of range.
  explicit CorridorPlant(const CorridorOptions& options = {});

  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  [[nodiscard]] const CorridorOptions& options() const noexcept { return options_; }
  /// Start: x = 0, y normal, drawn anew until it is 0.7 half widths from the centre line at most.
  void Reset(std::uint64_t seed) override;
  /// A control of another size or with a non-finite entry is refused.
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override { return collided_; }
  void Halt() noexcept override {}
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

  /// Distance of (x, y) to the centre line, negated beyond the half width: > 0 inside.
  [[nodiscard]] double Clearance(double x, double y) const noexcept;
  /// Points along the wall on one side (1: above the centre line, -1: below), for drawing: those
  /// whose x lies in [left, right], a twentieth of a unit apart along the centre line.
  [[nodiscard]] std::vector<std::array<double, 2>> Wall(double side, double left,
                                                        double right) const;

 private:
  CorridorOptions options_;
  core::StateLayout layout_;
  std::vector<std::array<double, 2>> centre_;  ///< The centre line as a polygon.
  std::array<double, 2> point_{};
  bool collided_ = false;
};

/// Follows the centre line of a CorridorPlant, whose rotation it knows: aims at the point of the
/// line a little ahead, at a fixed speed.
class CorridorSupervisor final : public core::Policy {
 public:
  /// `speed` is the norm of the control, in (0, 1].
  explicit CorridorSupervisor(const CorridorOptions& options, double speed = 0.6);
  [[nodiscard]] int state_dim() const noexcept override { return 2; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

 private:
  CorridorOptions options_;
  double speed_;
};

}  // namespace dfr::sim
