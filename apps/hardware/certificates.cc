#include "certificates.h"

#include <iostream>
#include <map>
#include <set>
#include <stdexcept>
#include <utility>

#include "apps/usage_error.h"
#include "dfr/dds/security.h"

namespace dfr::apps::hardware_app {
namespace {

// Returns the permission of one of dfr's programs.
dds::Permission PermissionOf(const std::string& name) {
  static const std::map<std::string, dds::Permission> kKnown = {
      {"line_tracking", dds::Permission::kController},
      {"dvrk_simulator", dds::Permission::kConsole},
      {"stop", dds::Permission::kButton},
      {"monitor", dds::Permission::kMonitor}};
  const auto known = kKnown.find(name);
  if (known == kKnown.end()) {
    throw UsageError("--participants: '" + name + "' has no permission. Write " + name +
                     ":controller, " + name + ":console, " + name + ":button or " + name +
                     ":monitor");
  }
  return known->second;
}

std::pair<std::string, dds::Permission> Parse(const std::string& participant) {
  const std::size_t colon = participant.find(':');
  if (colon == std::string::npos) return {participant, PermissionOf(participant)};
  return {participant.substr(0, colon), dds::ParsePermission(participant.substr(colon + 1))};
}

const char* Meaning(dds::Permission permission) {
  switch (permission) {
    case dds::Permission::kController:
      return "may command the arm";
    case dds::Permission::kConsole:
      return "may publish measurements";
    case dds::Permission::kButton:
      return "may stop the arm";
    case dds::Permission::kMonitor:
      return "may only listen";
  }
  return "";
}

}  // namespace

void RunCertificates(const CertificatesOptions& options) {
  // Rejects misspelled, unknown, repeated and existing participants before writing any file.
  std::vector<std::pair<std::string, dds::Permission>> participants;
  std::set<std::string> names;
  const auto enclaves = options.folder / "enclaves";
  for (const std::string& text : options.participants) {
    participants.push_back(Parse(text));
    const std::string& name = participants.back().first;
    ValueOf("--participants", [&name] { dds::CheckParticipantName(name); });
    if (!names.insert(name).second) {
      throw UsageError("--participants: '" + name + "' is given twice");
    }
    if (std::filesystem::exists(enclaves / name)) {
      throw std::runtime_error("participant '" + name +
                               "' exists already: omit it, or "
                               "remove " +
                               (enclaves / name).string() + " to create it again");
    }
  }
  const bool is_new = !std::filesystem::exists(options.folder / "private");
  if (is_new) dds::MakeAuthority(options.folder, options.certificates);
  for (const auto& [name, permission] : participants) {
    dds::AddParticipant(options.folder, name, permission, options.certificates);
    dds::CheckSecurity(enclaves / name);
  }

  std::cout << (is_new ? "Created an authority and " : "Added ") << participants.size()
            << (participants.size() == 1 ? " participant" : " participants") << ", valid for "
            << options.certificates.days << " days:\n\n";
  for (const auto& [name, permission] : participants) {
    std::cout << "  " << (enclaves / name).string() << "  " << dds::Name(permission) << ": "
              << Meaning(permission) << '\n';
  }
  std::cout
      << "\nCopy each participant's folder, and nothing else, to its machine. There, only the "
         "program's user\nmay read key.pem. Name the folder with --security FOLDER or in the "
         "configuration file.\nA ROS 2 console takes one of these folders as its enclave.\n"
         "\nKeep "
      << (options.folder / "private").string()
      << " away from the robot's network: whoever has it can admit any program.\nIt is needed to "
         "add "
         "participants, and to renew these before they expire.\n";
}

}  // namespace dfr::apps::hardware_app
