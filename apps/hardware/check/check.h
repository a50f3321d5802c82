#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <iosfwd>
#include <string>
#include <vector>

#include "check/checked_arm.h"
#include "clock.h"
#include "dfr/dds/participant.h"
#include "dfr/hardware/endoscope.h"
#include "dfr/kinematics/psm.h"

namespace dfr::apps::hardware_app {

/// Result of one check.
struct Finding {
  enum class Level { kOk, kNote, kWrong };
  Level level = Level::kOk;
  std::string what;
  std::string remedy;  ///< May be empty.
};

/// All findings about one device.
struct DeviceReport {
  std::string device;
  std::vector<Finding> findings;

  [[nodiscard]] bool ok() const noexcept;
};

/// Options for the checks.
struct CheckOptions {
  dds::ParticipantOptions network = {.name = "hardware_check"};
  std::string arm;  ///< Empty: no arm is checked.
  /// Generation of the arm, which determines its joint limits and instrument.
  kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic;
  std::string endoscope;         ///< Image topic or video source; empty: none is checked.
  std::filesystem::path camera;  ///< The endoscope's intrinsics file; empty: 640 x 480.
  std::string platform;          ///< Serial port; empty: none is checked.
  double find_s = 3.0;           ///< Time to look for a device on the network, > 0.
  double listen_s = 3.0;         ///< Time to listen to a device, > 0.
  bool home = false;             ///< Asks whether to home the arm.
  bool move = false;             ///< Asks whether to move a device by a small distance.
  /// Allows devices to move without an emergency stop. Otherwise the stop must be connected and
  /// released, and pressing it ends the motion.
  bool without_stop = false;
  bool stop_datagrams = true;  ///< Requires the emergency stop's datagrams as well.
  const std::atomic<bool>* interrupted = nullptr;  ///< Ends the check when true; may be nullptr.
  bool json = false;
  Clock* clock = &MachineClock();  ///< Borrowed.
  /// Asks the user. The device does not move if it returns false.
  std::function<bool(const std::string& question)> ask;
  /// Prints progress for the user; may be empty.
  std::function<void(const std::string& text)> say;
};

/// Checks the console of options.arm, and moves the arm on request.
[[nodiscard]] DeviceReport CheckArm(const CheckOptions& options);
/// Overload for a given arm. Does not search for the reason if no console was found.
[[nodiscard]] DeviceReport CheckArm(const CheckOptions& options, CheckedArm& arm);
/// Checks the pictures of options.endoscope: a ROS 2 topic if hardware::IsImageTopic() is true,
/// else a source for hardware::OpenVideo().
[[nodiscard]] DeviceReport CheckEndoscope(const CheckOptions& options);
/// Checks the pictures of a given endoscope, and their size against `camera`. Adds the findings.
void LookAt(const CheckOptions& options, const hardware::EndoscopeOptions& camera,
            hardware::Endoscope& endoscope, DeviceReport& report);
/// Returns the state of the emergency stop at a time of the monotonic clock, ns.
using StopState = std::function<StopLook(std::int64_t steady_ns)>;

/// Checks the port of the Stewart platform, and moves the platform on request.
[[nodiscard]] DeviceReport CheckPlatform(const CheckOptions& options);
/// Overload for a given emergency stop.
[[nodiscard]] DeviceReport CheckPlatform(const CheckOptions& options, const StopState& stop);

/// Print one report as text, or all reports as JSON:
///   {"ok": true, "devices": [{"device": "...", "ok": true,
///    "findings": [{"level": "ok", "what": "...", "remedy": ""}]}]}
void Print(const DeviceReport& report, std::ostream& out);
void PrintJson(const std::vector<DeviceReport>& reports, std::ostream& out);

/// Runs all requested checks one after the other: by default, the checks of PSM1 and
/// /ECM/image_raw. Prints to standard output. Does not move the platform after an error, and ends
/// all checks after an interrupt. Returns the program's exit code: 1 after an error or interrupt.
int RunCheck(CheckOptions options);

}  // namespace dfr::apps::hardware_app
