#pragma once

#include <cstdint>
#include <span>

#include "dfr/control/controller.h"

namespace dfr::control {

/// Where a recovery stands when it is asked for its next control.
struct RecoverySituation {
  int t = 0;                  ///< The time step, the same during a recovery.
  int iteration = 0;          ///< From 0; a recovery begins at 0.
  std::span<const double> x;  ///< The present state.
  double g = 0.0;             ///< g_t(x), finite; > 0 unless a probe has just been applied.
  double lambda = 0.0;        ///< lambda_t, > 0.
};

/// What SwitchingController does while its gate is shut, one control a call. Like the controller
/// that owns it, never allocates, locks or throws, and belongs to one thread.
class RecoveryStrategy {
 public:
  virtual ~RecoveryStrategy() = default;

  /// Starts an episode.
  virtual void Reset(std::uint64_t seed) noexcept = 0;

  /// Writes a control to `u` and says what it is: kProbe is followed by a further call in the state
  /// it led to, kRecovery ends the iteration and the gate is looked at again, kHalt means that
  /// there is no direction to go.
  [[nodiscard]] virtual Mode Next(const RecoverySituation& situation,
                                  std::span<double> u) noexcept = 0;
};

}  // namespace dfr::control
