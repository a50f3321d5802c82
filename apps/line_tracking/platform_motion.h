#pragma once

#include <optional>
#include <string>

#include "dfr/hardware/sprk_driver.h"
#include "dfr/robot/devices.h"

namespace dfr::apps::line_tracking {

/// How a run moves the SPRK platform.
struct PlatformOptions {
  std::string device;  ///< Its serial port; empty: nothing here moves the gauze.
  std::optional<hardware::SprkWaveKind> wave;  ///< Absent: it rests.
  hardware::SprkWave motion;
};

/// The platform of a run as a control loop's. Its firmware has no timeout and tells nothing: a
/// program that is killed leaves the wave going, and only its power supply or another command ends
/// it. Commands wait for the end of the last frame at most (hardware::kSprkFramePeriod).
class PlatformMotion final : public robot::Platform {
 public:
  /// Opens the port. Nothing moves.
  /// @throws core::Error as hardware::SprkDriver.
  explicit PlatformMotion(const PlatformOptions& options);
  /// It comes to rest.
  ~PlatformMotion() override;
  PlatformMotion(const PlatformMotion&) = delete;
  PlatformMotion& operator=(const PlatformMotion&) = delete;

  [[nodiscard]] robot::Finding Check() noexcept override;
  [[nodiscard]] robot::Finding Home() noexcept override;
  /// The wave begins, if there is one.
  [[nodiscard]] robot::Finding Begin() noexcept override;
  /// Where it is by the estimate. Where in a wave it is, nobody knows: that ends in the wave's
  /// middle, an amplitude away at most.
  [[nodiscard]] robot::Finding Rest() noexcept override;

 private:
  PlatformOptions options_;
  hardware::SprkDriver driver_;
  bool moves_ = false;
};

}  // namespace dfr::apps::line_tracking
