#pragma once

#include <cstdint>

#include "dfr/core/matrix.h"

namespace dfr::core {

/// How a rollout ended (Sec. V-A).
enum class Outcome {
  kCompleted,  ///< Reached the goal without a collision.
  kHalted,     ///< Neither: stopped by the controller, or out of time.
  kCollided,   ///< Violated a constraint, probes and recovery controls included.
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

/// tau = {(x_0, u_0), ..., (x_{T-1}, u_{T-1}), x_T} (Sec. III).
struct Trajectory {
  Matrix states;    ///< (T + 1) x state_dim
  Matrix controls;  ///< T x control_dim
  Outcome outcome = Outcome::kHalted;
  std::uint64_t seed = 0;  ///< The plant's Reset() seed.

  [[nodiscard]] int num_steps() const noexcept { return static_cast<int>(controls.rows()); }
};

}  // namespace dfr::core
