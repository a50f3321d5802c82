// Program hardware: prepares and checks a robot before line_tracking runs on it.

#include <termios.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <string>

#include "apps/command_line.h"
#include "apps/network_options.h"
#include "certificates.h"
#include "check/check.h"
#include "dfr/core/text/format.h"
#include "emergency_stop.h"
#include "home.h"

namespace dfr::apps::hardware_app {
namespace {

std::atomic<bool> interrupted = false;
static_assert(std::atomic<bool>::is_always_lock_free);

// Without a terminal the answer is no: no device may move by mistake.
std::string AnswerAtTerminal(const std::string& question, const char* hint, const char* otherwise) {
  std::string answer;
  if (::isatty(STDIN_FILENO) == 0) {
    std::cerr << core::Printable(question) << " There is no terminal, so the answer is no"
              << otherwise << ".\n";
    return answer;
  }
  std::cerr << core::Printable(question) << hint << std::flush;
  ::tcflush(STDIN_FILENO, TCIFLUSH);  // discards earlier input, which is not an answer
  std::getline(std::cin, answer);
  return answer;
}

void ListenForInterrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = true; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);  // a second signal ends the program at once
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGHUP, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);  // messages must not end the program before a hold
}

void Say(const std::string& text) { std::cerr << core::Printable(text) << '\n'; }

int Main(int argc, char** argv) {
  CLI::App app("Prepares and checks the network and devices of a robot.", "hardware");
  apps::AddVersion(app);
  app.require_subcommand(1);
  int result = EXIT_SUCCESS;

  EmergencyStopOptions stop;
  CLI::App* command =
      app.add_subcommand("stop",
                         "Run an emergency stop at the keyboard; the robot also stops "
                         "if this program ends. Never use it as the only stop");
  AddNetwork(*command, stop.network);
  command->add_flag("--unattended", stop.unattended,
                    "run without an operator, for simulations: the button is never pressed");
  command->callback([&, command] {
    CheckNetwork(*command, stop.network);
    RunEmergencyStop(stop);
  });

  CertificatesOptions certificates;
  command = app.add_subcommand("certificates",
                               "Create the authority of a secured network, and the files that each "
                               "participant needs.\nA further run adds other --participants");
  core::WritesFolder(command->add_option("FOLDER", certificates.folder,
                                         "folder for the keys and certificates; keep it safe"))
      ->required();
  command
      ->add_option(
          "-p,--participants", certificates.participants,
          "NAME or NAME:PERMISSION, separated by commas. Permissions: controller "
          "(may command arms), console (may publish what arms measure), button (may stop), "
          "monitor (may listen); all may listen")
      ->delimiter(',')
      ->capture_default_str();
  command
      ->add_option("--days", certificates.certificates.days, "days until the certificates expire")
      ->check(CLI::Range(1, 36500))
      ->capture_default_str();
  command->callback([&] { RunCertificates(certificates); });

  CheckOptions check;
  bool yes = false;
  bool no_datagrams = false;
  command = app.add_subcommand("check",
                               "Check each device, and print each error with its remedy. Default "
                               "devices: PSM1 and\n/ECM/image_raw. Moves a device only with --home "
                               "or --move, and asks first. Exit code 1 if anything is "
                               "wrong");
  AddNetwork(*command, check.network);
  command->add_option("--arm", check.arm, "name of the arm at the console, for example PSM1");
  command
      ->add_option("--generation", check.generation,
                   "generation of the da Vinci: Classic, or Si, which has larger joint ranges and "
                   "whose Large Needle Driver is 420006")
      ->default_str("Classic")
      ->type_name("TEXT")
      ->transform(
          OneOf<kinematics::PsmGeneration>({{"Classic", kinematics::PsmGeneration::kClassic},
                                            {"Si", kinematics::PsmGeneration::kSi}}));
  command->add_option("--endoscope", check.endoscope,
                      "source of pictures: an image topic (/ECM/image_raw), a video device (0, "
                      "/dev/video0), a file, or "
                      "a GStreamer pipeline");
  command
      ->add_option("--camera", check.camera,
                   "file of the endoscope's intrinsics, as written by OpenCV or ROS")
      ->check(CLI::ExistingFile);
  command->add_option("--platform", check.platform,
                      "serial port of the Stewart platform, for example /dev/ttyACM0");
  command->add_option("--wait", check.find_s, "time to look for a device on the network [s]")
      ->capture_default_str()
      ->check(CLI::Range(0.1, 600.0));
  command->add_option("--seconds", check.listen_s, "time to listen to a device [s]")
      ->capture_default_str()
      ->check(CLI::Range(0.1, 600.0));
  command->add_flag("--home", check.home, "home the arm if it is not homed");
  command->add_flag("--move", check.move, "move the arm by 2 mm, tilt the platform by 3 degrees");
  command->add_flag("--without-stop", check.without_stop,
                    "allow --home and --move without an emergency stop, in a simulation");
  command->add_flag("--no-datagrams", no_datagrams,
                    "do not require the emergency stop's UDP datagrams, where broadcasts cannot "
                    "pass");
  command->add_flag("--yes", yes,
                    "answer all questions with yes; only if no person is near the arm");
  command->add_flag("--json", check.json, "print the report as JSON");
  command->callback([&, command] {
    CheckNetwork(*command, check.network);
    check.interrupted = &interrupted;
    check.stop_datagrams = !no_datagrams;
    ListenForInterrupts();
    check.ask = [&](const std::string& question) {
      if (yes) return true;
      const std::string answer = AnswerAtTerminal(question, " [y/N] ", " (--yes answers yes)");
      return answer == "y" || answer == "yes";
    };
    check.say = Say;
    result = RunCheck(check);
  });

  HomeOptions home;
  command =
      app.add_subcommand("home",
                         "Send the Stewart platform home after a typed confirmation, for example "
                         "if a killed\nprogram left it moving. Exit code 1 without confirmation");
  command
      ->add_option("--platform", home.platform,
                   "serial port of the platform, for example /dev/ttyACM0")
      ->required();
  command->callback([&] {
    home.interrupted = &interrupted;
    ListenForInterrupts();
    home.confirms = [](const std::string& question, const std::string& word) {
      return AnswerAtTerminal(question, " ", "") == word;
    };
    home.say = Say;
    result = RunHome(home);
  });

  core::AddExamples(app,
                    {{"stop", {"--discovery network"}},
                     {"certificates", {"keys", "keys --participants monitor:monitor --days 365"}},
                     {"check",
                      {"--arm PSM1 --endoscope /ECM/image_raw --discovery network",
                       "--platform /dev/ttyACM0 --move"}},
                     {"home", {"--platform /dev/ttyACM0"}}});
  return Parse(app, argc, argv).value_or(result);
}

}  // namespace
}  // namespace dfr::apps::hardware_app

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("hardware", argc, argv, dfr::apps::hardware_app::Main);
}
