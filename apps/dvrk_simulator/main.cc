// A simulated PSM, endoscope and platform on the topics of a da Vinci Research Kit console.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <iomanip>
#include <iostream>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "apps/command_line.h"
#include "apps/inputs.h"
#include "apps/network_options.h"
#include "apps/platform_options.h"
#include "dfr/runtime/periodic_timer.h"
#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"

namespace {

using dfr::apps::OneOf;
using dfr::kinematics::PsmGeneration;
using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t stopped = 0;

void Stop(int /*signal*/) { stopped = 1; }

struct Options {
  dfr::dds::ParticipantOptions network;
  dfr::sim::DvrkSceneOptions scene;
  dfr::sim::DvrkSceneServerOptions server;
  std::string calibration;
  bool shared_memory = true;
  double duration_s = 0.0;
  double status_s = 0.0;
  int priority = 0;
  std::vector<std::pair<std::string, std::string>> faults;
};

// Checks one part of a ROS 2 topic's name.
const CLI::Validator kTopicName(
    [](std::string& text) {
      const auto fits = [](unsigned char c) { return std::isalnum(c) != 0 || c == '_'; };
      const bool good = !text.empty() && std::isdigit(static_cast<unsigned char>(text[0])) == 0 &&
                        std::ranges::all_of(text, fits);
      return good ? std::string()
                  : "'" + text +
                        "' is not a topic's name: use letters, digits and _, and no digit first";
    },
    "");

void AddNetwork(CLI::App& app, Options& options) {
  const std::string group = "Network";
  dfr::apps::AddNetwork(app, options.network, group);
  app.add_option("--server-port", options.network.server_port, "port of the discovery server")
      ->capture_default_str()
      ->group(group);
  app.add_flag("--shared-memory,!--no-shared-memory", options.shared_memory,
               "send pictures through shared memory to clients on this machine that offer "
               "it\n(default: yes); the arm stays on UDP")
      ->group(group);
}

void AddScene(CLI::App& app, Options& options) {
  auto& [arm, world, seed, linger_s] = options.scene;
  const std::string group = "Scene";
  app.add_option("--arm", arm.arm, "name of the arm, the first part of its topics")
      ->check(kTopicName)
      ->capture_default_str()
      ->group(group);
  app.add_option("--generation", arm.generation,
                 "generation of the da Vinci: Classic, or Si, which has larger joint ranges")
      ->transform(
          OneOf<PsmGeneration>({{"Classic", PsmGeneration::kClassic}, {"Si", PsmGeneration::kSi}}))
      ->type_name("TEXT")
      ->default_str("Classic")
      ->group(group);
  app.add_option("--seed", seed, "random seed of the first episode: line, light, disturbance")
      ->capture_default_str()
      ->group(group);
  app.add_option("--homing", arm.homing_s, "duration of homing [s]")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str()
      ->group(group);
  app.add_option("--arm-error-seed", world.arm.seed,
                 "random seed of the individual arm's cable errors")
      ->capture_default_str()
      ->group(group);
  app.add_option("--arm-error", world.arm.mean_error_m,
                 "mean distance of the tip from its position by the encoders [m];\nup to 0.0005 "
                 "m of it remain after a calibration")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str()
      ->group(group);
  app.add_flag_callback(
         "--ecm",
         [&options] {
           using Plant = dfr::sim::LineTrackingPlant;
           options.scene.arm.base_frame = Plant::p_world_cam().inverse() * Plant::p_world_base();
           options.scene.arm.base_frame_name = "ECM_view";
         },
         "publish poses relative to the camera, as on a cart with an endoscope arm; local/ poses "
         "stay in the base frame")
      ->group(group);
  app.add_option("--calibration", options.calibration,
                 "calibration with which the operator places the tip over the line: file "
                 "of\nline_tracking calibrate; by default the true camera and an uncorrected arm")
      ->group(group);
  auto& d = world.disturbance;
  dfr::apps::AddWave(app, d, group);
  app.add_flag("--during,!--not-during", d.during,
               "move the platform while the arm moves (default: yes)")
      ->group(group);
  app.add_flag("--between", d.between,
               "move the platform while the arm rests; in lock-step, for --pause at each rest")
      ->group(group);
  app.add_option("--pause", d.pause_s, "duration of the motion at each rest, in lock-step [s]")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str()
      ->group(group);
  app.add_flag("!--no-camera", options.server.camera,
               "draw and publish no pictures; OpenGL is not needed then")
      ->group(group);
}

void AddTime(CLI::App& app, Options& options) {
  const std::string group = "Time";
  app.add_flag("--lock-step", options.server.lock_step,
               "advance time only when /simulator/request asks for it")
      ->group(group);
  app.add_option("--period", options.server.console.state_period_s,
                 "time between published states [s]")
      ->check(CLI::Range(1e-4, 60.0))
      ->capture_default_str()
      ->group(group);
  app.add_option("--image-period", options.server.image_period_s, "time between pictures [s]")
      ->check(CLI::Range(1e-3, 60.0))
      ->default_str("1/30")
      ->group(group);
  app.add_option(
         "--priority", options.priority,
         "SCHED_FIFO priority of the arm's thread (a real console has its own processor); 0: none")
      ->capture_default_str()
      ->check(CLI::Range(0, 99))
      ->group(group);
  app.add_option("--duration", options.duration_s, "stop after this time [s]; 0: never")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str()
      ->group(group);
  app.add_option("--status", options.status_s,
                 "time between printed lines (state, rates, tip) [s]; 0: print none")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str()
      ->group(group);
}

void AddFaults(CLI::App& app, Options& options) {
  const std::string group = "Faults, also at run time: \"fault NAME VALUE\" on /simulator/request";
  const auto number = [&](const std::string& name, const std::string& option, const char* help) {
    return app
        .add_option_function<std::string>(
            option,
            [&options, name](const std::string& v) { options.faults.emplace_back(name, v); }, help)
        ->type_name("NUMBER")
        ->group(group);
  };
  const auto flag = [&](const std::string& name, const char* help) {
    app.add_flag_callback(
           "--" + name, [&options, name] { options.faults.emplace_back(name, "1"); }, help)
        ->group(group);
  };
  number("delay", "--delay", "delay of measurements [s]")->check(CLI::Range(0.0, 2.0));
  number("jitter", "--jitter", "largest additional random delay [s]")->check(CLI::Range(0.0, 2.0));
  number("drop", "--drop", "fraction of lost state samples")->check(dfr::apps::ShareIn("[0, 1]"));
  number("drop_commands", "--drop-commands", "fraction of lost motion commands")
      ->check(dfr::apps::ShareIn("[0, 1]"));
  number("clock_jump", "--clock-jump", "offset added to all stamps [s]")
      ->check(CLI::Range(-1e6, 1e6));
  app.add_option("--fault-seed", options.server.console.seed, "random seed of losses and delays")
      ->capture_default_str()
      ->group(group);
  flag("freeze", "repeat the same state");
  flag("silent", "publish no state");
  flag("invalid", "set all stamps to zero");
  flag("corrupt", "publish NaN as positions");
  number("platform", "--platform-speed",
         "speed of an additional 5 mm motion back and forth across the line [m/s]")
      ->check(CLI::Range(0.0, 0.2));
  app.add_option_function<std::string>(
         "--camera-fault",
         [&options](const std::string& v) { options.faults.emplace_back("camera", v); },
         "fault of the pictures")
      ->check(CLI::IsMember({"none", "frozen", "frozen_noisy", "black", "overexposed", "no_line",
                             "no_tip", "silent", "late"}))
      ->group(group);
}

void Introduce(const Options& options) {
  const std::string arm = "/" + options.scene.arm.arm;
  std::cout << "dvrk_simulator: " << options.scene.arm.arm << ", "
            << (options.server.camera ? "endoscope ECM and platform SPRK" : "platform SPRK")
            << " in domain " << options.network.domain << '\n'
            << "  state    " << arm << "/measured_cp measured_js setpoint_cp ... at "
            << 1.0 / options.server.console.state_period_s << " Hz, " << arm
            << "/operating_state error warning status\n"
            << "  commands " << arm << "/state_command (home first), servo_cp, move_cp, ...\n";
  if (options.server.camera) {
    std::cout << "  pictures /ECM/image_raw image_raw/compressed camera_info";
    if (!options.server.lock_step) {
      std::cout << " at " << 1.0 / options.server.image_period_s
                << " Hz, while a program subscribes";
    }
    std::cout << '\n';
  }
  std::cout << "  platform /SPRK/measured_cp setpoint_cp\n"
            << "  itself   /simulator/request: reset SEED, truth, arm, fault NAME VALUE"
            << (options.server.lock_step ? ", run DT, rest, look" : "") << '\n'
            << (options.server.lock_step ? "Time advances only on request. " : "")
            << "Ctrl-C ends it." << std::endl;
}

// Prints a line of status at a fixed interval.
class Status {
 public:
  Status(const Options& options, const dfr::sim::DvrkScene& scene,
         const dfr::sim::DvrkSceneServer& server)
      : period_s_(options.status_s), scene_(&scene), server_(&server) {}

