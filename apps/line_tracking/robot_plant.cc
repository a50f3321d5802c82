#include "robot_plant.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <utility>

#include "dfr/hardware/psm_driver.h"
#include "dfr/runtime/periodic_timer.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "line_eye.h"
#include "simulator_link.h"
#include "watchman.h"

namespace dfr::apps::line_tracking {
namespace {

using core::PlantStatus;
using hardware::PsmStatus;
using kinematics::PsmJoints;
using line_task::LineTask;
using runtime::Doubt;

constexpr int kMaxLooks = 3;
constexpr double kLookTime = 2.0;  // s: no picture for so long is a fault

// What the arm's driver says, in the machine's words.
Doubt ToDoubt(PsmStatus status) noexcept {
  switch (status) {
    case PsmStatus::kOk:
    case PsmStatus::kHeld:  // by us: whoever asked for it knows why
      return Doubt::kNone;
    case PsmStatus::kNoConsole:
    case PsmStatus::kConsoleGone:
    case PsmStatus::kIncompatible:
    case PsmStatus::kStateSilent:
      return Doubt::kArmSilent;
    case PsmStatus::kNoOperatingState:
    case PsmStatus::kConsoleFault:
    case PsmStatus::kConsoleError:
    case PsmStatus::kDisabled:
    case PsmStatus::kPaused:
    case PsmStatus::kUnknownState:
    case PsmStatus::kNotHomed:
    case PsmStatus::kBusy:
    case PsmStatus::kTimedOut:
    case PsmStatus::kNotArmed:
      return Doubt::kArmNotReady;
    case PsmStatus::kStateInvalid:
    case PsmStatus::kStateMalformed:
    case PsmStatus::kStateNotFinite:
      return Doubt::kArmInvalid;
    case PsmStatus::kStateOld:
      return Doubt::kArmOld;
    case PsmStatus::kStateAhead:
      return Doubt::kClock;
    case PsmStatus::kStateJumped:
    case PsmStatus::kFrameMismatch:
      return Doubt::kArmJump;
    case PsmStatus::kOtherPublisher:
      return Doubt::kSecondCommander;
    case PsmStatus::kNotFollowing:
    case PsmStatus::kNotReached:
      return Doubt::kArmNotFollowing;
    case PsmStatus::kTickLate:
    case PsmStatus::kSendFailed:
      return Doubt::kOverrun;
    case PsmStatus::kInvalidGoal:
    case PsmStatus::kBeyondLimits:
    case PsmStatus::kUnreachable:
    case PsmStatus::kOutsideWorkspace:
    case PsmStatus::kTooFast:
      return Doubt::kCommandRefused;
  }
  return Doubt::kArmNotReady;
}

Doubt ToDoubt(hardware::FrameStatus status) noexcept {
  using hardware::FrameStatus;
  switch (status) {
    case FrameStatus::kOk:
      return Doubt::kNone;
    case FrameStatus::kNever:
    case FrameStatus::kSilent:
    case FrameStatus::kEnded:
    case FrameStatus::kTruncated:
    case FrameStatus::kFailed:
      return Doubt::kImageSilent;
    case FrameStatus::kOld:
      return Doubt::kImageOld;
    case FrameStatus::kAhead:
    case FrameStatus::kInvalidStamp:
      return Doubt::kClock;
    case FrameStatus::kWrongSize:
    case FrameStatus::kWrongEncoding:
    case FrameStatus::kDark:
    case FrameStatus::kFrozen:
      return Doubt::kImageInvalid;
  }
  return Doubt::kImageInvalid;
}

std::unique_ptr<hardware::Endoscope> OpenCamera(dds::Participant& network,
                                                const RobotConfig& config,
                                                const vision::CameraModel& camera) {
  hardware::EndoscopeOptions options;
  options.width = camera.width;
  options.height = camera.height;
  options.max_age_s = config.image_max_age_s;
  options.max_repeats = 2;
  if (config.lock_step) {
    // Stamps are the simulator's time, which has nothing to do with ours.
    options.max_age_s = 1e5;  // s
    options.max_ahead_s = 1e5;
  }
  const bool topic = config.camera.rfind('/', 0) == 0 && config.camera.rfind("/dev/", 0) != 0;
  return topic ? hardware::OpenTopic(network, config.camera, options)
               : hardware::OpenVideo(config.camera, options);
}

std::string InWords(Doubt doubt, std::string_view detail) {
  const std::string name = runtime::Name(doubt);
  return detail.empty() ? name : name + ": " + std::string(detail);
}

hardware::PsmDriverOptions DriverOptions(const RobotConfig& config) {
  hardware::PsmDriverOptions options;
  options.arm = config.arm;
  options.client = config.arm_client;
  // As the simulation moves: the controls are small, and come to rest in between.
  options.client.profile = hardware::PsmProfile::kLinear;
  return options;
}

Eigen::Isometry3d Base(const RobotConfig& config) {
  return config.p_world_base ? *config.p_world_base : sim::LineTrackingPlant::p_world_base();
}

dds::ParticipantOptions ImageNetwork(dds::ParticipantOptions network) {
  network.name += "-images";
  network.shared_memory = true;
  return network;
}

}  // namespace

// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): members in the order of their making.
struct RobotPlant::Impl {
  Impl(const RobotConfig& chosen, const line_task::LineCalibration& calibration,
       recording::Recorder* log)
      : config(chosen),
        task(calibration, Base(chosen)),
        recorder(log),
        network(chosen.network),
        images(ImageNetwork(chosen.network)),
        driver(network, DriverOptions(chosen)),
        machine({.max_period_s = chosen.lock_step ? 10.0 : chosen.max_period_s, .calm_s = 0.2}),
        watchman(network, chosen.emergency_stop, chosen.emergency_stop_silence_s),
        eye(OpenCamera(images, chosen, calibration.camera), task, log) {
    if (config.simulator) link.emplace(network);
    state.fill(std::numeric_limits<double>::quiet_NaN());
  }

