#pragma once

#include <atomic>
#include <filesystem>
#include <functional>
#include <iosfwd>
#include <string>
#include <vector>

#include "checked_arm.h"
#include "clock.h"
#include "dfr/dds/participant.h"
#include "dfr/hardware/endoscope.h"
#include "dfr/kinematics/psm.h"

namespace dfr::apps::hardware_app {

/// One thing that was looked at.
struct Finding {
  enum class Level { kOk, kNote, kWrong };
  Level level = Level::kOk;
  std::string what;
  std::string remedy;  ///< Where level is not kOk.
};

/// All that was found out about one device.
struct DeviceReport {
  std::string device;
  std::vector<Finding> findings;

  [[nodiscard]] bool ok() const noexcept;
};

/// Options for the checks.
struct CheckOptions {
  dds::ParticipantOptions network = {.name = "hardware_check"};
  std::string arm;  ///< Empty: no arm is checked.
  /// Whose joint limits the arm keeps to, and which instrument it has.
  kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic;
  std::string endoscope;         ///< Empty: none is checked.
  std::filesystem::path camera;  ///< The endoscope's intrinsics file; empty: 640 x 480.
  std::string platform;          ///< Serial port; empty: none is checked.
  double find_s = 3.0;           ///< How long to look for a device on the network, > 0.
  double listen_s = 3.0;         ///< How long to listen to it then, > 0.
  bool home = false;             ///< Asks whether to home the arm.
  bool move = false;             ///< Asks whether to move a device by a little.
  /// The arm moves without an emergency stop: otherwise it has to be heard of and released, and
  /// ends what goes on.
  bool without_stop = false;
  const std::atomic<bool>* interrupted = nullptr;  ///< Ends it, too. nullptr: nothing does.
  bool json = false;
  Clock* clock = &MachineClock();  ///< Borrowed.
  /// Asks the user; no moves where it is false.
  std::function<bool(const std::string& question)> ask;
  /// Tells the user what goes on; may be empty.
  std::function<void(const std::string& text)> say;
};

/// Listens to the console of options.arm, names what is wrong, and moves the arm if asked to.
[[nodiscard]] DeviceReport CheckArm(const CheckOptions& options);
/// The same with any arm, without the reasons why nobody is on the network.
[[nodiscard]] DeviceReport CheckArm(const CheckOptions& options, CheckedArm& arm);
/// Looks at the pictures of options.endoscope: a ROS 2 topic where hardware::IsImageTopic() says
/// so, else what hardware::OpenVideo() takes.
[[nodiscard]] DeviceReport CheckEndoscope(const CheckOptions& options);
/// Looks at any endoscope's pictures, which ought to have the size that `camera` has, and adds what
/// it finds.
void LookAt(const CheckOptions& options, const hardware::EndoscopeOptions& camera,
            hardware::Endoscope& endoscope, DeviceReport& report);
/// Opens the Stewart platform's port.
[[nodiscard]] DeviceReport CheckPlatform(const CheckOptions& options);

/// A report as the user reads it, or all of them as JSON:
///   {"ok": true, "devices": [{"device": "...", "ok": true,
///    "findings": [{"level": "ok", "what": "...", "remedy": ""}]}]}
void Print(const DeviceReport& report, std::ostream& out);
void PrintJson(const std::vector<DeviceReport>& reports, std::ostream& out);

/// All checks that are asked for, in turn; without any, those of PSM1 and /ECM/image_raw. Prints to
/// standard output. Returns the program's exit code: 1 if anything is wrong.
int RunCheck(CheckOptions options);

}  // namespace dfr::apps::hardware_app
