#pragma once

#include <array>
#include <cstdint>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::sim {

/// How the platform moves.
enum class Wave {
  kNone,  ///< It stays at home.
  kSine,  ///< amplitude sin(2 pi frequency t), as the firmware's 'c'.
  /// The firmware's 'd': (exp(sin(frequency t)) - 1/e) 2 amplitude / (e - 1/e), in [0, 2
  /// amplitude]; the angles less amplitude. Its frequency is in rad/s. Time starts where it is at
  /// home.
  kBreath,
  kRandom,  ///< Per entry a sum of three sines of random frequency and sign, at most `amplitude`.
};

/// "none", "sine", "breath", "random".
[[nodiscard]] const char* Name(Wave wave) noexcept;

/// Options for Disturbance. Entries: x, y, z in m, then roll, pitch, yaw in rad.
struct DisturbanceOptions {
  Wave wave = Wave::kNone;
  std::array<double, 6> amplitude = {0.008, 0.017, 0.001, 0.01, 0.01, 0.1};
  /// Hz, for kBreath rad/s; kRandom draws its own between half and one and a half of it.
  std::array<double, 6> frequency = {0.04, 0.04, 0.04, 0.04, 0.04, 0.04};
  bool during = true;    ///< The platform moves while the arm does, for as long as that takes.
  bool between = false;  ///< It also moves for pause_s after every control, probes included.
  double pause_s = 0.05;
  /// The platform never stops: not during a control, not while the robot looks and computes, and
  /// not at rest. `during` and `between` do not matter then.
  bool real_time = false;
  double latency_s = 0.03;  ///< With real_time: from a look to the control that follows from it.
};

/// A seeded movement of the platform: its commanded pose as a function of time. Starts at home.
class Disturbance {
 public:
  Disturbance() = default;
  /// @throws std::invalid_argument naming the entry, if an amplitude or frequency is negative or
  ///   not finite, or if sine or breath would leave the platform's reach.
  Disturbance(const DisturbanceOptions& options, std::uint64_t seed);

  /// Never allocates. What the platform cannot reach is shortened towards home to its boundary.
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
