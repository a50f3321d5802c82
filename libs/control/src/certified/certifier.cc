#include "dfr/control/certified/certifier.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "dfr/control/certified/constants.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/contract.h"

namespace dfr::control {

using core::AsSpan;

// Offsets of the phases in search order. A control usually aims at the next phase.
constexpr std::array kPhaseSearchOrder = {1, 0, 2, -1, 3, -2, -3};
static_assert(kPhaseSearchOrder.size() == 2 * PhaseTracker::kWindow + 1);

namespace {

// Scales all entries except those with few values.
void Shrink(const StepLimits& limits, double share, Eigen::VectorXd& v) noexcept {
  for (Eigen::Index k = 0; k < v.size(); ++k) v[k] *= limits.HasFewValues(k) ? 1.0 : share;
}

// Returns true if an entry with few values is not zero.
bool UsesFewValues(const StepLimits& limits, const Eigen::VectorXd& v) noexcept {
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    if (limits.HasFewValues(k) && v[k] != 0.0) return true;
  }
  return false;
}

}  // namespace

Certifier::Certifier(const Certificate& certificate, int num_features, int control_dim,
                     double control_unit)
    : certificate_(certificate),
      control_unit_(control_unit),
      effect_(Eigen::VectorXd::Zero(num_features)),
      shift_(Eigen::VectorXd::Zero(num_features)),
      part_(Eigen::VectorXd::Zero(control_dim)),
      chosen_(Eigen::VectorXd::Zero(control_dim)) {
  DFR_THROW_UNLESS(certificate.direction_error > 0.0 && std::isfinite(certificate.direction_error),
                   "a certificate needs an eps that is positive and finite, not "
                       << certificate.direction_error);
  DFR_THROW_UNLESS(std::isfinite(certificate.level),
                   "the level of a certificate must be finite: " << certificate.level);
  DFR_THROW_UNLESS(certificate.state_error >= 0.0 && std::isfinite(certificate.state_error),
                   "the state error of a certificate must be finite and not negative: "
                       << certificate.state_error);
}

void Certifier::Reset() noexcept { stalls_ = 0; }

Certifier::RequiredLevel Certifier::Check(const LocalModel& model, int phase,
                                          const Eigen::VectorXd& v) const noexcept {
  return Check(model, phase, v, model.Predict(phase, v));
}

Certifier::RequiredLevel Certifier::Check(const LocalModel& model, int phase,
                                          const Eigen::VectorXd& v,
                                          const PredictedLevel& there) const noexcept {
  // A margin for rounding of l: a control that passes must stay in the support.
  constexpr double kRounding = 1e-12;
  const double e =
      certificate_.direction_error * v.norm() * control_unit_ + certificate_.state_error;
  const double level =
      there.gradient.norm() * e + model.support.curvature_bound(phase) * e * e - certificate_.level;
  return {phase, level, level + kRounding - there.level};
}

Certifier::RequiredLevel Certifier::Predict(const LocalModel& model, int phase,
                                            const Eigen::VectorXd& v) const noexcept {
  RequiredLevel best{.phase = phase, .missing = std::numeric_limits<double>::infinity()};
  for (const int offset : kPhaseSearchOrder) {
    if (phase + offset < 0) continue;
    const RequiredLevel need = Check(model, phase + offset, v);
    if (need.missing < best.missing) best = need;
    if (best.met()) break;
  }
  return best;
}

double Certifier::StepFraction(const LocalModel& model, int phase,
                               const Eigen::VectorXd& v) noexcept {
  return !v.isZero(0.0) && Predict(model, phase, v).met() ? 1.0
                                                          : ReducedStepFraction(model, phase, v);
}

double Certifier::ReducedStepFraction(const LocalModel& model, int phase,
                                      const Eigen::VectorXd& v) noexcept {
  const double norm = v.norm() * control_unit_;
  if (norm == 0.0) return 1.0;
  effect_.noalias() = model.response.jacobian().lazyProduct(v);
  double best = 0.0;
  for (int q = std::max(0, phase - PhaseTracker::kWindow);
       q <= phase + PhaseTracker::kWindow && best < 1.0; ++q) {
    SafeBall ball = ComputeSafeBall(model.support, q, model.z, AsSpan(shift_), certificate_.level);
    ball.radius -= certificate_.state_error;
    const double share =
        LargestShare(ball, AsSpan(shift_), AsSpan(effect_), certificate_.direction_error * norm);
    best = std::max(best, std::clamp(share, 0.0, 1.0));
  }
  for (double share = 0.5; share >= certified::kLeastPart && share > best; share /= 2.0) {
    part_ = share * v;
    if (Check(model, phase + 1, part_).met()) best = share;
  }
  return best;
}

