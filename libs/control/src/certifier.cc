#include "dfr/control/certifier.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/control/phase_tracker.h"
#include "dfr/core/contract.h"

namespace dfr::control {

using core::AsSpan;

Certifier::Certifier(const Certificate& certificate, int num_features, double control_unit)
    : certificate_(certificate),
      control_unit_(control_unit),
      effect_(Eigen::VectorXd::Zero(num_features)),
      shift_(Eigen::VectorXd::Zero(num_features)) {
  const bool by_gain = certificate.kind == CertificateKind::kLipschitz ||
                       certificate.kind == CertificateKind::kRadius;
  DFR_THROW_UNLESS(!by_gain || (certificate.gain > 0.0 && std::isfinite(certificate.gain)),
                   Name(certificate.kind)
                       << " needs a gain K that is positive and finite, not " << certificate.gain);
  DFR_THROW_UNLESS(
      certificate.kind != CertificateKind::kDirection ||
          (certificate.direction_error > 0.0 && std::isfinite(certificate.direction_error)),
      "certified-direction needs an eps that is positive and finite, not "
          << certificate.direction_error);
}

void Certifier::Reset() noexcept { violation_ = {}; }

double Certifier::Share(const LocalModel& model, int phase, const Eigen::VectorXd& v) noexcept {
  const double norm = v.norm() * control_unit_;
  if (!active() || norm == 0.0) return 1.0;
  // Rounding must not carry a control that just passes over the bound.
  constexpr double kInside = 1.0 - 1e-9;
  effect_.noalias() = model.answer.jacobian().lazyProduct(v);
  double best = 0.0;
  for (int q = std::max(0, phase - PhaseTracker::kWindow);
       q <= phase + PhaseTracker::kWindow && best < 1.0; ++q) {
    double share = 0.0;
    if (certificate_.kind == CertificateKind::kLipschitz) {
      const double room = model.support.Decision(q, model.z) / model.support.lipschitz_bound(q);
      share = room / (certificate_.gain * norm) * kInside;
    } else {
      const SafeBall ball = ComputeSafeBall(model.support, q, model.z, AsSpan(shift_));
      share = certificate_.kind == CertificateKind::kRadius
                  ? ball.worst_radius() / (certificate_.gain * norm) * kInside
                  : LargestShare(ball, AsSpan(shift_), AsSpan(effect_),
                                 certificate_.direction_error * norm);
    }
    best = std::max(best, std::clamp(share, 0.0, 1.0));
  }
  return best;
}

bool Certifier::Confirms(int control, const Eigen::VectorXd& v, const Eigen::VectorXd& effect,
                         const Eigen::VectorXd& dz) noexcept {
  if (!active()) return true;
  // Rounding of the features is all that may come on top.
  constexpr double kRounding = 1e-9;
  const double norm = v.norm() * control_unit_;
  const bool direction = certificate_.kind == CertificateKind::kDirection;
  const double change = direction ? (dz - effect).norm() : dz.norm();
  const double allowed = direction ? certificate_.direction_error : certificate_.gain;
  if (change <= allowed * norm * (1.0 + kRounding) + kRounding) return true;
  const double observed = norm > 0.0 ? change / norm : std::numeric_limits<double>::infinity();
  violation_ = {control, observed, allowed};
  return false;
}

}  // namespace dfr::control
