#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "dfr/core/features.h"

namespace dfr::core {

/// What a plant says of the last call. Anything but kOk ends the rollout in Halt().
enum class PlantStatus {
  kOk,
  kRefused,  ///< The control was not applied: wrong size, non-finite, or out of limits.
  kFault,    ///< Applied or not is unknown: a device, or the simulation, failed.
};

/// The whole world of one task, robot and objects, that comes to rest after every control
/// (Sec. III). One object belongs to one thread at a time.
class Plant {
 public:
  virtual ~Plant() = default;

  /// Which entries of a state mean what, with units in the implementation's documentation.
  [[nodiscard]] virtual const StateLayout& layout() const noexcept = 0;
  [[nodiscard]] int state_dim() const noexcept { return layout().state_dim(); }
  [[nodiscard]] virtual int control_dim() const noexcept = 0;

  /// Brings the plant to a start state x_0 ~ p_0; the same seed gives the same state.
  /// @throws std::runtime_error if it cannot be reached.
  virtual void Reset(std::uint64_t seed) = 0;

  /// Applies `control` and waits until the plant is at rest again. Must not allocate or throw.
  [[nodiscard]] virtual PlantStatus Apply(std::span<const double> control) noexcept = 0;

  /// Writes the present state (state_dim() entries).
  virtual void Observe(std::span<double> state) const noexcept = 0;

  /// The task is done, in the present state. Not known to controllers: only rollouts look.
  [[nodiscard]] virtual bool completed() const noexcept = 0;
  /// A constraint has been violated at any moment since Reset(). Not known to controllers.
  [[nodiscard]] virtual bool collided() const noexcept = 0;

  /// Holds still. Always works, from any state, any number of times.
  virtual void Halt() noexcept = 0;
};

/// A plant whose whole state can be copied: what the finite-difference oracle of Sec. V-A needs.
class SimulatedPlant : public Plant {
 public:
  /// An independent plant of the same kind in the same state: the same control then leads both to
  /// the same next state, bit for bit.
  [[nodiscard]] virtual std::unique_ptr<SimulatedPlant> Clone() const = 0;

  /// Takes over the state of `other`, which must be of the same kind and model. Never allocates.
  virtual void CopyStateFrom(const SimulatedPlant& other) noexcept = 0;
};

}  // namespace dfr::core
