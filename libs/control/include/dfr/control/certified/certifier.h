#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/control/certified/certificate.h"
#include "dfr/control/controller.h"
#include "dfr/control/guided/response_estimate.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// How a certificate's assumption failed, at the first control where it was seen to.
struct Violation {
  int control = -1;       ///< Number of the applied control, from 0; -1: none was seen.
  double observed = 0.0;  ///< |dz - J u| / |u| ...
  double allowed = 0.0;   ///< ... which was trusted to stay below this.
};

/// Decides which controls provably end inside the support of some phase near the present one, and
/// compares afterwards what the certificate trusts with what happened (docs/certificates.md). Never
/// allocates, locks or throws; one object belongs to one thread.
class Certifier {
 public:
  /// @param control_unit  |u| = control_unit |v|.
  /// @throws std::invalid_argument if eps is not positive and finite, or the level or the state
  /// error is
  ///   negative or not finite.
  Certifier(const Certificate& certificate, int num_features, int control_dim, double control_unit);

  /// Starts an episode.
  void Reset() noexcept;
  /// eta: the state must be where some l_q >= -level().
  [[nodiscard]] double level() const noexcept { return certificate_.level; }
  /// What l_q(z + J v) must be for v to pass.
  struct RequiredLevel {
    int phase = 0;         ///< q
    double level = 0.0;    ///< |grad l_q(z + J v)| e + c e^2 - eta, e = eps |u|
    double missing = 0.0;  ///< `level` less l_q(z + J v); what rounding may add counts.
    [[nodiscard]] bool met() const noexcept { return missing <= 0.0; }
  };
  /// Whether l_q(z + J v + d) >= -eta for every |d| <= eps |u|, q = `phase`.
  [[nodiscard]] RequiredLevel Check(const LocalModel& model, int phase,
                                    const Eigen::VectorXd& v) const noexcept;
  /// The same where model.Predict(phase, v) is known.
  [[nodiscard]] RequiredLevel Check(const LocalModel& model, int phase, const Eigen::VectorXd& v,
                                    const PredictedLevel& there) const noexcept;
  /// The first phase q with |q - phase| <= PhaseTracker::kWindow, from phase + 1 outwards, that
  /// passes Check(), else the one that misses least.
  [[nodiscard]] RequiredLevel Predict(const LocalModel& model, int phase,
                                      const Eigen::VectorXd& v) const noexcept;
  /// A share s in [0, 1] for which the control s v provably ends inside B_q(eta), for some q with
  /// |q - phase| <= PhaseTracker::kWindow: by the ball at z the largest, and 1, a half or a quarter
  /// if that is more and passes Check() at the next phase.
  [[nodiscard]] double Share(const LocalModel& model, int phase, const Eigen::VectorXd& v) noexcept;
  /// The same of a control that Check() has refused, which is not asked again.
  [[nodiscard]] double Part(const LocalModel& model, int phase, const Eigen::VectorXd& v) noexcept;
  /// A control that is to be applied in `phase`, and who chose it.
  struct Request {
    int phase = 0;
    Mode mode = Mode::kPolicy;
  };
  /// What became of it.
  struct CertifiedStep {
    bool any = true;     ///< False: next to nothing passed three times in a row.
    double share = 1.0;  ///< The part of the control that was chosen.
    Mode mode = Mode::kPolicy;
    bool gets_on = true;  ///< Whether it is meant for the next phase.
  };
  /// Changes `v` until it provably ends inside B_q(eta) of a phase q near the present one: by
  /// AscendSupport() towards the level that it needs, from what demonstrations did nearby if need
  /// be; where that does not do, it is shrunk. Where next to nothing of it is left, `v` becomes a
  /// recovery that makes all the room there is.
  /// @param estimate  of J, computed last at the model's z.
  [[nodiscard]] CertifiedStep Admit(const LocalModel& model, ResponseEstimate& estimate,
                                    const StepLimits& limits, const Request& request,
                                    Eigen::VectorXd& v) noexcept;
  /// Control number `control`, `v`, was predicted to change the features by `effect` and changed
  /// them by `dz`. @returns false on the first contradiction to the assumption; see violation().
  [[nodiscard]] bool Confirms(int control, const Eigen::VectorXd& v, const Eigen::VectorXd& effect,
                              const Eigen::VectorXd& dz) noexcept;
  [[nodiscard]] const Violation& violation() const noexcept { return violation_; }

 private:
  [[nodiscard]] bool Project(const LocalModel& model, const StepLimits& limits, int phase,
                             Eigen::VectorXd& v) const noexcept;

  Certificate certificate_;
  double control_unit_;
  Violation violation_;
  int stalls_ = 0;  ///< Controls in a row of which next to nothing passed.
  Eigen::VectorXd effect_;
  Eigen::VectorXd shift_;
  Eigen::VectorXd part_;
  Eigen::VectorXd chosen_;
};

}  // namespace dfr::control
