#pragma once

#include <string>

#include "check/check.h"
#include "dfr/core/text/format.h"

/// Findings, and messages to and from the user, shared by the checks of all devices.
namespace dfr::apps::hardware_app {

inline void Ok(DeviceReport& report, const std::string& what) {
  report.findings.push_back({Finding::Level::kOk, what, ""});
}
inline void Note(DeviceReport& report, const std::string& what, const std::string& remedy) {
  report.findings.push_back({Finding::Level::kNote, what, remedy});
}
inline void Wrong(DeviceReport& report, const std::string& what, const std::string& remedy) {
  report.findings.push_back({Finding::Level::kWrong, what, remedy});
}

inline std::string Text(double value, int digits) { return core::Format("%.*f", digits, value); }

inline const char* Name(dds::Discovery discovery) {
  switch (discovery) {
    case dds::Discovery::kLoopback:
      return "loopback";
    case dds::Discovery::kNetwork:
      return "network";
    case dds::Discovery::kServerClient:
    case dds::Discovery::kServer:
      return "server";
  }
  return "unknown";
}

inline void Say(const CheckOptions& options, const std::string& text) {
  if (options.say) options.say(text);
}
inline bool Ask(const CheckOptions& options, const std::string& question) {
  return options.ask && options.ask(question);
}

inline bool Interrupted(const CheckOptions& options) {
  return options.interrupted != nullptr && *options.interrupted;
}

/// Returns a description of the searched network, to be appended to a report's name.
inline std::string InNetwork(const CheckOptions& options) {
  return " (DDS domain " + std::to_string(options.network.domain) +
         ", discovery: " + Name(options.network.discovery) + ")";
}

}  // namespace dfr::apps::hardware_app
