#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "apps/command_line.h"
#include "dfr/dds/participant.h"

namespace dfr::apps {

/// Adds the options of a DDS participant to a program or command; --help lists them in `group`.
inline void AddNetwork(CLI::App& command, dds::ParticipantOptions& network,
                       const std::string& group = "Options") {
  using dds::Discovery;
  command.add_option("--domain", network.domain, "DDS domain, as ROS_DOMAIN_ID")
      ->capture_default_str()
      ->check(CLI::Range(0, 232))
      ->group(group);
  command
      .add_option("--discovery", network.discovery,
                  "DDS discovery: loopback (this machine), network, or server (--server)")
      ->default_str("loopback")
      ->type_name("TEXT")
      ->transform(OneOf<Discovery>({{"loopback", Discovery::kLoopback},
                                    {"network", Discovery::kNetwork},
                                    {"server", Discovery::kServerClient}}))
      ->group(group);
  command.add_option("--server", network.server_address, "IPv4 address of the discovery server")
      ->check(CLI::ValidIPV4)
      ->capture_default_str()
      ->group(group);
  command
      .add_option(
          "--security", network.security,
          "this program's folder in a secured network, made by `hardware "
          "certificates`;\nparticipants without such a folder then neither hear nor command this "
          "program")
      ->group(group);
}

/// Checks the options of AddNetwork().
/// @throws CLI::ValidationError if a discovery server is named without --discovery server.
inline void CheckNetwork(const CLI::App& command, const dds::ParticipantOptions& network) {
  if (network.discovery == dds::Discovery::kServerClient) return;
  for (const char* name : {"--server", "--server-port"}) {
    const CLI::Option* const option = command.get_option_no_throw(name);
    if (option != nullptr && option->count() > 0) {
      throw CLI::ValidationError(std::string(name) + " is only used with --discovery server");
    }
  }
}

}  // namespace dfr::apps
