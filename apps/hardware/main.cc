// Connects a robot: what has to be made and checked before line_tracking runs on one.
#include <CLI/CLI.hpp>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <string>

#include "certificates.h"
#include "dfr/core/build_info.h"
#include "emergency_stop.h"

namespace dfr::apps {
namespace {

void AddNetwork(CLI::App& command, dds::ParticipantOptions& network) {
  const std::map<std::string, dds::Discovery> words = {{"loopback", dds::Discovery::kLoopback},
                                                       {"network", dds::Discovery::kNetwork},
                                                       {"server", dds::Discovery::kServerClient}};
  command.add_option("--domain", network.domain, "DDS domain, as ROS_DOMAIN_ID")
      ->capture_default_str()
      ->check(CLI::Range(0, 232));
  command
      .add_option("--discovery", network.discovery,
                  "who finds it: loopback (this machine), network, or server (--server)")
      ->default_str("loopback")
      ->transform(CLI::CheckedTransformer(words).description("loopback, network or server"));
  command.add_option("--server", network.server_address, "IPv4 address of the discovery server")
      ->capture_default_str();
  command.add_option("--security", network.security,
                     "this participant's folder in a secured network (`hardware certificates`)");
}

int Main(int argc, char** argv) {
  CLI::App app("What a robot's network and devices need before a program drives them.", "hardware");
  app.set_version_flag("--version",
                       std::string(core::BuildVersion()) + " (" + core::BuildCommit() + ")");
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);
  int result = EXIT_SUCCESS;

  EmergencyStopOptions stop;
  CLI::App* command = app.add_subcommand(
      "stop", "an emergency stop at the keyboard, whose silence stops, too; never the only one");
  AddNetwork(*command, stop.network);
  command->add_flag("--unattended", stop.unattended,
                    "nobody sits here: only says that nothing is pressed, for simulations");
  command->callback([&] { RunEmergencyStop(stop); });

  CertificatesOptions certificates;
  command = app.add_subcommand(
      "certificates",
      "make a secured network's authority, and what each participant needs to be admitted.\n"
      "Once more with other --participants, adds them");
  command->add_option("FOLDER", certificates.folder, "where they are put; keep it safe")
      ->required();
  command
      ->add_option("-p,--participants", certificates.participants,
                   "NAME or NAME:PERMISSION each, separated by commas. Permissions: controller "
                   "(may command arms), console (may say what arms measure), button (may stop), "
                   "monitor (may listen); all may listen")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--days", certificates.certificates.days, "until they expire")
      ->check(CLI::Range(1, 36500))
      ->capture_default_str();
  command->callback([&] { RunCertificates(certificates); });

  CLI11_PARSE(app, argc, argv);
  return result;
}

}  // namespace
}  // namespace dfr::apps

int main(int argc, char** argv) try {
  return dfr::apps::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "hardware: " << e.what() << '\n';
  return EXIT_FAILURE;
}
