#pragma once

#include <array>
#include <cstdint>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::sim {

/// Waveform of the platform's motion.
enum class Wave {
  kNone,  ///< No motion.
  kSine,  ///< amplitude sin(2 pi frequency t), the firmware's command 'c'.
  /// The firmware's command 'd': (exp(sin(frequency t)) - 1/e) 2 amplitude / (e - 1/e), in [0, 2
  /// amplitude]. For angles, the amplitude is subtracted. The frequency is in rad/s. The motion
  /// starts at the home pose.
  kBreath,
  kRandom,  ///< Per entry, a sum of three sines of random frequency and sign, at most `amplitude`.
};

/// Returns "none", "sine", "breath" or "random".
[[nodiscard]] const char* Name(Wave wave) noexcept;

/// Options for Disturbance. Entries: x, y, z in m, then roll, pitch, yaw in rad.
struct DisturbanceOptions {
  Wave wave = Wave::kNone;
  std::array<double, 6> amplitude = {0.008, 0.017, 0.001, 0.01, 0.01, 0.1};
  /// Hz; rad/s for kBreath. kRandom samples frequencies between 0.5 and 1.5 times these values.
  std::array<double, 6> frequency = {0.04, 0.04, 0.04, 0.04, 0.04, 0.04};
  bool during = true;  ///< The platform moves while the arm moves.
  /// The platform also moves for pause_s after every control, including probes.
  bool between = false;
  double pause_s = 0.05;
  /// The platform never stops, not even during observation and computation, or at rest. Overrides
  /// `during` and `between`.
  bool real_time = false;
  double latency_s = 0.03;  ///< With real_time: delay from an observation to its control.
};

/// A seeded motion of the platform: its commanded pose as a function of time. Starts at home.
class Disturbance {
 public:
  Disturbance() = default;
  /// @throws std::invalid_argument if an amplitude, a frequency or the latency is negative or not
  ///   finite, or if sine or breath would leave the platform's reach.
  Disturbance(const DisturbanceOptions& options, std::uint64_t seed);

  /// Returns the pose. Poses out of reach are scaled towards home, to the boundary of the
  /// platform's reach. Never allocates.
  [[nodiscard]] kinematics::PlatformPose At(double t_s) const noexcept;

 private:
  struct Term {
    double amplitude = 0.0;
    double rate = 0.0;  // rad/s
  };
  Wave wave_ = Wave::kNone;
  std::array<double, 6> amplitude_{};
  std::array<double, 6> frequency_{};
  std::array<std::array<Term, 3>, 6> terms_{};
};

}  // namespace dfr::sim