  // -- time -------------------------------------------------------------------------------------

  [[nodiscard]] std::int64_t SteadyNs() const noexcept {
    return config.lock_step ? link->now_ns() : runtime::SteadyNow();
  }
  [[nodiscard]] std::int64_t WallNs() const noexcept {
    return config.lock_step ? link->now_ns() : runtime::WallNow();
  }

  // One period of the loop, in lock-step dt_s long. True if the robot may move.
  bool Tick(double dt_s) noexcept {
    if (config.lock_step) {
      // Once it has not answered, it is not waited for in every period.
      if (link_lost) machine.Doubted(Doubt::kArmSilent, "the simulator does not answer");
      try {
        if (link_lost) return false;
        RunSimulator(dt_s);
      } catch (const std::exception& e) {
        link_lost = true;
        machine.Doubted(Doubt::kArmSilent, e.what());
      }
    } else {
      if (!timer) timer.emplace(config.period_s);
      timer->Wait();
    }
    machine.Tick(SteadyNs());
    Watch();
    Report();
    watchman.Beat(machine.state());
    return machine.may_move();
  }

  // Lets the simulator's time go on with the set-points that the driver has sent, and sends them
  // again if they have expired on the way.
  void RunSimulator(double dt_s) {
    constexpr int kTries = 20;
    for (int n = 0; n < kTries; ++n) {
      driver.Flush();
      const std::uint64_t sent = driver.setpoints_sent();
      const bool ran = link->Run(dt_s, n == 0 ? static_cast<int>(sent - setpoints_seen) : 1);
      setpoints_seen = sent;
      if (ran) {
        driver.Flush();
        return;
      }
      static_cast<void>(driver.Tick(SteadyNs(), WallNs()));
    }
    throw std::runtime_error("set-points do not reach the simulator");
  }

