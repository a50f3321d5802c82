#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/control/certificate.h"
#include "dfr/control/support_step.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// How a certificate's assumption failed, at the first control where it was seen to.
struct Violation {
  int control = -1;       ///< Number of the applied control, from 0; -1: none was seen.
  double observed = 0.0;  ///< |dz| / |u|, or |dz - J u| / |u| ...
  double allowed = 0.0;   ///< ... which was trusted to stay below this.
};

/// Decides which share of a control provably ends inside the support of some phase near the present
/// one, and compares afterwards what the certificate trusts with what happened (docs/recovery.md).
/// Never allocates, locks or throws; one object belongs to one thread.
class Certifier {
 public:
  /// @param control_unit  |u| = control_unit |v|.
  /// @throws std::invalid_argument if the certificate's constant is not positive and finite.
  Certifier(const Certificate& certificate, int num_features, double control_unit);

  /// Off: every control passes, nothing is claimed.
  [[nodiscard]] bool active() const noexcept { return certificate_.kind != CertificateKind::kNone; }
  /// Starts an episode.
  void Reset() noexcept;
  /// The largest s in [0, 1] for which the control s v provably ends inside B_q, for some q with
  /// |q - phase| <= PhaseTracker::kWindow.
  [[nodiscard]] double Share(const LocalModel& model, int phase, const Eigen::VectorXd& v) noexcept;
  /// Control number `control`, `v`, was predicted to change the features by `effect` and changed
  /// them by `dz`. @returns false on the first contradiction to the assumption; see violation().
  [[nodiscard]] bool Confirms(int control, const Eigen::VectorXd& v, const Eigen::VectorXd& effect,
                              const Eigen::VectorXd& dz) noexcept;
  [[nodiscard]] const Violation& violation() const noexcept { return violation_; }

 private:
  Certificate certificate_;
  double control_unit_;
  Violation violation_;
  Eigen::VectorXd effect_;
  Eigen::VectorXd shift_;
};

}  // namespace dfr::control
