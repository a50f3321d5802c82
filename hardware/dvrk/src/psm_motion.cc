#include "dfr/hardware/psm_motion.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::hardware {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;
using kinematics::PsmReach;

// Clocks count whole nanoseconds: a sum of steps may miss the end of a move by several nanoseconds.
constexpr double kClockError = 1e-6;
// Tolerance of joint values converted to a pose and back; sine and cosine leave errors of 1e-15.
constexpr double kRoundTrip = 1e-6;

bool AllPositive(const PsmJoints& q) { return q.allFinite() && (q.array() > 0.0).all(); }

// Returns true if a receiver of the pose alone recovers these joint values.
bool Unambiguous(const PsmJoints& q, kinematics::PsmGeneration generation) noexcept {
  // A joint at its limit may come back slightly beyond it.
  const PsmJoints within =
      q.cwiseMax(Psm::lower_limits(generation)).cwiseMin(Psm::upper_limits(generation));
  PsmJoints back;
  const PsmReach reach = Psm::Inverse(Psm::Forward(q), back, generation);
  return (reach == PsmReach::kOk || reach == PsmReach::kJointLimit) &&
         (within - q).cwiseAbs().maxCoeff() < kRoundTrip &&
         (back - q).cwiseAbs().maxCoeff() < kRoundTrip;
}

}  // namespace

PsmLimits PsmLimits::Of(kinematics::PsmGeneration generation) {
  PsmLimits limits;
  limits.generation = generation;
  limits.lower = Psm::lower_limits(generation);
  limits.upper = Psm::upper_limits(generation);
  return limits;
}

void PsmLimits::Check() const {
  const PsmJoints lowest = Psm::lower_limits(generation);
  const PsmJoints highest = Psm::upper_limits(generation);
  for (int i = 0; i < 6; ++i) {
    DFR_THROW_UNLESS(lower[i] < upper[i] && lower[i] >= lowest[i] && upper[i] <= highest[i],
                     "limits of joint " << i << " must be in order and within the arm's limits ["
                                        << lowest[i] << ", " << highest[i] << "], not [" << lower[i]
                                        << ", " << upper[i] << "]");
  }
  DFR_THROW_UNLESS(AllPositive(max_speed), "max_speed must be positive and finite");
  DFR_THROW_UNLESS(max_tip_speed > 0.0 && std::isfinite(max_tip_speed),
                   "max_tip_speed must be positive and finite");
  DFR_THROW_UNLESS(workspace_min_m.allFinite() && workspace_max_m.allFinite() &&
                       (workspace_min_m.array() < workspace_max_m.array()).all(),
                   "workspace_min_m must be below workspace_max_m in every entry, and both must be "
                   "finite");
  DFR_THROW_UNLESS(jaw_lower < jaw_upper && std::isfinite(jaw_lower) && std::isfinite(jaw_upper),
                   "jaw_lower must be below jaw_upper, and both must be finite");
  DFR_THROW_UNLESS(max_jaw_speed > 0.0 && std::isfinite(max_jaw_speed),
                   "max_jaw_speed must be positive and finite");
}

PsmMotion::PsmMotion(const PsmLimits& limits, PsmProfile profile)
    : limits_(limits), profile_(profile) {
  limits.Check();
}

double PsmMotion::Peak() const noexcept { return profile_ == PsmProfile::kSmooth ? 1.5 : 1.0; }

void PsmMotion::Rest(const PsmJoints& joints) noexcept {
  moving_ = false;
  from_ = goal_ = setpoint_ = joints;
}

double PsmMotion::ShortestDuration(const PsmJoints& goal) const noexcept {
  const PsmJoints way = goal - setpoint_;
  // Maximum of the tip's mean speed over each part, in m per unit of the path parameter.
  double tip = 0.0;
  Eigen::Vector3d before = Psm::Tip(setpoint_);
  constexpr int kParts = 32;
  for (int i = 1; i <= kParts; ++i) {
    const Eigen::Vector3d at = Psm::Tip(setpoint_ + (static_cast<double>(i) / kParts) * way);
    tip = std::max(tip, kParts * (at - before).norm());
    before = at;
  }
  return Peak() * std::max(way.cwiseAbs().cwiseQuotient(limits_.max_speed).maxCoeff(),
                           tip / limits_.max_tip_speed);
}