  // Looks at everything that can be in doubt.
  void Watch() noexcept {
    const std::int64_t now_ns = SteadyNs();
    const bool armed = driver.phase() == hardware::PsmPhase::kArmed;
    const PsmStatus arm = driver.Tick(now_ns, WallNs());
    // An unarmed driver is no doubt, but what keeps it from being armed is.
    const PsmStatus found = armed ? arm : driver.client().doubt();
    if (ToDoubt(found) != Doubt::kNone) {
      const std::string_view error =
          found == PsmStatus::kConsoleFault || found == PsmStatus::kConsoleError
              ? driver.last_error()
              : std::string_view();
      machine.Doubted(ToDoubt(found), error.empty() ? hardware::Name(found) : error);
    }
    switch (watchman.emergency_stop()) {
      case dds::EmergencyStop::kClear:
        break;
      case dds::EmergencyStop::kPressed:
        machine.Doubted(Doubt::kEmergencyStop, "pressed");
        break;
      case dds::EmergencyStop::kSilent:
        machine.Doubted(Doubt::kEmergencyStopSilent,
                        "no word from it: is `hardware stop` running?");
        break;
    }
    WatchCamera();
    if (interrupted != nullptr && *interrupted != nullptr && **interrupted) {
      machine.Doubted(Doubt::kOperator, "interrupted");
    }
    if (recorder != nullptr && recorder->failed()) {
      machine.Doubted(Doubt::kRecorder, "the recording cannot be written: is the disk full?");
    }
    if (!machine.may_move() && driver.phase() == hardware::PsmPhase::kArmed) {
      driver.Hold();
      static_cast<void>(driver.Tick(now_ns, WallNs()));  // at once, not with the next period
    }
  }

  void WatchCamera() noexcept {
    EyeNews news;
    if (eye.Take(news)) eye_news = news;
    if (config.lock_step) return;                      // pictures come when asked for
    constexpr std::int64_t kEyeSilence = 250'000'000;  // ns: its thread hangs
    if (runtime::SteadyNow() - eye_news.steady_ns > kEyeSilence) {
      machine.Doubted(Doubt::kImageSilent, "nobody looks at the pictures");
    } else if (eye_news.status != hardware::FrameStatus::kOk) {
      machine.Doubted(ToDoubt(eye_news.status), hardware::Name(eye_news.status));
    }
  }

  void Report() noexcept {
    runtime::Transition transition;
    while (machine.Take(transition)) {
      if (transition.doubt != Doubt::kNone || transition.to == runtime::RunState::kArmed) {
        last_cause = transition.doubt;
        last_detail = transition.detail;
      }
      if (recorder != nullptr) {
        recording::TransitionRecord record;
        record.time_ns = WallNs();
        record.from = runtime::Name(transition.from);
        record.to = runtime::Name(transition.to);
        std::array<char, 160> text{};
        const int size =
            transition.doubt == Doubt::kNone
                ? std::snprintf(text.data(), text.size(), "%s", transition.detail.data())
                : std::snprintf(text.data(), text.size(), "%s: %s", runtime::Name(transition.doubt),
                                transition.detail.data());
        record.cause = std::string_view(text.data(), static_cast<std::size_t>(std::max(0, size)));
        static_cast<void>(recorder->Transition(record));
      }
      if (on_transition != nullptr && *on_transition) (*on_transition)(transition);
    }
  }

  // Asks for a picture and what it shows until one shows line and tip, three times at most.
  void Look() noexcept {
    for (int look = 0; look < kMaxLooks; ++look) {
      ++question;
      eye.Ask(question, WallNs() + static_cast<std::int64_t>(1e9 * config.image_latency_s),
              task.TipPlane(driver.client().measured_js().position));
      if (config.lock_step) {
        try {
          link->Look();
          // Set-points expire while a picture is drawn; nothing moves then anyway.
          setpoints_seen = driver.setpoints_sent();
        } catch (const std::exception& e) {
          machine.Doubted(Doubt::kImageSilent, e.what());
          return;
        }
      }
      const std::int64_t end_ns = runtime::SteadyNow() + static_cast<std::int64_t>(1e9 * kLookTime);
      EyeSight sight;
      while (!eye.Take(sight) || sight.question != question) {
        if (runtime::SteadyNow() > end_ns) {
          machine.Doubted(Doubt::kImageSilent, "no picture in which to look for the line");
          return;
        }
        if (config.lock_step) {
          std::this_thread::sleep_for(std::chrono::microseconds(100));
        } else if (!Tick(config.period_s)) {
          return;
        }
      }
      seen = sight.seen;
      sequence = sight.sequence;
      picture_ns = sight.stamp_ns;
      if (seen.seen()) break;
    }
    task.State(seen, state);
  }

