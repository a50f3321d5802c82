#include "check/check.h"

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <nlohmann/json.hpp>
#include <utility>

#include "check/findings.h"
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

}  // namespace

bool DeviceReport::ok() const noexcept {
  return std::none_of(findings.begin(), findings.end(),
                      [](const Finding& f) { return f.level == Finding::Level::kWrong; });
}

DeviceReport CheckPlatform(const CheckOptions& options) {
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
      hardware::SprkStatus status = driver.Home();
      kinematics::PlatformPose tilted;
      tilted.angles_rad.x() = 3.0 * 0.017453292519943295;
      for (const kinematics::PlatformPose& pose : {tilted, kinematics::PlatformPose{}}) {
        options.clock->Wait(1.0);
        if (status == hardware::SprkStatus::kOk) status = driver.MoveTo(pose);
      }
      if (status != hardware::SprkStatus::kOk) {
        Wrong(report, std::string("the platform cannot be commanded: ") + hardware::Name(status),
              "check its cable and power");
      } else {
        Ok(report,
           "was told to go home, tilt by 3 degrees and return: if it did not, switch its power off "
           "and on and plug it in again");
      }
    }
  } catch (const core::Error& e) {
    Wrong(report, std::string(e.problem()),
          e.remedy().empty() ? "is this the platform's port?" : std::string(e.remedy()));
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
  if (!options.endoscope.empty()) add(CheckEndoscope(options));
  if (!options.platform.empty()) add(CheckPlatform(options));
  const bool ok = std::all_of(reports.begin(), reports.end(),
                              [](const DeviceReport& report) { return report.ok(); });
  if (options.json) {
    PrintJson(reports, std::cout);
  } else {
    std::cout << (ok ? "no errors" : "errors were found: see above") << std::endl;
  }
  return ok ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace dfr::apps::hardware_app
