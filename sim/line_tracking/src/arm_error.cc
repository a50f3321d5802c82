#include "dfr/sim/line_tracking/arm_error.h"

#include <cmath>
#include <numbers>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"

namespace dfr::sim {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

// Returns half the range of joint values over the gauze, about `Centre()`.
PsmJoints Spread() noexcept {
  PsmJoints q;
  q << 0.25, 0.2, 0.015, 0.25, 0.25, 0.25;
  return q;
}

PsmJoints Centre() noexcept {
  PsmJoints q = PsmJoints::Zero();
  q[2] = 0.12;
  return q;
}

struct Sample {
  PsmJoints q;
  double drift;
  Eigen::Vector3d tip;
};

// Returns a fixed sample of the workspace.
std::vector<Sample> Workspace() {
  constexpr int kSamples = 500;
  core::Random random(20170919);
  std::vector<Sample> samples(kSamples);
  for (Sample& sample : samples) {
    sample.q = Centre();
    for (int k = 0; k < 6; ++k) sample.q[k] += random.Uniform(-1.0, 1.0) * Spread()[k];
    sample.drift = random.Uniform(0.0, 2.0 * std::numbers::pi);
    sample.tip = Psm::Tip(sample.q);
  }
  return samples;
}

// Returns the mean distance between the true tips and the tips that the encoders report.
// `residuals` are the errors that `systematic` does not describe.
double MeanTipError(const std::vector<Sample>& samples, const kinematics::PsmCorrection& systematic,
                    const std::vector<PsmJoints>& residuals) {
  double sum = 0.0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const PsmJoints truth = systematic.Apply(samples[i].q) + residuals[i];
    sum += (Psm::Tip(truth) - samples[i].tip).norm();
  }
  return sum / static_cast<double>(samples.size());
}

}  // namespace

ArmError::ArmError(const ArmErrorOptions& options) {
  DFR_THROW_UNLESS(
      std::isfinite(options.mean_error_m) && options.mean_error_m >= 0.0,
      "arm error: mean_error_m must be finite and not negative: " << options.mean_error_m);
  DFR_THROW_UNLESS(
      options.mean_residual_m >= 0.0 && options.mean_residual_m <= options.mean_error_m,
      "arm error: mean_residual_m must lie in [0, mean_error_m], not " << options.mean_residual_m);
  core::Random random(options.seed);
  // An error of unit[k] in entry k moves the tip by a few millimetres. The errors are scaled below.
  PsmJoints unit;
  unit << 0.02, 0.02, 0.002, 0.05, 0.05, 0.05;
  ArmError raw;
  raw.systematic_.reference = Centre();
  for (int k = 0; k < 6; ++k) {
    raw.systematic_.offset[k] = unit[k] * random.Normal();
    raw.systematic_.scale[k] = 0.2 * unit[k] / Spread()[k] * random.Normal();
    raw.wave_[k] = unit[k] * random.Normal();
    raw.wave_rate_[k] = random.Uniform(1.0, 2.0) * std::numbers::pi / Spread()[k];
    raw.wave_phase_[k] = random.Uniform(0.0, 2.0 * std::numbers::pi);
    raw.creep_[k] = 0.5 * unit[k] * random.Normal();
    raw.creep_phase_[k] = random.Uniform(0.0, 2.0 * std::numbers::pi);
  }
  static const std::vector<Sample> kWorkspace = Workspace();
  const auto residuals = [](const ArmError& error) {
    std::vector<PsmJoints> all;
    for (const Sample& sample : kWorkspace) all.push_back(error.Residual(sample.q, sample.drift));
    return all;
  };
  const double residual_share =
      options.mean_residual_m / MeanTipError(kWorkspace, {}, residuals(raw));
  wave_ = residual_share * raw.wave_;
  wave_rate_ = raw.wave_rate_;
  wave_phase_ = raw.wave_phase_;
  creep_ = residual_share * raw.creep_;
  creep_phase_ = raw.creep_phase_;
  systematic_.reference = raw.systematic_.reference;
  // The total grows with the systematic part: bisection finds the fraction for the required mean.
  const std::vector<PsmJoints> scaled = residuals(*this);
  double low = 0.0;
  double high = 20.0;
  for (int i = 0; i < 40; ++i) {
    const double share = 0.5 * (low + high);
    systematic_.offset = share * raw.systematic_.offset;
    systematic_.scale = share * raw.systematic_.scale;
    (MeanTipError(kWorkspace, systematic_, scaled) < options.mean_error_m ? low : high) = share;
  }
}

PsmJoints ArmError::Truth(const PsmJoints& q, double drift) const noexcept {
  return systematic_.Apply(q) + Residual(q, drift);
}

PsmJoints ArmError::Residual(const PsmJoints& q, double drift) const noexcept {
  PsmJoints residual;
  for (int k = 0; k < 6; ++k) {
    residual[k] = wave_[k] * std::sin(wave_rate_[k] * q[k] + wave_phase_[k]) +
                  creep_[k] * std::sin(drift + creep_phase_[k]);
  }
  return residual;
}

}  // namespace dfr::sim
