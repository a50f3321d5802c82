#pragma once

#include <memory>
#include <span>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim {

/// Options for DiscPushPlant. Metres and radians.
struct DiscPushOptions {
  double object_radius = 0.04;
  double pusher_radius = 0.015;
  double start_x = 0.12;  ///< Object start: x within +-0.02 of this value.
  double start_y = 0.08;  ///< Object start: y within +-start_y.
  double gate_x = 0.32;   ///< Position of the two round stay-out regions at (gate_x, +-gate_y).
  double gate_y = 0.13;
  double red_radius = 0.06;  ///< Radius of the stay-out regions, which neither disc may touch.
  double goal_x = 0.44;      ///< Goal: the object's centre within goal_radius of (goal_x, 0).
  double goal_radius = 0.03;
  double step = 0.02;     ///< Displacement of the pusher by a control of norm 1.
  double rotation = 0.5;  ///< Rotation of the control, rad, unknown to controllers.
};

/// A disc pushes a disc through a gate onto a goal: the Pusher task in the plane.
///
/// Quasi-static: the pusher moves in substeps of a millimetre. On overlap, the object moves along
/// the line of centres, which is its motion under a frictionless contact and uniform support
/// friction. A disc pushed by a disc slips off sideways without active steering: weak policies
/// fail.
///
/// State: pusher(2), object(2), centres in metres. The supervisor pushes the object through the
/// gate to the goal by feedback. It moves the pusher around the object if the pusher is on the
/// wrong side.
class DiscPushPlant final : public GalleryPlant {
 public:
  /// @throws std::invalid_argument naming the option out of range.
  explicit DiscPushPlant(const DiscPushOptions& options = {});

  [[nodiscard]] const DiscPushOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void Supervise(const SupervisorVariation& variation, std::span<double> u) const noexcept override;

 private:
  void Start(core::Random& random) noexcept override;
  void Step(std::span<const double> u) noexcept override;
  [[nodiscard]] bool Done() const noexcept override;
  void Look() noexcept;

  DiscPushOptions options_;
};

}  // namespace dfr::sim
