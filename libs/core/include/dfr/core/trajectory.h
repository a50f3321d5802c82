#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::core {

/// Result of a rollout (Sec. V-A).
enum class Outcome {
  kCompleted,  ///< Reached the goal without a collision.
  kHalted,     ///< Neither completed nor collided: the controller halted, or the time ran out.
  kCollided,   ///< Violated a constraint, possibly in a probe or a recovery control.
};

[[nodiscard]] constexpr const char* Name(Outcome outcome) noexcept {
  switch (outcome) {
    case Outcome::kCompleted:
      return "completed";
    case Outcome::kHalted:
      return "halted";
    case Outcome::kCollided:
      return "collided";
  }
  return "unknown";
}

/// Largest valid magnitude of an entry of a state or control in demonstrations. It is the largest
/// number in single precision, because models sum transitions in single precision.
inline constexpr double kLargestEntry = std::numeric_limits<float>::max();
/// Returns true unless `value` is NaN, infinite or beyond kLargestEntry.
[[nodiscard]] inline bool IsMeasurable(double value) noexcept {
  return std::abs(value) <= kLargestEntry;
}

/// tau = {(x_0, u_0), ..., (x_{T-1}, u_{T-1}), x_T} (Sec. III).
struct Trajectory {
  Matrix states;    ///< (T + 1) x state_dim
  Matrix controls;  ///< T x control_dim
  Outcome outcome = Outcome::kHalted;
  std::uint64_t seed = 0;  ///< Seed of the plant's Reset().

  [[nodiscard]] int num_steps() const noexcept { return static_cast<int>(controls.rows()); }
};

/// Demonstrated controls, sorted by time step.
struct ControlSelection {
  std::vector<std::pair<std::size_t, Eigen::Index>> rows;  ///< Demonstration and time step.
  std::vector<int> begin;  ///< First row of time step t; one more entry at the end.
};

/// Selects at most `max_per_step` controls of each time step, evenly over the demonstrations whose
/// control is not zero. Consecutive time steps select different demonstrations: a window of time
/// steps then covers most demonstrations.
/// @param controls  T x control_dim, one matrix per demonstration.
[[nodiscard]] ControlSelection SelectControls(std::span<const Matrix* const> controls,
                                              int max_per_step);

}  // namespace dfr::core
