// A simulated PSM on the topics of a da Vinci Research Kit console, in real time.
#include <CLI/CLI.hpp>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <string>
#include <thread>

#include "dfr/core/build_info.h"
#include "dfr/sim/dvrk/psm_console_server.h"

namespace {

volatile std::sig_atomic_t stopped = 0;

void Stop(int /*signal*/) { stopped = 1; }

}  // namespace

int main(int argc, char** argv) try {
  dfr::dds::ParticipantOptions network;
  dfr::sim::PsmConsoleOptions arm;
  dfr::sim::PsmConsoleServerOptions server_options;
  dfr::sim::ConsoleFaults faults;
  double duration_s = 0.0;
  double joint_error_deg = 0.0;
  network.name = "dvrk_simulator";

  CLI::App app(
      "Simulates a PSM behind the topics of a da Vinci Research Kit console (CRTK over ROS 2's "
      "DDS), "
      "until Ctrl-C. ROS 2 nodes and dfr's own clients find it under --arm's name.");
  app.set_version_flag("--version",
                       std::string(dfr::core::BuildVersion()) + " " + dfr::core::BuildCommit());
  const std::map<std::string, dfr::dds::Discovery> kDiscovery = {
      {"loopback", dfr::dds::Discovery::kLoopback},
      {"network", dfr::dds::Discovery::kNetwork},
      {"server", dfr::dds::Discovery::kServerClient}};
  app.add_option("--arm", arm.arm, "the arm's name, first part of its topics")
      ->capture_default_str();
  app.add_option("--domain", network.domain, "DDS domain, as ROS_DOMAIN_ID")
      ->capture_default_str()
      ->check(CLI::Range(0, 232));
  app.add_option("--discovery", network.discovery,
                 "who finds it: loopback (this machine), network, or server (--server)")
      ->default_str("loopback")
      ->transform(CLI::CheckedTransformer(kDiscovery).description("loopback, network or server"));
  app.add_option("--server", network.server_address, "IPv4 address of the discovery server")
      ->capture_default_str();
  app.add_option("--homing", arm.homing_s, "seconds that homing takes")->capture_default_str();
  app.add_option("--period", server_options.state_period_s, "seconds between published states")
      ->capture_default_str();
  app.add_option("--duration", duration_s, "stop by itself after so many seconds; 0: never")
      ->capture_default_str();
  app.add_option("--joint-error", joint_error_deg,
                 "degrees by which yaw and pitch really are off their encoders")
      ->capture_default_str();
  app.add_option("--delay", faults.delay_s, "fault: published motion is so many seconds old")
      ->capture_default_str();
  app.add_option("--drop", faults.drop, "fault: share of the state samples that are lost")
      ->capture_default_str();
  app.add_option("--seed", server_options.seed, "of what --drop loses")->capture_default_str();
  app.add_flag("--invalid", faults.invalid, "fault: everything is stamped zero");
  app.add_flag("--corrupt", faults.corrupt, "fault: positions are NaN");
  CLI11_PARSE(app, argc, argv);

  constexpr double kDegree = 0.017453292519943295;
  arm.joint_error.offset.head<2>().setConstant(joint_error_deg * kDegree);
  dfr::sim::PsmConsole console(arm);
  dfr::dds::Participant participant(network);
  dfr::sim::PsmConsoleServer server(participant, console, server_options);
  server.SetFaults(faults);

  std::signal(SIGINT, Stop);
  std::signal(SIGTERM, Stop);
  std::cout << "dvrk_simulator: " << arm.arm << " in domain " << network.domain
            << "; home it with \"home\" on /" << arm.arm << "/state_command" << std::endl;
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::milliseconds kPeriod(1);
  // Simulated time is the clock's; where the machine falls behind, a step is longer, up to what the
  // console takes.
  constexpr double kLongestStep = 0.1;
  const auto start = Clock::now();
  auto last = start;
  while (stopped == 0) {
    const auto now = Clock::now();
    const double since_s = std::chrono::duration<double>(now - last).count();
    last = now;
    server.Tick(since_s < kLongestStep ? since_s : kLongestStep);
    if (duration_s > 0.0 && std::chrono::duration<double>(now - start).count() >= duration_s) break;
    std::this_thread::sleep_until(now + kPeriod);
  }
  std::cout << "dvrk_simulator: stopped" << std::endl;
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::cerr << "dvrk_simulator: " << e.what() << '\n';
  return EXIT_FAILURE;
}