PsmStatus PsmMotion::Start(const PsmJoints& goal, double duration_s) noexcept {
  if (!goal.allFinite() || !(duration_s >= 0.0) || !std::isfinite(duration_s)) {
    return PsmStatus::kInvalidGoal;
  }
  if (!((goal.array() >= limits_.lower.array()).all() &&
        (goal.array() <= limits_.upper.array()).all())) {
    return PsmStatus::kBeyondLimits;
  }
  const PsmJoints way = goal - setpoint_;
  const int looks = Psm::NumParts(way);
  using Faces = Eigen::Matrix<double, 6, 1>;
  Faces allowed_m = Faces::Constant(std::numeric_limits<double>::infinity());
  for (int i = 0; i <= looks; ++i) {
    const PsmJoints q = setpoint_ + (static_cast<double>(i) / looks) * way;
    if (!Unambiguous(q, limits_.generation)) return PsmStatus::kUnreachable;
    const Eigen::Vector3d tip = Psm::Tip(q);
    Faces outside_m;
    outside_m << limits_.workspace_min_m - tip, tip - limits_.workspace_max_m;
    outside_m = outside_m.cwiseMax(0.0);
    // A start outside cannot be changed: the path must not lead farther out, nor beyond another
    // face.
    if ((outside_m.array() > allowed_m.array()).any()) return PsmStatus::kOutsideWorkspace;
    allowed_m = allowed_m.cwiseMin(outside_m);
  }
  if (duration_s < (1.0 - 1e-9) * ShortestDuration(goal)) return PsmStatus::kTooFast;
  from_ = setpoint_;
  goal_ = goal;
  elapsed_s_ = 0.0;
  duration_s_ = duration_s;
  moving_ = duration_s > 0.0;
  if (!moving_) setpoint_ = goal;
  return PsmStatus::kOk;
}

void PsmMotion::Advance(double dt_s) noexcept {
  if (!moving_) return;
  elapsed_s_ += dt_s;
  if (elapsed_s_ >= duration_s_ - kClockError) {
    moving_ = false;
    setpoint_ = goal_;
    return;
  }
  const double s = elapsed_s_ / duration_s_;
  const double share = profile_ == PsmProfile::kSmooth ? s * s * (3.0 - 2.0 * s) : s;
  setpoint_ = from_ + share * (goal_ - from_);
}

PsmJoints PsmMotion::velocity() const noexcept {
  if (!moving_) return PsmJoints::Zero();
  const double s = elapsed_s_ / duration_s_;
  const double slope = profile_ == PsmProfile::kSmooth ? 6.0 * s * (1.0 - s) : 1.0;
  return slope / duration_s_ * (goal_ - from_);
}

void PsmRecentSetpoints::Start(const PsmJoints& setpoint, double time_s) noexcept {
  parts_.fill({time_s, setpoint, setpoint});
}

void PsmRecentSetpoints::Add(const PsmJoints& setpoint, double time_s) noexcept {
  if (time_s - parts_[newest_].begin_s >= window_s_ / (kParts - 1)) {
    newest_ = (newest_ + 1) % kParts;
    parts_[newest_] = {time_s, setpoint, setpoint};
    return;
  }
  Part& part = parts_[newest_];
  part.lower = part.lower.cwiseMin(setpoint);
  part.upper = part.upper.cwiseMax(setpoint);
}

bool PsmRecentSetpoints::Contain(const PsmJoints& setpoint,
                                 const PsmJoints& tolerance) const noexcept {
  PsmJoints lower = parts_[0].lower;
  PsmJoints upper = parts_[0].upper;
  for (const Part& part : parts_) {
    lower = lower.cwiseMin(part.lower);
    upper = upper.cwiseMax(part.upper);
  }
  return ((setpoint.array() >= (lower - tolerance).array()) &&
          (setpoint.array() <= (upper + tolerance).array()))
      .all();
}

void PsmRestOptions::Check() const {
  DFR_THROW_UNLESS(AllPositive(max_distance), "rest: max_distance must be positive and finite");
  DFR_THROW_UNLESS(AllPositive(max_speed), "rest: max_speed must be positive and finite");
  DFR_THROW_UNLESS(settle_s >= 0.0 && settle_s < 1e3, "rest: settle_s must lie in [0, 1000)");
}

PsmRest::PsmRest(const PsmRestOptions& options) : options_(options) { options.Check(); }

void PsmRest::Sample(const PsmJoints& measured, const PsmJoints& velocity,
                     const PsmJoints& setpoint, double time_s) noexcept {
  const bool calm =
      ((measured - setpoint).cwiseAbs().array() <= options_.max_distance.array()).all() &&
      (velocity.cwiseAbs().array() <= options_.max_speed.array()).all();
  if (calm && !calm_) since_s_ = time_s;
  calm_ = calm;
}

bool PsmRest::At(double time_s) const noexcept {
  return calm_ && time_s - since_s_ >= options_.settle_s - kClockError;
}

}  // namespace dfr::hardware
