#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <thread>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/dds/channel.h"
#include "endoscope_server.h"
#include "request.h"

namespace dfr::sim {
namespace {

using kinematics::PlatformPose;
using Clock = std::chrono::steady_clock;

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr double kLongestStep = 0.02;  // s, maximum step of a run in lock-step
constexpr double kLongestRun = 60.0;   // s
constexpr double kPlatformWay = 5e-3;  // m, amplitude

constexpr std::array<std::pair<std::string_view, CameraFault>, 6> kCameraFaults = {{
    {"none", CameraFault::kNone},
    {"frozen", CameraFault::kFrozen},
    {"black", CameraFault::kBlack},
    {"overexposed", CameraFault::kOverexposed},
    {"no_line", CameraFault::kNoLine},
    {"no_tip", CameraFault::kNoTip},
}};

dds::PoseStamped Pose(const dds::Stamp& stamp, const std::string& frame, const PlatformPose& pose) {
  const Eigen::Isometry3d transform = pose.Transform();
  dds::PoseStamped message;
  message.stamp = stamp;
  message.frame_id = frame;
  message.position_m = transform.translation();
  message.orientation = Eigen::Quaterniond(transform.linear());
  return message;
}

}  // namespace

struct DvrkSceneServer::Impl {
  Impl(dds::Participant& control, dds::Participant& images, DvrkScene& served,
       const DvrkSceneServerOptions& chosen)
      : scene(served),
        options(chosen),
        console(control, served.console(), ConsoleOptions()),
        platform_measured(control, "/" + chosen.platform_name + "/measured_cp", dds::Role::kState),
        platform_setpoint(control, "/" + chosen.platform_name + "/setpoint_cp", dds::Role::kState),
        request(control, "/simulator/request", dds::Role::kRequest),
        reply(control, "/simulator/reply", dds::Role::kRequest) {
    if (!chosen.camera) return;
    camera.emplace(images, served,
                   internal::EndoscopeServer::Options{chosen.camera_name, chosen.image_period_s,
                                                      chosen.jpeg_quality, !chosen.lock_step});
  }

  PsmConsoleServerOptions ConsoleOptions() {
    PsmConsoleServerOptions o = options.console;
    if (options.lock_step) {
      now_ns = dds::Stamp::Now().nanoseconds() / kSecond * kSecond;
      o.clock = [this] { return dds::Stamp::FromNanoseconds(now_ns); };
    } else {
      o.clock = &dds::Stamp::Now;
    }
    return o;
  }

  [[nodiscard]] std::string Now() const {
    return "ok " + std::to_string(console.now().nanoseconds());
  }

  void PublishState(double dt_s, bool now) {
    const std::uint64_t before = console.states_published();
    console.Publish(dt_s, now);
    if (!now && console.states_published() == before) return;
    const dds::Stamp stamp = console.now();
    const std::string frame = options.platform_name + "_base";
    platform_measured.Write(Pose(stamp, frame, scene.plant().platform_pose()));
    platform_setpoint.Write(Pose(stamp, frame, scene.plant().platform_setpoint()));
  }

  void LockStepOnly(std::string_view what) const {
    DFR_THROW_UNLESS(options.lock_step, what << " requires lock-step");
  }

  std::string Run(std::string_view arguments) {
    const double dt_s = internal::ParseNumber(internal::NextWord(arguments), "the time to run");
    DFR_THROW_UNLESS(dt_s >= 0.0 && dt_s <= kLongestRun,
                     "the time to run must lie in [0, " << kLongestRun << "] s, not " << dt_s);
    if (!arguments.empty()) {
      const std::uint64_t wanted = internal::ParseCount(arguments, "the number of commands");
      const auto end = Clock::now() + std::chrono::duration<double>(options.command_timeout_s);
      for (console.TakeCommands(); console.commands_taken() - commands_before < wanted;
           console.TakeCommands()) {
        if (Clock::now() > end) {
          throw std::runtime_error("only " +
                                   std::to_string(console.commands_taken() - commands_before) +
                                   " of " + std::to_string(wanted) + " commands have arrived");
        }
        std::this_thread::sleep_for(std::chrono::microseconds(50));
      }
    }
    console.TakeCommands();
    const int steps = std::max(1, static_cast<int>(std::ceil(dt_s / kLongestStep)));
    for (int i = 0; i < steps; ++i) scene.Step(dt_s / steps);
    now_ns += std::llround(1e9 * dt_s);
    commands_before = console.commands_taken();
    PublishState(dt_s, true);
    return Now();
  }

