#include "check/check.h"

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "check/findings.h"
#include "check/permit.h"
#include "dfr/core/error.h"
#include "dfr/core/text/format.h"
#include "dfr/hardware/sprk_driver.h"

namespace dfr::apps::hardware_app {
namespace {

const char* Word(Finding::Level level) {
  switch (level) {
    case Finding::Level::kOk:
      return "ok";
    case Finding::Level::kNote:
      return "note";
    case Finding::Level::kWrong:
      return "wrong";
  }
  return "unknown";
}

nlohmann::json Json(const DeviceReport& report) {
  nlohmann::json findings = nlohmann::json::array();
  for (const Finding& finding : report.findings) {
    findings.push_back(
        {{"level", Word(finding.level)}, {"what", finding.what}, {"remedy", finding.remedy}});
  }
  return {{"device", report.device}, {"ok", report.ok()}, {"findings", findings}};
}

// Moves the platform home, tilts it and moves it home again.
void Tilt(const CheckOptions& options, hardware::SprkDriver& driver, Permit& permit,
          DeviceReport& report) {
  using hardware::SprkDriver;
  using hardware::SprkStatus;
  const auto is_stopped = [&] {
    return Within(*options.clock, SprkDriver::kHomeTime, [&] { return !permit.MayMove(); });
  };
  SprkStatus status = driver.Home();
  bool stopped = status == SprkStatus::kOk && is_stopped();
  kinematics::PlatformPose tilted;
  tilted.angles_rad.x() = 3.0 * 0.017453292519943295;
  for (const kinematics::PlatformPose& pose : {tilted, kinematics::PlatformPose{}}) {
    if (status != SprkStatus::kOk || stopped) break;
    status = driver.MoveTo(pose);
    stopped = status == SprkStatus::kOk && is_stopped();
  }
  if (stopped) {
    permit.Tell(report);
    status = driver.Hold();
    if (status == SprkStatus::kOk) return;
  }
  if (status == SprkStatus::kGoesHome) {
    Wrong(report, "the platform continues to its home position", "cut its power to stop it");
  } else if (status != SprkStatus::kOk) {
    Wrong(report, std::string("the platform cannot be commanded: ") + hardware::Name(status),
          "check its cable and power");
  } else {
    Ok(report,
       "was told to go home, tilt by 3 degrees and return: if it did not, switch its power off and "
       "on and plug it in again");
  }
}

}  // namespace

bool DeviceReport::ok() const noexcept {
  return std::none_of(findings.begin(), findings.end(),
                      [](const Finding& f) { return f.level == Finding::Level::kWrong; });
}

DeviceReport CheckPlatform(const CheckOptions& options) {
  std::optional<dds::Participant> participant;
  std::optional<dds::EmergencyStopReceiver> receiver;
  return CheckPlatform(options, [&](std::int64_t steady_ns) {
    if (!participant) participant.emplace(options.network);
    if (!receiver) {
      receiver.emplace(*participant, kStopSilence, dds::kEmergencyStopTopic,
                       options.stop_datagrams);
    }
    const dds::EmergencyStop found = receiver->Check(steady_ns);
    return StopLook(found, receiver->only_datagrams_silent());
  });
}

DeviceReport CheckPlatform(const CheckOptions& options, const StopState& stop) {
  DeviceReport report;
  report.device = "platform at " + options.platform;
  try {
    hardware::SprkDriver driver({.device = options.platform, .clock_s = [&options] {
                                   return 1e-9 * static_cast<double>(options.clock->SteadyNs());
                                 }});
    Ok(report, "the port opens at 57600 8N1, and no other program uses it");
    Note(report,
         "the firmware never answers: only a motion shows whether the platform receives commands",
         "run this check with --move, and watch");
    if (options.move &&
        Ask(options, "the platform will go home and tilt by 3 degrees and back. Is it clear?")) {
      Permit permit(options, stop);
      if (permit.Granted(report)) Tilt(options, driver, permit, report);
    }
  } catch (const core::Error& e) {
    Wrong(report, std::string(e.problem()),
          e.remedy().empty() ? "check that this is the platform's port" : std::string(e.remedy()));
  }
  return report;
}

void Print(const DeviceReport& report, std::ostream& out) {
  out << core::Printable(report.device) << '\n';
  for (const Finding& finding : report.findings) {
    const std::string word = std::string("[") + Word(finding.level) + "]";
    out << "  " << word << std::string(8 - word.size(), ' ') << core::Printable(finding.what)
        << '\n';
    if (!finding.remedy.empty()) out << "          -> " << core::Printable(finding.remedy) << '\n';
  }
}

void PrintJson(const std::vector<DeviceReport>& reports, std::ostream& out) {
  nlohmann::json all;
  all["ok"] = std::all_of(reports.begin(), reports.end(),
                          [](const DeviceReport& report) { return report.ok(); });
  all["devices"] = nlohmann::json::array();
  for (const DeviceReport& report : reports) all["devices"].push_back(Json(report));
  out << all.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << std::endl;
}

int RunCheck(CheckOptions options) {
  if (options.arm.empty() && options.endoscope.empty() && options.platform.empty()) {
    options.arm = "PSM1";
    options.endoscope = "/ECM/image_raw";
  }
  std::vector<DeviceReport> reports;
  const auto add = [&](DeviceReport report) {
    if (!options.json) Print(report, std::cout);
    std::cout.flush();
    reports.push_back(std::move(report));
  };
  if (!options.arm.empty()) add(CheckArm(options));
  const auto well = [&] {
    return std::all_of(reports.begin(), reports.end(),
                       [](const DeviceReport& report) { return report.ok(); });
  };
  if (!options.endoscope.empty() && !Interrupted(options)) add(CheckEndoscope(options));
  if (options.move && !options.platform.empty() && !well()) {
    Say(options, "errors were found: the platform is not moved");
    options.move = false;
  }
  if (!options.platform.empty() && !Interrupted(options)) add(CheckPlatform(options));
  const bool ok = well() && !Interrupted(options);
  if (options.json) {
    PrintJson(reports, std::cout);
  } else {
    std::cout << (ok                     ? "no errors"
                  : Interrupted(options) ? "interrupted"
                                         : "errors were found: see above")
              << std::endl;
  }
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace dfr::apps::hardware_app