  // The arm to `reading` in `duration_s`, and at rest there.
  [[nodiscard]] PlantStatus Move(const PsmJoints& reading, double duration_s) noexcept {
    if (const PsmStatus status = driver.MoveTo(reading, duration_s); status != PsmStatus::kOk) {
      machine.Doubted(Doubt::kCommandRefused, hardware::Name(status));
      Report();
      return PlantStatus::kRefused;
    }
    const double periods = std::max(1.0, std::ceil(duration_s / config.period_s - 1e-9));
    while (driver.moving()) {
      if (!Tick(duration_s / periods)) return PlantStatus::kFault;
    }
    if (config.lock_step) {
      // The last set-point has still to be reached, and time to go on for that.
      if (!Tick(duration_s / periods)) return PlantStatus::kFault;
      try {
        driver.Flush();
        link->Rest();
        setpoints_seen = driver.setpoints_sent();
      } catch (const std::exception& e) {
        machine.Doubted(Doubt::kArmSilent, e.what());
        return PlantStatus::kFault;
      }
    }
    while (!driver.at_rest()) {
      if (!Tick(config.period_s)) return PlantStatus::kFault;
    }
    return PlantStatus::kOk;
  }

  void AskForTruth() {
    if (link && config.lock_step) {
      truth = link->Truth();
      return;
    }
    if (link) {
      // The loop goes on meanwhile: the console may have died.
      link->BeginTruth();
      while (!link->PollTruth(truth) && Tick(config.period_s)) {
      }
      return;
    }
    if (!seen.seen()) return;
    truth.collided = truth.collided || std::abs(seen.distance_m) > LineTask::kCollision;
    truth.progress_m = LineTask::Progress(first_seen, seen);
    truth.completed = !truth.collided && truth.progress_m >= LineTask::kCompletion;
  }

  RobotConfig config;
  LineTask task;
  recording::Recorder* recorder;
  dds::Participant network;
  dds::Participant images;
  hardware::PsmDriver driver;
  std::optional<SimulatorLink> link;
  runtime::FailSafe machine;
  Watchman watchman;
  LineEye eye;
  std::optional<runtime::PeriodicTimer> timer;
  bool link_lost = false;
  std::uint64_t setpoints_seen = 0;