  std::string Reset(std::string_view arguments) {
    const std::uint64_t seed = internal::ParseCount(arguments, "the seed");
    console.TakeCommands();  // drops earlier commands
    scene.Reset(seed);
    commands_before = console.commands_taken();
    if (camera) camera->Reset();
    PublishState(0.0, true);
    return Now();
  }

  std::string Rest() {
    console.TakeCommands();
    scene.Rest();
    commands_before = console.commands_taken();
    PublishState(0.0, true);
    return Now();
  }

  std::string Look() {
    DFR_THROW_UNLESS(camera.has_value(), "this simulator has no camera");
    camera->Look(console.now());
    return Now();
  }

  [[nodiscard]] std::string Truth() const {
    const LineTrackingPlant& plant = scene.plant();
    const LineTrackingTruth truth = plant.truth();
    std::string text = "ok ";
    text += plant.completed() ? "1 " : "0 ";
    text += plant.collided() ? "1" : "0";
    for (const double value :
         {truth.progress_m, truth.distance_m, truth.tip_m.x(), truth.tip_m.y(), truth.tip_m.z()}) {
      text += ' ' + internal::Shortest(value);
    }
    return text;
  }

  void SetFault(std::string_view name, std::string_view value) {
    ConsoleFaults faults = console.faults();
    if (name == "none") {
      console.SetFaults({});
      SetCamera("none");
      platform_speed = 0.0;
    } else if (name == "camera") {
      SetCamera(value);
    } else if (name == "platform") {
      const double speed = internal::ParseNumber(value, "the platform's speed");
      DFR_THROW_UNLESS(speed >= 0.0 && speed <= 0.2, "platform speed must lie in [0, 0.2] m/s");
      platform_speed = speed;
    } else if (name == "arm_fault") {
      scene.console().Fail(value.empty() ? "a requested fault" : std::string(value));
    } else if (name == "unheard") {
      DFR_THROW_UNLESS(value == "hold" || value == "free",
                       "unheard must be hold or free, not '" << value << "'");
      value == "hold" ? scene.console().Hold() : scene.console().Free();
    } else if (sim::SetFault(faults, name, value)) {
      console.SetFaults(faults);
    } else {
      DFR_THROW_UNLESS(false, "unknown fault '"
                                  << name
                                  << "'; valid: delay, jitter, drop, drop_commands, "
                                     "clock_jump, freeze, silent, invalid, corrupt, camera, "
                                     "platform, arm_fault, unheard, none");
    }
  }

  // Moves the platform back and forth across the line while the fault lasts.
  void DrivePlatform(double dt_s) {
    if (platform_speed == 0.0) return;
    platform_way += platform_speed * dt_s;
    const double turns = platform_way / kPlatformWay;
    PlatformPose pose;
    pose.translation_m.y() = kPlatformWay * (1.0 - std::abs(std::fmod(turns + 1.0, 4.0) - 2.0));
    scene.MovePlatform(pose);
  }

  void SetCamera(std::string_view value) {
    const bool silent = value == "silent";
    const bool noisy = value == "frozen_noisy";
    const bool late = value == "late";
    if (noisy) value = "frozen";
    if (late) value = "none";
    for (const auto& [name, fault] : kCameraFaults) {
      if (!silent && value != name) continue;
      if (camera) {
        camera->SetSilent(silent);
        camera->SetNoisy(noisy);
        camera->SetLate(late);
      }
      scene.SetCameraFault(silent ? CameraFault::kNone : fault);
      return;
    }
    DFR_THROW_UNLESS(false, "unknown camera fault '" << value
                                                     << "'; valid: none, frozen, black, "
                                                        "overexposed, no_line, no_tip, silent, "
                                                        "frozen_noisy, late");
  }

