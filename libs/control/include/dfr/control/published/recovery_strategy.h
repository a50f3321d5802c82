#pragma once

#include <cstdint>
#include <span>

#include "dfr/control/controller.h"

namespace dfr::control {

/// State of a recovery when its next control is requested.
struct RecoverySituation {
  int t = 0;                  ///< Time step; constant during a recovery.
  int iteration = 0;          ///< Iteration of the recovery, starting at 0.
  std::span<const double> x;  ///< The present state.
  double g = 0.0;             ///< g_t(x), finite; > 0 except directly after a probe.
  double lambda = 0.0;        ///< lambda_t, > 0.
};

/// Chooses the controls of SwitchingController while its gate is closed, one per call. Like the
/// controller that owns it, never allocates, locks or throws, and belongs to one thread.
class RecoveryStrategy {
 public:
  virtual ~RecoveryStrategy() = default;

  /// Starts an episode.
  virtual void Reset(std::uint64_t seed) noexcept = 0;

  /// Writes a control to `u` and returns its kind. After kProbe the controller calls again in the
  /// resulting state. kRecovery ends the iteration, and the controller checks the gate. kHalt
  /// reports that there is no direction of ascent.
  [[nodiscard]] virtual Mode Next(const RecoverySituation& situation,
                                  std::span<double> u) noexcept = 0;
};

}  // namespace dfr::control
