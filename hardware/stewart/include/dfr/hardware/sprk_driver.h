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
  /// Monotonic clock, s; empty: std::chrono::steady_clock. Must not throw.
  std::function<double()> clock_s;
  /// Waits the given number of seconds of clock_s; empty: sleeps. Must not throw.
  std::function<void(double)> wait_s = {};
};

/// The SPRK Stewart platform on a serial port (57600 8N1, no flow control).
///
/// The firmware neither acknowledges nor measures, does not wait for the rest of a frame, and has
/// no timeout: it holds the last command indefinitely. The driver therefore checks every command
/// first, sends each frame in one write, and estimates the state from the commands and the
/// published lag.
///
/// Opening moves nothing; call Home() first. Commands block at most for one write into the kernel's
/// buffer (Hold() and Home() up to kSprkFramePeriod longer), and never allocate or throw. The
/// driver locks the port: a second driver cannot open it. One object belongs to one thread at a
/// time.
class SprkDriver {
 public:
  static constexpr double kHomeTime = 1.5;  ///< Duration of homing, s: seven time constants.

  /// @throws core::Error naming the device, the failure and the remedy.
  explicit SprkDriver(const SprkOptions& options);
  /// Closes the port without moving the platform; call Hold() or Home() first.
  ~SprkDriver();
  SprkDriver(const SprkDriver&) = delete;
  SprkDriver& operator=(const SprkDriver&) = delete;

  /// Sends the platform home. It arrives kHomeTime after the first Home().
  [[nodiscard]] SprkStatus Home() noexcept;
  /// Commands the representable pose nearest to `pose`; see EncodeSprkPosition().
  [[nodiscard]] SprkStatus MoveTo(const kinematics::PlatformPose& pose) noexcept;
  /// Starts a wave: see EncodeSprkWave().
  [[nodiscard]] SprkStatus Start(SprkWaveKind kind, const SprkWave& wave) noexcept;
  /// Stops the platform at its present estimated pose, rounded to the protocol's steps. A wave
  /// stops at its centre. A pose made unreachable by rounding is scaled towards home. Returns
  /// kGoesHome within kHomeTime of the first Home(): the platform continues to its home position,
  /// because the pose on the way is unknown.
  [[nodiscard]] SprkStatus Hold() noexcept;

  /// Checks the port without sending anything: returns kOk, or kDeviceFailed, which is permanent.
  /// Never waits.
  [[nodiscard]] SprkStatus Check() noexcept;

 private:
  [[nodiscard]] SprkStatus Ready() const noexcept;
  [[nodiscard]] SprkStatus Send(std::span<const char> frame) noexcept;
  void AwaitFrame() const noexcept;

  std::function<double()> clock_s_;
  std::function<void(double)> wait_s_;
  int fd_ = -1;
  bool failed_ = false;
  bool homed_ = false;
  bool goes_home_ = false;  // true if the last motion command was the first Home()
  bool sent_ = false;
  double sent_s_ = 0.0;
  double home_s_ = 0.0;  // time of the first Home()
  SprkLag lag_;
};

}  // namespace dfr::hardware