  std::string Answer(std::string_view text) {
    const std::string_view what = internal::NextWord(text);
    if (what == "reset") return Reset(text);
    if (what == "truth") return Truth();
    if (what == "arm") return "ok " + scene.console().options().arm;
    if (what == "fault") {
      const std::string_view name = internal::NextWord(text);
      SetFault(name, text);
      return "ok";
    }
    if (what == "run" || what == "rest" || what == "look") {
      LockStepOnly(what);
      return what == "run" ? Run(text) : what == "rest" ? Rest() : Look();
    }
    DFR_THROW_UNLESS(false, "unknown request '"
                                << what
                                << "'; valid: reset, truth, arm, fault, and in lock-step run, "
                                   "rest, look");
    return {};
  }

  void AnswerRequests() {
    dds::StringStamped message;
    while (request.Take(message)) {
      std::string answer;
      try {
        answer = Answer(message.text);
      } catch (const std::exception& e) {
        answer = std::string("error: ") + e.what();
      }
      message.text = answer;
      reply.Write(message);
    }
  }

  DvrkScene& scene;
  DvrkSceneServerOptions options;
  std::int64_t now_ns = 0;  // time in lock-step
  std::uint64_t commands_before = 0;
  double platform_speed = 0.0;  // m/s
  double platform_way = 0.0;    // m, distance travelled during all platform faults
  PsmConsoleServer console;
  dds::Publisher<dds::PoseStamped> platform_measured;
  dds::Publisher<dds::PoseStamped> platform_setpoint;
  dds::Subscriber<dds::StringStamped> request;
  dds::Publisher<dds::StringStamped> reply;
  std::optional<internal::EndoscopeServer> camera;
};

DvrkSceneServer::DvrkSceneServer(dds::Participant& participant, dds::Participant& images,
                                 DvrkScene& scene, const DvrkSceneServerOptions& options) {
  DFR_THROW_UNLESS(options.image_period_s > 0.0 && options.image_period_s <= 10.0,
                   "image_period_s must lie in (0, 10]");
  DFR_THROW_UNLESS(options.command_timeout_s >= 0.0 && options.command_timeout_s <= 60.0,
                   "command_timeout_s must lie in [0, 60]");
  DFR_THROW_UNLESS(options.jpeg_quality >= 1 && options.jpeg_quality <= 100,
                   "jpeg_quality must lie in [1, 100]");
  DFR_THROW_UNLESS(!options.camera_name.empty() && !options.platform_name.empty(),
                   "camera and platform must have names");
  impl_ = std::make_unique<Impl>(participant, images, scene, options);
}

DvrkSceneServer::~DvrkSceneServer() = default;

void DvrkSceneServer::Tick(double dt_s) {
  Impl& i = *impl_;
  i.console.TakeCommands();
  i.DrivePlatform(dt_s);
  i.scene.Step(dt_s);
  i.PublishState(dt_s, false);
  i.AnswerRequests();
  if (i.camera) i.camera->Offer([&i] { return i.console.now(); });
}

void DvrkSceneServer::Serve(double timeout_s) {
  Impl& i = *impl_;
  // Maximum wait for a request, s. After each wait, commands are taken before they expire.
  constexpr double kGlance = 5e-3;
  const auto end = Clock::now() + std::chrono::duration<double>(timeout_s);
  do {
    const double left_s = std::chrono::duration<double>(end - Clock::now()).count();
    if (i.request.Wait(std::clamp(left_s, 0.0, kGlance))) i.AnswerRequests();
    i.console.TakeCommands();
    i.console.PublishEvents();
  } while (Clock::now() < end);
}

void DvrkSceneServer::SetFault(std::string_view name, std::string_view value) {
  impl_->SetFault(name, value);
}

std::uint64_t DvrkSceneServer::states_published() const noexcept {
  return impl_->console.states_published();
}

std::uint64_t DvrkSceneServer::images_published() const noexcept {
  return impl_->camera ? impl_->camera->published() : 0;
}

}  // namespace dfr::sim
