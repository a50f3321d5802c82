#pragma once

#include <functional>
#include <span>
#include <string>

#include "dfr/hardware/sprk_lag.h"
#include "dfr/hardware/sprk_protocol.h"
#include "dfr/kinematics/sprk_platform.h"

namespace dfr::hardware {

/// Options for SprkDriver.
struct SprkOptions {
  std::string device = "/dev/ttyACM0";
  /// Seconds on a clock that never goes back; empty: std::chrono::steady_clock. Must not throw.
  std::function<double()> clock_s;
  /// Returns so many seconds later by that clock; empty: this thread sleeps. Must not throw.
  std::function<void(double)> wait_s = {};
};

/// What is known of the platform's pose at a moment.
struct SprkEstimate {
  kinematics::PlatformPose pose;  ///< During a wave: the middle of what it sweeps.
  /// By how much each entry may be off that, as commanded; zero unless a wave is under way. The lag
  /// makes it smaller in truth.
  kinematics::PlatformPose sweep;
  bool known = false;  ///< False until homed, and once the device has failed.
};

/// The SPRK Stewart platform at a serial port (57600 8N1, no flow control).
///
/// The firmware neither answers nor measures, does not wait for the rest of a frame and has no
/// timeout: it holds the last command for ever. So a frame goes out in one write, everything is
/// checked before, and the state is the commanded one through the published lag.
///
/// Opening moves nothing; Home() comes first. Commands never block for longer than a write into the
/// kernel's buffer (Hold() and Home() up to kSprkFramePeriod more), and never allocate or throw.
/// The driver claims the port: a second one cannot open it. One object belongs to one thread at a
/// time.
class SprkDriver {
 public:
  static constexpr double kHomeTime = 1.5;  ///< s until it is at home: seven time constants.

  /// @throws core::Error naming the device, what failed and the remedy.
  explicit SprkDriver(const SprkOptions& options);
  /// Closes the port and leaves the platform as it is: call Hold() or Home() before.
  ~SprkDriver();
  SprkDriver(const SprkDriver&) = delete;
  SprkDriver& operator=(const SprkDriver&) = delete;

  /// Sends the platform home. The estimate then counts from home at once if nothing was known
  /// before, so wait a second after the first Home() before relying on it.
  [[nodiscard]] SprkStatus Home() noexcept;
  /// Commands the pose nearest to `pose` that the protocol can say: see EncodeSprkPosition().
  [[nodiscard]] SprkStatus MoveTo(const kinematics::PlatformPose& pose) noexcept;
  /// Starts a wave: see EncodeSprkWave().
  [[nodiscard]] SprkStatus Start(SprkWaveKind kind, const SprkWave& wave) noexcept;
  /// Stops where the platform is now by the estimate, to the protocol's steps; a wave stops in its
  /// middle. A pose that the steps put out of reach is drawn towards home.
  [[nodiscard]] SprkStatus Hold() noexcept;

  /// Whether the port is still there, without a word to the platform: kOk or kDeviceFailed, which
  /// is final. Never waits.
  [[nodiscard]] SprkStatus Check() noexcept;

  [[nodiscard]] SprkEstimate Estimate() const noexcept;
  /// The last command, as sent.
  [[nodiscard]] const kinematics::PlatformPose& commanded() const noexcept {
    return lag_.commanded();
  }
  /// errno of the write that failed, EIO of a port that is gone; 0: neither.
  [[nodiscard]] int error() const noexcept { return error_; }

 private:
  [[nodiscard]] SprkStatus Ready() const noexcept;
  [[nodiscard]] SprkStatus Send(std::span<const char> frame) noexcept;
  void AwaitFrame() const noexcept;

  std::function<double()> clock_s_;
  std::function<void(double)> wait_s_;
  int fd_ = -1;
  int error_ = 0;
  bool homed_ = false;
  bool sent_ = false;
  double sent_s_ = 0.0;
  SprkLag lag_;
  kinematics::PlatformPose sweep_;
};

}  // namespace dfr::hardware
