#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "dfr/core/plant.h"
#include "dfr/core/policy.h"

namespace dfr::sim {

/// Options for DiscPushPlant. Metres and radians.
struct DiscPushOptions {
  double object_radius = 0.04;
  double pusher_radius = 0.015;
  double start_x = 0.12;  ///< The object starts within +-0.02 of this,
  double start_y = 0.08;  ///< and y within +-start_y.
  double gate_x = 0.32;   ///< Two round stay-out regions at (gate_x, +-gate_y)
  double gate_y = 0.13;
  double red_radius = 0.06;  ///< of this radius, for object and pusher.
  double goal_x = 0.44;  ///< Completed with the object's centre within goal_radius of (goal_x, 0).
  double goal_radius = 0.03;
  double step = 0.02;     ///< A control of norm 1 moves the pusher by this far.
  double rotation = 0.5;  ///< By how much the control is turned. Controllers are not told.
};

/// A disc pushes a disc through a gate onto a goal: pushing as in the Pusher task, in the plane.
///
/// Quasi-static: the pusher moves in substeps of a millimetre, and where it would overlap the
/// object the object yields along the line of centres, which is its motion under a frictionless
/// contact and evenly spread support friction. A disc pushed by a disc slips off sideways unless it
/// is steered, so weak policies fail.
///
/// State: pusher(2), object(2), centres in metres. Control (2): entries saturate at +-1. One object
/// belongs to one thread.
class DiscPushPlant final : public core::SimulatedPlant {
 public:
  /// @throws std::invalid_argument naming the option out of range.
  explicit DiscPushPlant(const DiscPushOptions& options = {});

  [[nodiscard]] const core::StateLayout& layout() const noexcept override { return layout_; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  [[nodiscard]] const DiscPushOptions& options() const noexcept { return options_; }
  void Reset(std::uint64_t seed) override;
  /// A control of another size or with a non-finite entry is refused.
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override { return collided_; }
  void Halt() noexcept override {}
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

 private:
  void Look() noexcept;

  DiscPushOptions options_;
  core::StateLayout layout_;
  std::array<double, 4> state_{};
  bool collided_ = false;
};

/// Pushes the object of a DiscPushPlant through the gate to the goal by feedback, and goes around
/// it where it is on the wrong side. Knows the plant's rotation.
class DiscPushSupervisor final : public core::Policy {
 public:
  /// `speed` is the norm of the control at most, in (0, 1].
  explicit DiscPushSupervisor(const DiscPushOptions& options, double speed = 0.7);
  [[nodiscard]] int state_dim() const noexcept override { return 4; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

 private:
  DiscPushOptions options_;
  double speed_;
};

}  // namespace dfr::sim
