#pragma once

#include <optional>
#include <string>

#include "dfr/hardware/sprk_driver.h"
#include "dfr/robot/devices.h"

namespace dfr::hardware {

/// Motion of the SPRK platform in a run.
struct PlatformOptions {
  std::string device;                ///< Serial port; empty: no platform.
  std::optional<SprkWaveKind> wave;  ///< Waveform of the motion; absent: the platform rests.
  SprkWave motion;
};

/// Platform of a control loop. Its firmware has no timeout and reports nothing: after a program is
/// killed the wave continues until the power is cut or another command arrives. Commands wait at
/// most for the end of the last frame (kSprkFramePeriod).
class PlatformMotion final : public robot::Platform {
 public:
  /// Opens the port, without motion.
  /// @throws core::Error as SprkDriver.
  explicit PlatformMotion(const PlatformOptions& options);
  /// Stops the platform.
  ~PlatformMotion() override;
  PlatformMotion(const PlatformMotion&) = delete;
  PlatformMotion& operator=(const PlatformMotion&) = delete;

  [[nodiscard]] robot::Finding Check() noexcept override;
  [[nodiscard]] robot::Finding Home() noexcept override;
  /// Begins the wave, if there is one.
  [[nodiscard]] robot::Finding Begin() noexcept override;
  /// Holds the estimated pose. The phase of a wave is unknown: a stop moves the platform to the
  /// wave's middle, at most an amplitude away.
  [[nodiscard]] robot::Finding Rest() noexcept override;

 private:
  PlatformOptions options_;
  SprkDriver driver_;
  bool moves_ = false;
};

}  // namespace dfr::hardware