  Eigen::Vector3d command_m = Eigen::Vector3d::Zero();  // tip, world
  std::array<double, 4> state{};
  vision::LineObservation seen;
  vision::LineObservation first_seen;
  std::uint64_t question = 0;
  std::uint64_t sequence = 0;
  std::int64_t picture_ns = 0;
  EyeNews eye_news;
  SimulatorTruth truth;
  Doubt last_cause = Doubt::kNone;
  std::array<char, 96> last_detail{};
  const std::function<void(const runtime::Transition&)>* on_transition = nullptr;
  const std::atomic<bool>* const* interrupted = nullptr;
};

RobotPlant::RobotPlant(const RobotConfig& config, const line_task::LineCalibration& calibration,
                       recording::Recorder* recorder)
    : impl_(std::make_unique<Impl>(config, calibration, recorder)) {
  impl_->on_transition = &on_transition;
  impl_->interrupted = &interrupted;
  if (impl_->link) impl_->link->Await(10.0);
}

RobotPlant::~RobotPlant() = default;  // its driver tells the console to hold

void RobotPlant::BringUp(const std::function<void(std::string_view)>& say) {
  Impl& i = *impl_;
  if (i.config.lock_step) {
    i.link->Reset(0);  // enables and homes
  } else {
    if (const PsmStatus status = hardware::BringUp(i.driver, 120.0, say);
        status != PsmStatus::kOk) {
      throw std::runtime_error(i.driver.Explain() + dds::ExplainRefused(i.network));
    }
    i.driver.Hold();
    Idle(0.3);
  }
  // The camera and the emergency stop may be found later than the arm.
  constexpr std::int64_t kSecond = 1'000'000'000;  // ns
  const std::int64_t start_ns = runtime::SteadyNow();
  for (bool said = false;;) {
    Idle(0.1);
    if (i.machine.blocking() == Doubt::kNone) return;
    const std::int64_t waited_ns = runtime::SteadyNow() - start_ns;
    if (waited_ns > 10 * kSecond) break;
    if (!said && waited_ns > kSecond && say) say("waiting: " + blocking());
    said = said || waited_ns > kSecond;
  }
  throw std::runtime_error("the robot is not ready: " + blocking());
}

void RobotPlant::Idle(double seconds) noexcept {
  const int periods = static_cast<int>(std::ceil(seconds / impl_->config.period_s));
  for (int n = 0; n < periods; ++n) static_cast<void>(impl_->Tick(impl_->config.period_s));
}

Doubt RobotPlant::Start() noexcept {
  Impl& i = *impl_;
  Idle(0.25);  // long enough for the machine to know that all is calm
  if (!i.machine.Arm()) {
    const Doubt blocking = i.machine.blocking();
    if (blocking != Doubt::kNone) return blocking;
    return i.last_cause != Doubt::kNone ? i.last_cause : Doubt::kOperator;
  }
  if (const PsmStatus status = i.driver.Arm(); status != PsmStatus::kOk) {
    i.machine.Doubted(ToDoubt(status), hardware::Name(status));
    i.Report();
    return ToDoubt(status);
  }
  i.command_m = i.task.Tip(i.driver.client().setpoint());
  static_cast<void>(i.machine.Start());
  i.Report();
  return Doubt::kNone;
}

bool RobotPlant::Clear() noexcept {
  impl_->watchman.Acknowledge();
  impl_->link_lost = false;
  Idle(0.25);
  const bool cleared = impl_->machine.Clear();
  impl_->Report();
  return cleared;
}

void RobotPlant::Doubted(Doubt doubt, std::string_view detail) noexcept {
  impl_->machine.Doubted(doubt, detail);
  impl_->Report();
}

void RobotPlant::Decided(const control::Step& step) noexcept {
  using control::Mode;
  impl_->machine.Recovering(step.mode == Mode::kProbe || step.mode == Mode::kRecovery);
  if (step.mode == Mode::kHalt) {
    impl_->machine.Doubted(step.cause == control::HaltCause::kControlInvalid
                               ? Doubt::kControlInvalid
                               : Doubt::kControllerHalted,
                           control::Name(step.cause));
  }
  impl_->Report();
}

const core::StateLayout& RobotPlant::layout() const noexcept { return impl_->task.layout(); }

void RobotPlant::Reset(std::uint64_t seed) {
  Impl& i = *impl_;
  Halt();
  Idle(0.05);
  if (i.link) {
    i.link->Reset(seed);
    i.setpoints_seen = i.driver.setpoints_sent();
  }
  i.eye.Forget();
  i.truth = {};
  // States and pictures may come late while a simulator sets up its scene. A robot begins at once
  // on its operator's word, or not at all.
  constexpr std::int64_t kPatience = 3'000'000'000;  // ns
  const std::int64_t end_ns = runtime::SteadyNow() + (i.link ? kPatience : 0);
  Doubt doubt = Start();
  while (doubt != Doubt::kNone && i.machine.state() != runtime::RunState::kFaulted &&
         runtime::SteadyNow() < end_ns) {
    doubt = Start();
  }
  if (doubt != Doubt::kNone) {
    throw std::runtime_error("the robot is not started: " +
                             (doubt == i.machine.blocking() ? blocking() : cause()));
  }
  // The tool may not be upright yet, or not as upright as the calibration has it.
  PsmJoints upright;
  if (!i.task.Reading(i.command_m, upright)) {
    throw std::runtime_error("the arm cannot hold its tool upright where it is; move it elsewhere");
  }
  constexpr double kUpright = 1e-6;  // rad, m
  if ((upright - i.driver.client().setpoint()).cwiseAbs().maxCoeff() > kUpright &&
      i.Move(upright, 2.0 * i.driver.client().motion().ShortestDuration(upright)) !=
          PlantStatus::kOk) {
    throw std::runtime_error("the tool cannot be turned upright: " + cause());
  }
  i.Look();
  i.first_seen = i.seen;
  i.AskForTruth();
}

PlantStatus RobotPlant::Apply(std::span<const double> control) noexcept {
  Impl& i = *impl_;
  if (control.size() != 2 || !std::isfinite(control[0]) || !std::isfinite(control[1])) {
    i.machine.Doubted(Doubt::kControlInvalid);
    return PlantStatus::kRefused;
  }
  if (!i.machine.may_move()) return PlantStatus::kFault;
  const Eigen::Vector3d step = LineTask::Displacement(control);
  PsmJoints reading;
  if (!i.task.Reading(i.command_m + step, reading)) {
    i.machine.Doubted(Doubt::kCommandRefused, "the arm cannot reach it");
    i.Report();
    return PlantStatus::kRefused;
  }
  if (const PlantStatus status = i.Move(reading, step.norm() / i.config.speed_m_s);
      status != PlantStatus::kOk) {
    return status;
  }
  i.command_m += step;
  const std::array<double, 4> before = i.state;
  i.Look();
  if (!i.machine.may_move()) return PlantStatus::kFault;
  const double jump_mm =
      std::hypot(i.state[0] - before[0] - 1e3 * step.x(), i.state[1] - before[1] - 1e3 * step.y());
  if (jump_mm > i.config.max_state_jump_mm) {
    i.machine.Doubted(Doubt::kStateJump, "the tip is not where the control took it");
    i.Report();
    return PlantStatus::kFault;
  }
  try {
    i.AskForTruth();
  } catch (const std::exception& e) {
    i.machine.Doubted(Doubt::kArmSilent, e.what());
  }
  return i.machine.may_move() ? PlantStatus::kOk : PlantStatus::kFault;
}

void RobotPlant::Observe(std::span<double> state) const noexcept {
  std::copy(impl_->state.begin(), impl_->state.end(), state.begin());
}

bool RobotPlant::completed() const noexcept { return impl_->truth.completed; }
bool RobotPlant::collided() const noexcept { return impl_->truth.collided; }

void RobotPlant::Halt() noexcept {
  Impl& i = *impl_;
  if (i.truth.collided) {
    i.machine.Doubted(Doubt::kControllerHalted, "collided");
  } else if (i.truth.completed) {
    i.machine.Done();
  } else if (!i.seen.seen()) {
    i.machine.Doubted(Doubt::kNotSeen, vision::Name(i.seen.missing));
  } else if (i.machine.may_move()) {
    i.machine.Doubted(Doubt::kOperator, "halted");
  }
  if (i.driver.phase() == hardware::PsmPhase::kArmed) i.driver.Hold();
  static_cast<void>(i.Tick(i.config.period_s));
}

runtime::RunState RobotPlant::state() const noexcept { return impl_->machine.state(); }

bool RobotPlant::ended_regularly() const noexcept {
  const Doubt cause = impl_->last_cause;
  return state() != runtime::RunState::kFaulted &&
         (cause == Doubt::kNone || cause == Doubt::kControllerHalted || cause == Doubt::kNotSeen);
}

std::string RobotPlant::cause() const {
  return InWords(impl_->last_cause, impl_->last_detail.data());
}

std::string RobotPlant::blocking() const {
  return InWords(impl_->machine.blocking(), impl_->machine.blocking_detail());
}

const vision::LineObservation& RobotPlant::last_observation() const noexcept { return impl_->seen; }
std::uint64_t RobotPlant::image_sequence() const noexcept { return impl_->sequence; }
std::int64_t RobotPlant::image_time_ns() const noexcept { return impl_->picture_ns; }
double RobotPlant::progress_m() const noexcept { return impl_->truth.progress_m; }

LoopTimes RobotPlant::loop_times() const noexcept {
  LoopTimes times;
  if (impl_->timer) {
    times.periods = impl_->timer->periods();
    times.missed = impl_->timer->missed();
    times.jitter_p50_s = impl_->timer->Jitter(0.5);
    times.jitter_p999_s = impl_->timer->Jitter(0.999);
    times.worst_s = impl_->timer->worst();
  }
  return times;
}

}  // namespace dfr::apps::line_tracking
