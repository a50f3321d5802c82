#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "dfr/control/certified/certificate.h"
#include "dfr/control/controller.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/control/response/local_fit.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Decides which controls provably end inside the support of a nearby phase, and compares the
/// certificate's assumption with the outcome of each control (docs/certificates.md). Never
/// allocates, locks or throws; one object belongs to one thread.
class Certifier {
 public:
  /// @param control_unit  |u| = control_unit |v|.
  /// @throws std::invalid_argument if eps is not positive and finite, the level is not finite, or
  /// the state error is negative or not finite.
  Certifier(const Certificate& certificate, int num_features, int control_dim, double control_unit);

  /// Starts an episode.
  void Reset() noexcept;
  /// eta: the state must satisfy l_q >= -level() for a phase q.
  [[nodiscard]] double level() const noexcept { return certificate_.level; }
  /// Smallest l_q(z + J v) at which v passes.
  struct RequiredLevel {
    int phase = 0;         ///< q
    double level = 0.0;    ///< |grad l_q(z + J v)| e + c e^2 - eta, e = eps |u| + delta
    double missing = 0.0;  ///< `level` - l_q(z + J v), including an allowance for rounding.
    [[nodiscard]] bool met() const noexcept { return missing <= 0.0; }
  };
  /// Checks that l_q(z + J v + d) >= -eta, q = `phase`, for every d with |d| <= eps |u| + delta.
  [[nodiscard]] RequiredLevel Check(const LocalModel& model, int phase,
                                    const Eigen::VectorXd& v) const noexcept;
  /// Overload for a known `there` = model.Predict(phase, v).
  [[nodiscard]] RequiredLevel Check(const LocalModel& model, int phase, const Eigen::VectorXd& v,
                                    const PredictedLevel& there) const noexcept;
  /// Returns Check() at the first phase q with |q - phase| <= PhaseTracker::kWindow at which `v`
  /// passes, searching from phase + 1 outwards. If `v` passes at none, returns the result with the
  /// smallest `missing`.
  [[nodiscard]] RequiredLevel Predict(const LocalModel& model, int phase,
                                      const Eigen::VectorXd& v) const noexcept;
  /// Returns s in [0, 1] for which s v provably ends inside B_q(eta) for a q with |q - phase| <=
  /// PhaseTracker::kWindow. If v passes Predict(), s is 1. Otherwise s is the largest fraction that
  /// the balls at z allow. A larger s of 1/2 or 1/4 is used if it passes Check() at the next phase.
  [[nodiscard]] double StepFraction(const LocalModel& model, int phase,
                                    const Eigen::VectorXd& v) noexcept;
  /// Same as StepFraction() without Predict(), for a control that Check() has rejected.
  [[nodiscard]] double ReducedStepFraction(const LocalModel& model, int phase,
                                           const Eigen::VectorXd& v) noexcept;
  /// The phase of a requested control, and its source.
  struct Request {
    int phase = 0;
    Mode mode = Mode::kPolicy;
    bool demonstrated = true;  ///< Nominal controls of demonstrations may replace the control.
  };
  /// Result of Admit().
  struct CertifiedStep {
    bool any = true;     ///< False after certified::kMaxStalls consecutive stalls.
    double share = 1.0;  ///< Applied fraction of the chosen control.
    Mode mode = Mode::kPolicy;
    bool gets_on = true;  ///< True if the control aims at the next phase.
    /// True if a nominal control of demonstrations replaced the requested control.
    bool demonstrated = false;
  };
  /// Changes `v` until it provably ends inside B_q(eta) of a nearby phase q. First raises `v` to
  /// the required level by AscendSupport(), then tries the nominal control of nearby
  /// demonstrations, and finally shrinks the requested control. If almost nothing of it remains,
  /// `v` becomes a recovery that maximises the margin. A recovery of which almost nothing passes is
  /// a stall. A zero control from another source is not. An entry with few values keeps its value
  /// in a raised or shrunk control, and is 0 in a recovery. `fit` must be model.response.
  [[nodiscard]] CertifiedStep Admit(const LocalModel& model, LocalFit& fit,
                                    const StepLimits& limits, const Request& request,
                                    Eigen::VectorXd& v) noexcept;
  /// Margin of FindViolation() for the rounding of features.
  static constexpr double kFeatureRounding = 1e-9;
  /// Compares the observed change `dz` with the change `effect` that was predicted for `v`.
  /// @returns |dz - J u| / |u|, infinite if u = 0, if the two changes violate the assumption.
  [[nodiscard]] std::optional<double> FindViolation(const Eigen::VectorXd& v,
                                                    const Eigen::VectorXd& effect,
                                                    const Eigen::VectorXd& dz) const noexcept;

 private:
  [[nodiscard]] double ShrunkFraction(const LocalModel& model, const StepLimits& limits, int phase,
                                      const Eigen::VectorXd& v) noexcept;
  [[nodiscard]] bool Project(const LocalModel& model, const StepLimits& limits, int phase,
                             Eigen::VectorXd& v) const noexcept;

  Certificate certificate_;
  double control_unit_;
  int stalls_ = 0;  ///< Number of consecutive stalls.
  Eigen::VectorXd effect_;
  Eigen::VectorXd shift_;
  Eigen::VectorXd part_;
  Eigen::VectorXd chosen_;
};

}  // namespace dfr::control