  void Print(Clock::time_point now) {
    const double since_s = std::chrono::duration<double>(now - last_).count();
    if (period_s_ <= 0.0 || since_s < period_s_) return;
    const auto& console = scene_->console();
    const auto truth = scene_->plant().truth();
    std::cout << std::fixed << std::setprecision(1)
              << std::chrono::duration<double>(now - start_).count() << " s  "
              << dfr::sim::Name(console.state()) << (console.homed() ? ", homed" : ", not homed")
              << (console.busy() ? ", busy" : "") << "  state "
              << static_cast<double>(server_->states_published() - states_) / since_s
              << " Hz, pictures "
              << static_cast<double>(server_->images_published() - images_) / since_s << " Hz  tip "
              << std::setprecision(2) << 1e3 * truth.tip_m.x() << ' ' << 1e3 * truth.tip_m.y()
              << ' ' << 1e3 * truth.tip_m.z() << " mm, " << 1e3 * truth.distance_m
              << " mm off the line" << std::endl;
    states_ = server_->states_published();
    images_ = server_->images_published();
    last_ = now;
  }

 private:
  double period_s_;
  const dfr::sim::DvrkScene* scene_;
  const dfr::sim::DvrkSceneServer* server_;
  Clock::time_point start_ = Clock::now();
  Clock::time_point last_ = start_;
  std::uint64_t states_ = 0;
  std::uint64_t images_ = 0;
};

// Prints each participant that was found but not admitted, once.
void ReportRefused(dfr::dds::Participant& participant) {
  for (const auto& [name, guid, reason] : participant.TakeRefusedPeers()) {
    std::cout << "dvrk_simulator: refused '" << dfr::core::Printable(name) << "' (" << guid
              << "): " << reason << std::endl;
  }
}

void Run(Options options) {
  if (options.server.lock_step) options.scene.linger_s = 0.0;
  // The residual is a part of the mean error and cannot exceed it.
  auto& error = options.scene.world.arm;
  error.mean_residual_m = std::min(error.mean_residual_m, error.mean_error_m);
  options.network.name = "dvrk_simulator";
  dfr::dds::Participant control(options.network);
  options.network.name = "dvrk_simulator_images";
  options.network.shared_memory = options.shared_memory;
  dfr::dds::Participant images(options.network);
  std::optional<dfr::line_task::LineCalibration> known;
  if (!options.calibration.empty()) {
    dfr::apps::MustExist(options.calibration,
                         "Run `line_tracking calibrate` first, or give another file");
    known = dfr::line_task::LineCalibration::Load(options.calibration);
  }
  dfr::sim::DvrkScene scene(options.scene, known ? &*known : nullptr);
  dfr::sim::DvrkSceneServer server(control, images, scene, options.server);
  for (const auto& [name, value] : options.faults) server.SetFault(name, value);
  Introduce(options);

  // The priority is set after the drawing threads have started, because they must not inherit it.
  if (options.priority > 0) {
    const std::string refused = dfr::runtime::AskForRealTime(options.priority);
    if (!refused.empty()) std::cout << "note: " << refused << std::endl;
  }
  Status status(options, scene, server);
  constexpr std::chrono::milliseconds kPeriod(1);
  // Simulated time follows the clock. If the machine falls behind, steps are longer, up to the
  // console's limit.
  constexpr double kLongestStep = 0.1;
  const auto start = Clock::now();
  auto look_for_refused = start;
  for (auto last = start; stopped == 0;) {
    const auto now = Clock::now();
    if (options.server.lock_step) {
      server.Serve(0.1);
    } else {
      server.Tick(std::min(std::chrono::duration<double>(now - last).count(), kLongestStep));
    }
    last = now;
    status.Print(now);
    if (now >= look_for_refused) {
      ReportRefused(control);
      look_for_refused = now + std::chrono::seconds(1);
    }
    if (options.duration_s > 0.0 &&
        std::chrono::duration<double>(now - start).count() >= options.duration_s) {
      break;
    }
    if (!options.server.lock_step) std::this_thread::sleep_until(now + kPeriod);
  }
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app(
      "Simulates a PSM, an endoscope and a platform behind the topics of a da Vinci Research Kit\n"
      "console (CRTK over ROS 2's DDS), until Ctrl-C. ROS 2 nodes and dfr's own clients find them\n"
      "by their usual names. Try: dvrk_simulator --status 1",
      "dvrk_simulator");
  dfr::apps::AddVersion(app);
  AddScene(app, options);
  AddTime(app, options);
  AddNetwork(app, options);
  AddFaults(app, options);
  app.callback([&] { dfr::apps::CheckNetwork(app, options.network); });
  if (const auto code = dfr::apps::Parse(app, argc, argv)) return *code;

  // Handlers are installed before any thread starts: a signal must never kill the program.
  std::signal(SIGINT, Stop);
  std::signal(SIGTERM, Stop);
  Run(options);
  std::cout << "dvrk_simulator: stopped" << std::endl;
  return EXIT_SUCCESS;
}

}  // namespace

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("dvrk_simulator", argc, argv, Main);
}