// Same as ReducedStepFraction(), for the scaling of Shrink().
double Certifier::ShrunkFraction(const LocalModel& model, const StepLimits& limits, int phase,
                                 const Eigen::VectorXd& v) noexcept {
  if (!UsesFewValues(limits, v)) return ReducedStepFraction(model, phase, v);
  // The balls at z bound only multiples of v.
  for (double share = 0.5; share >= certified::kLeastPart; share /= 2.0) {
    part_ = v;
    Shrink(limits, share, part_);
    if (Predict(model, phase, part_).met()) return share;
  }
  return 0.0;
}

// Changes `v` by minimal ascent steps. Returns true once it provably ends inside `phase`.
bool Certifier::Project(const LocalModel& model, const StepLimits& limits, int phase,
                        Eigen::VectorXd& v) const noexcept {
  PredictedLevel there = model.Predict(phase, v);
  RequiredLevel need = Check(model, phase, v, there);
  for (int round = 0; round < certified::kRounds && !need.met(); ++round) {
    if (AscendSupport(model, {phase, need.level + certified::kOvershoot}, limits, v, there) <
        need.level)
      break;
    need = Check(model, phase, v, there);
  }
  return need.met();
}

Certifier::CertifiedStep Certifier::Admit(const LocalModel& model, LocalFit& fit,
                                          const StepLimits& limits, const Request& request,
                                          Eigen::VectorXd& v) noexcept {
  CertifiedStep admitted{.mode = request.mode, .gets_on = request.mode != Mode::kProbe};
  if (admitted.gets_on) {
    chosen_ = v;
    if (!Project(model, limits, request.phase + 1, v)) {
      // Tries the nominal control of nearby demonstrations, changed as little as possible.
      const bool known = request.demonstrated && fit.NominalControl(v);
      if (known) limits.Snap(v);
      limits.Limit(v);
      if (known && Project(model, limits, request.phase + 1, v)) {
        admitted.mode = Mode::kRecovery;
        admitted.demonstrated = true;
      } else {
        v = chosen_;
        admitted.share = ShrunkFraction(model, limits, request.phase, v);
      }
    }
  } else {
    const bool whole = Predict(model, request.phase, v).met();
    admitted.share = whole ? 1.0 : ShrunkFraction(model, limits, request.phase, v);
  }
  if (admitted.share < certified::kLeastShare) {
    // Maximises the margin first, because the state is too close to the boundary in this direction.
    v.setZero();
    static_cast<void>(
        AscendSupport(model, {request.phase, std::numeric_limits<double>::infinity()}, limits, v));
    admitted = {
        .share = StepFraction(model, request.phase, v), .mode = Mode::kRecovery, .gets_on = false};
  }
  // A zero control that passes is a pause of the policy or of the demonstrations.
  const bool recovers = admitted.mode == Mode::kRecovery && !admitted.gets_on;
  const bool stalls = recovers && (admitted.share < certified::kLeastShare || v.isZero());
  stalls_ = stalls ? stalls_ + 1 : 0;
  admitted.any = stalls_ < certified::kMaxStalls;
  Shrink(limits, admitted.share, v);
  return admitted;
}

std::optional<double> Certifier::FindViolation(const Eigen::VectorXd& v,
                                               const Eigen::VectorXd& effect,
                                               const Eigen::VectorXd& dz) const noexcept {
  const double norm = v.norm() * control_unit_;
  const double change = (dz - effect).norm();
  const double allowed = certificate_.direction_error;
  // Both states are observed, each with an error of up to delta.
  if (change <= allowed * norm * (1.0 + kFeatureRounding) + 2.0 * certificate_.state_error +
                    kFeatureRounding) {
    return std::nullopt;
  }
  return norm > 0.0 ? change / norm : std::numeric_limits<double>::infinity();
}

}  // namespace dfr::control
