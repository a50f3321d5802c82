// Connects a robot: what has to be made and checked before line_tracking runs on one.

#include <termios.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <string>

#include "apps/command_line.h"
#include "certificates.h"
#include "check.h"
#include "dfr/core/build_info.h"
#include "emergency_stop.h"
#include "home.h"

namespace dfr::apps::hardware_app {
namespace {

std::atomic<bool> interrupted = false;
static_assert(std::atomic<bool>::is_always_lock_free);

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

// Nobody moves a device by mistake: without a terminal there is no answer.
std::string AnswerAtTerminal(const std::string& question, const char* hint, const char* otherwise) {
  std::string answer;
  if (::isatty(STDIN_FILENO) == 0) {
    std::cerr << question << " Nobody is at the terminal to answer" << otherwise << ": no.\n";
    return answer;
  }
  std::cerr << question << hint << std::flush;
  ::tcflush(STDIN_FILENO, TCIFLUSH);  // what was typed before is no answer
  std::getline(std::cin, answer);
  return answer;
}

void ListenForInterrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = true; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);  // a second one ends it at once
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

void Say(const std::string& text) { std::cerr << text << '\n'; }

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

  CheckOptions check;
  bool yes = false;
  command = app.add_subcommand(
      "check",
      "look at each device, name what is wrong and what to do about it. Without devices: PSM1 and\n"
      "/ECM/image_raw. Moves nothing unless asked to, and asks before. Exit code 1 if anything is "
      "wrong");
  AddNetwork(*command, check.network);
  command->add_option("--arm", check.arm, "the arm's name at the console, PSM1 say");
  command
      ->add_option(
          "--generation", check.generation,
          "which da Vinci the arm is of: Classic, or Si, whose joints go farther and whose "
          "Large Needle Driver is 420006")
      ->default_str("Classic")
      ->transform(CLI::CheckedTransformer(std::map<std::string, kinematics::PsmGeneration>{
                                              {"Classic", kinematics::PsmGeneration::kClassic},
                                              {"Si", kinematics::PsmGeneration::kSi}})
                      .description("Classic or Si"));
  command->add_option(
      "--endoscope", check.endoscope,
      "an image topic (/ECM/image_raw), a video device (0, /dev/video0), a file, or "
      "a GStreamer pipeline");
  command
      ->add_option("--camera", check.camera,
                   "the endoscope's intrinsics, as OpenCV or ROS write them")
      ->check(CLI::ExistingFile);
  command->add_option("--platform", check.platform,
                      "the Stewart platform's serial port, /dev/ttyACM0 say");
  command->add_option("--wait", check.find_s, "seconds to look for a device on the network")
      ->capture_default_str()
      ->check(CLI::Range(0.1, 600.0));
  command->add_option("--seconds", check.listen_s, "seconds to listen to it then")
      ->capture_default_str()
      ->check(CLI::Range(0.1, 600.0));
  command->add_flag("--home", check.home, "home the arm if it is not");
  command->add_flag("--move", check.move, "move the arm by 2 mm, tilt the platform by 3 degrees");
  command->add_flag("--without-stop", check.without_stop,
                    "--home and --move without an emergency stop: in a simulation");
  command->add_flag("--yes", yes, "answers all questions: nobody is near the arm");
  command->add_flag("--json", check.json, "the report for programs");
  command->callback([&] {
    check.interrupted = &interrupted;
    ListenForInterrupts();
    check.ask = [&](const std::string& question) {
      if (yes) return true;
      const std::string answer = AnswerAtTerminal(question, " [y/N] ", " (--yes answers)");
      return answer == "y" || answer == "yes";
    };
    check.say = Say;
    result = RunCheck(check);
  });

  HomeOptions home;
  command = app.add_subcommand("home",
                               "send the Stewart platform home, on a word that is typed: a program "
                               "that was killed leaves it "
                               "moving.\nExit code 1 if it was not asked for");
  command->add_option("--platform", home.platform, "its serial port, /dev/ttyACM0 say")->required();
  command->callback([&] {
    home.interrupted = &interrupted;
    ListenForInterrupts();
    home.confirms = [](const std::string& question, const std::string& word) {
      return AnswerAtTerminal(question, " ", "") == word;
    };
    home.say = Say;
    result = RunHome(home);
  });

  dfr::apps::CheckNumbers(app);
  CLI11_PARSE(app, argc, argv);
  return result;
}

}  // namespace
}  // namespace dfr::apps::hardware_app

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  return dfr::apps::hardware_app::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "hardware: " << e.what() << '\n';
  return EXIT_FAILURE;
}
