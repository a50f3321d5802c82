#include "dfr/sim/line_tracking/disturbance.h"

#include <cmath>
#include <numbers>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"

namespace dfr::sim {
namespace {

constexpr std::array<const char*, 6> kEntry = {"x", "y", "z", "roll", "pitch", "yaw"};

double Breath(double phase) noexcept {
  const double lowest = std::exp(-1.0);
  return 2.0 * (std::exp(std::sin(phase)) - lowest) / (std::exp(1.0) - lowest);
}

// Returns the phase at which kBreath is at home. Home is the minimum of a translation. An angle
// oscillates about home and passes it where Breath() is 1.
double BreathStart(std::size_t entry) noexcept {
  return entry < 3 ? -std::numbers::pi / 2 : std::asin(std::log(std::cosh(1.0)));
}

kinematics::PlatformPose ToPose(const std::array<double, 6>& v) noexcept {
  return {{v[0], v[1], v[2]}, {v[3], v[4], v[5]}};
}

}  // namespace

const char* Name(Wave wave) noexcept {
  switch (wave) {
    case Wave::kNone:
      return "none";
    case Wave::kSine:
      return "sine";
    case Wave::kBreath:
      return "breath";
    case Wave::kRandom:
      return "random";
  }
  return "unknown";
}

Disturbance::Disturbance(const DisturbanceOptions& options, std::uint64_t seed)
    : wave_(options.wave), amplitude_(options.amplitude), frequency_(options.frequency) {
  for (std::size_t k = 0; k < 6; ++k) {
    DFR_THROW_UNLESS(std::isfinite(amplitude_[k]) && amplitude_[k] >= 0.0,
                     "disturbance: the amplitude of "
                         << kEntry[k] << " must be finite and not negative: " << amplitude_[k]);
    DFR_THROW_UNLESS(std::isfinite(frequency_[k]) && frequency_[k] >= 0.0,
                     "disturbance: the frequency of "
                         << kEntry[k] << " must be finite and not negative: " << frequency_[k]);
  }
  DFR_THROW_UNLESS(
      std::isfinite(options.latency_s) && options.latency_s >= 0.0,
      "disturbance: the latency must be finite and not negative: " << options.latency_s);
  if (wave_ == Wave::kSine || wave_ == Wave::kBreath) {
    // Motions of different frequencies eventually visit every corner of the box of extremes.
    for (unsigned corner = 0; corner < 64; ++corner) {
      std::array<double, 6> v{};
      for (std::size_t k = 0; k < 6; ++k) {
        const bool high = (corner >> k & 1U) != 0;
        const bool positive = wave_ == Wave::kBreath && k < 3;
        v[k] = positive ? (high ? 2.0 * amplitude_[k] : 0.0) : (high ? 1.0 : -1.0) * amplitude_[k];
      }
      DFR_THROW_UNLESS(kinematics::SprkPlatform::ReachableShare(ToPose(v)) == 1.0,
                       "disturbance: the platform cannot reach x "
                           << 1e3 * v[0] + 0.0 << ", y " << 1e3 * v[1] + 0.0 << ", z "
                           << 1e3 * v[2] + 0.0 << " mm, roll " << v[3] + 0.0 << ", pitch "
                           << v[4] + 0.0 << ", yaw " << v[5] + 0.0  // + 0.0 avoids "-0"
                           << " rad; lower the amplitudes");
    }
  }
  core::Random random(seed);
  for (std::size_t k = 0; k < 6; ++k) {
    std::array<double, 3> share{};
    double sum = 0.0;
    for (double& s : share) sum += s = random.Uniform(0.2, 1.0);
    for (std::size_t i = 0; i < 3; ++i) {
      const double sign = random.Uniform() < 0.5 ? -1.0 : 1.0;
      terms_[k][i] = {sign * amplitude_[k] * share[i] / sum,
                      2.0 * std::numbers::pi * frequency_[k] * random.Uniform(0.5, 1.5)};
    }
  }
}

kinematics::PlatformPose Disturbance::At(double t_s) const noexcept {
  std::array<double, 6> v{};
  switch (wave_) {
    case Wave::kNone:
      return {};
    case Wave::kSine:
      for (std::size_t k = 0; k < 6; ++k) {
        v[k] = amplitude_[k] * std::sin(2.0 * std::numbers::pi * frequency_[k] * t_s);
      }
      return ToPose(v);
    case Wave::kBreath:
      for (std::size_t k = 0; k < 6; ++k) {
        const double breath = Breath(frequency_[k] * t_s + BreathStart(k));
        v[k] = amplitude_[k] * (k < 3 ? breath : breath - 1.0);
      }
      return ToPose(v);
    case Wave::kRandom:
      break;
  }
  for (std::size_t k = 0; k < 6; ++k) {
    for (const Term& term : terms_[k]) v[k] += term.amplitude * std::sin(term.rate * t_s);
  }
  kinematics::PlatformPose pose = ToPose(v);
  if (!kinematics::SprkPlatform::Reachable(pose)) {
    const double share = kinematics::SprkPlatform::ReachableShare(pose);
    pose.translation_m *= share;
    pose.angles_rad *= share;
  }
  return pose;
}

}  // namespace dfr::sim
