#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "dfr/core/features/features.h"

namespace dfr::core {

/// Result of Plant::Apply(). Any value except kOk ends the rollout with Halt().
enum class PlantStatus {
  kOk,
  kRefused,  ///< Control not applied: wrong size, non-finite, or out of limits.
  kFault,    ///< Failure of a device or the simulation; the control may have been applied.
};

/// The robot and the objects of one task, which come to rest after every control (Sec. III). Each
/// Plant belongs to one thread at a time.
class Plant {
 public:
  virtual ~Plant() = default;

  /// Layout of a state. The implementation's documentation gives the units.
  [[nodiscard]] virtual const StateLayout& layout() const noexcept = 0;
  [[nodiscard]] int state_dim() const noexcept { return layout().state_dim(); }
  [[nodiscard]] virtual int control_dim() const noexcept = 0;

  /// Moves the plant to a start state x_0 ~ p_0. The same seed gives the same state.
  /// @throws std::runtime_error if the state cannot be reached.
  virtual void Reset(std::uint64_t seed) = 0;

  /// Applies `control` and waits until the plant is at rest. Must not allocate or throw.
  [[nodiscard]] virtual PlantStatus Apply(std::span<const double> control) noexcept = 0;

  /// Writes the current state (state_dim() entries).
  virtual void Observe(std::span<double> state) const noexcept = 0;

  /// Returns true if the task is complete in the current state. For rollouts only; controllers do
  /// not use it.
  [[nodiscard]] virtual bool completed() const noexcept = 0;
  /// Returns true if a constraint was violated since Reset(). For rollouts only; controllers do not
  /// use it.
  [[nodiscard]] virtual bool collided() const noexcept = 0;

  /// Holds the robot still. Must work from any state, any number of times.
  virtual void Halt() noexcept = 0;
};

/// A plant whose whole state can be copied, as the finite-difference oracle of Sec. V-A requires.
class SimulatedPlant : public Plant {
 public:
  /// Returns an independent plant of the same kind in the same state. The same control leads both
  /// to the same next state, bit for bit.
  [[nodiscard]] virtual std::unique_ptr<SimulatedPlant> Clone() const = 0;

  /// Copies the state of `other`, which must be of the same kind and model. Never allocates.
  virtual void CopyStateFrom(const SimulatedPlant& other) noexcept = 0;
};

}  // namespace dfr::core
