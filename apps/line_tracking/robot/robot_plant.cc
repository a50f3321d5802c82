#include "robot/robot_plant.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/hardware/emergency_stop_monitor.h"
#include "dfr/hardware/platform_motion.h"
#include "dfr/hardware/psm_arm.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/robot/real_time_clock.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "robot/run_log.h"
#include "robot/tool_task.h"
#include "robot/turn_about_tip.h"
#include "simulator/lock_step.h"
#include "simulator/simulator_link.h"

namespace dfr::apps::line_tracking {
namespace {

using core::PlantStatus;
using kinematics::PsmJoints;
using line_task::LineTask;
using runtime::HoldReason;

hardware::PsmDriverOptions DriverOptions(const RobotConfig& config) {
  hardware::PsmDriverOptions options;
  options.arm = config.arm;
  options.client = config.arm_client;
  options.teleoperation = config.teleoperation;
  options.servo_cs = config.servo_cs;
  // As in the simulation, controls are small and the arm rests between them.
  options.client.profile = hardware::PsmProfile::kLinear;
  return options;
}

robot::ControlLoopOptions LoopOptions(const RobotConfig& config) {
  robot::ControlLoopOptions options;
  options.period_s = config.period_s;
  options.max_period_s = config.lock_step ? 10.0 : config.max_period_s;
  if (config.lock_step) {
    // Delays of pictures and threads depend on this machine's load. Nothing moves during the wait.
    const double patience_s = std::max(10.0, config.simulator_answer_s);
    options.image_timeout_s = options.max_camera_check_s = options.max_stop_check_s = patience_s;
  } else if (config.simulator) {
    // Only a simulated arm moves. Threads of this machine may be as late as the loop.
    options.max_camera_check_s = std::max(options.max_camera_check_s, config.max_period_s);
    options.max_stop_check_s = std::max(options.max_stop_check_s, config.max_period_s);
  }
  options.image_latency_s = config.image_latency_s;
  options.max_state_jump = config.max_state_jump_mm;
  options.max_drift = config.max_drift_mm;
  options.max_target_jump = config.max_line_jump_mm;
  return options;
}

dds::ParticipantOptions ImageNetwork(dds::ParticipantOptions network) {
  network.name += "-images";
  network.shared_memory = true;
  return network;
}

}  // namespace

Eigen::Isometry3d Base(const RobotConfig& config) {
  return config.p_world_base ? *config.p_world_base : sim::LineTrackingPlant::p_world_base();
}

// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): members in the order of construction.
struct RobotPlant::Impl {
  Impl(const RobotConfig& config, const line_task::LineCalibration& calibration,
       recording::Recorder* recorder, const RunOperator& run_operator)
      : simulated(config.simulator),
        answer_s(config.simulator ? config.simulator_answer_s : 0.0),
        lift_m(config.lift_m),
        image_latency_s(config.image_latency_s),
        generation(config.arm_client.limits.generation),
        task(calibration, Base(config), generation),
        region(task, config.region),
        network(config.network),
        images(ImageNetwork(config.network)),
        driver(network, DriverOptions(config)),
        link(config.simulator ? std::make_unique<SimulatorLink>(network, config.simulator_answer_s)
                              : nullptr),
        lock_step(config.lock_step ? std::make_unique<LockStep>(*link, driver) : nullptr),
        real_time(config.period_s),
        arm(
            driver,
            [this](const PsmJoints& from, const PsmJoints& to) { return Refusal(from, to); },
            run_operator.on_message),
        tool(task, driver, config.speed_m_s),
        log(recorder, driver, config.emergency_stop, run_operator.on_transition),
        stop(network, config.emergency_stop, config.emergency_stop_silence_s,
             config.emergency_stop_datagrams),
        platform(config.platform.device.empty()
                     ? nullptr
                     : std::make_unique<hardware::PlatformMotion>(config.platform)),
        camera(images, config, driver, task, lock_step.get(), recorder),
        loop(LoopOptions(config),
             {.clock = lock_step ? static_cast<robot::Clock*>(lock_step.get()) : &real_time,
              .arm = &arm,
              .camera = &camera,
              .task = &tool,
              .emergency_stop = &stop,
              .recorder = &log,
              .platform = platform.get(),
              .interrupted = run_operator.interrupted}) {}

  [[nodiscard]] const vision::LineObservation& seen() const noexcept { return camera.last().seen; }

  // Returns the reason why the tips must not take this path; empty if they may.
  [[nodiscard]] std::string_view Refusal(const PsmJoints& from, const PsmJoints& to) noexcept {
    const line_task::Breach breach = region.Along(from, to);
    if (!breach.any()) return {};
    std::snprintf(refusal.data(), refusal.size(), "the tip would go %.2f mm beyond %s",
                  1e3 * breach.depth_m, breach.what);
    return refusal.data();
  }

  // A path of straight pieces through joint space, and its purpose in words for the operator.
  struct Leg {
    const char* what;
    std::vector<PsmJoints> way;
  };

  // Throws before any motion unless the arm can follow all legs and the tips stay in their region.
  void Allow(std::span<const Leg> legs) const {
    hardware::PsmMotion motion = driver.client().motion();
    for (const Leg& leg : legs) {
      for (const PsmJoints& joints : leg.way) {
        const line_task::Breach breach = region.Along(motion.setpoint(), joints);
        if (breach.any()) {
          std::ostringstream why;
          why << "the tool cannot be " << leg.what << ": its tip would go " << 1e3 * breach.depth_m
              << " mm beyond " << breach.what << "; move it by hand";
          throw std::runtime_error(why.str());
        }
        const hardware::PsmStatus status =
            motion.Start(joints, 2.0 * motion.ShortestDuration(joints));
        if (status != hardware::PsmStatus::kOk) {
          throw std::runtime_error(std::string("the tool cannot be ") + leg.what + ": " +
                                   hardware::Name(status) + "; move it by hand");
        }
        motion.Rest(joints);
      }
    }
  }

  void Go(const Leg& leg) {
    for (const PsmJoints& joints : leg.way) {
      const double duration_s = 2.0 * driver.client().motion().ShortestDuration(joints);
      if (loop.Move({joints.data(), 6}, duration_s) != PlantStatus::kOk) {
        throw std::runtime_error(std::string("the tool cannot be ") + leg.what + ": " +
                                 loop.cause());
      }
    }
  }

  // Returns a leg that moves the tips straight to their position at `to` while the tool turns.
  [[nodiscard]] Leg Turning(const char* what, const PsmJoints& from,
                            const std::optional<PsmJoints>& to) const {
    const auto way = to ? TurnAboutTip(from, *to, generation) : std::nullopt;
    if (!way) {
      throw std::runtime_error(std::string("the tool cannot be ") + what +
                               " from its present pose; lift or turn it by hand");
    }
    return {what, *way};
  }

  // Turns a tilted tool upright: in place if the angle is small, as after a new calibration.
  // Otherwise lifts the tool, observes the gauze, turns the tool, and lowers the tip to its former
  // position, unless the tip would leave its region above the observed gauze.
  void TurnUpright() {
    PsmJoints upright;
    if (!tool.Upright(upright)) {
      throw std::runtime_error(
          "the arm cannot hold its tool upright in its present pose; move the arm elsewhere");
    }
    constexpr double kUpright = 1e-6;  // rad, m
    constexpr double kLittle = 0.05;   // rad
    const PsmJoints start = driver.client().setpoint();
    if ((upright - start).cwiseAbs().maxCoeff() <= kUpright) return;
    const Eigen::Quaterniond begin(kinematics::Psm::Forward(start).linear());
    const Eigen::Quaterniond end(kinematics::Psm::Forward(upright).linear());
    if (begin.angularDistance(end) <= kLittle) {
      const Leg turn = Turning("turned upright", start, upright);
      Allow({&turn, 1});
      Go(turn);
      return;
    }
    const Eigen::Vector3d up =
        lift_m * (task.p_world_base().linear().transpose() * Eigen::Vector3d::UnitZ());
    const std::optional<PsmJoints> lifted = Displaced(start, up, generation);
    const std::optional<PsmJoints> above = Displaced(upright, up, generation);
    const std::array<Leg, 3> legs = {Turning("lifted", start, lifted),
                                     Turning("turned upright", lifted.value_or(start), above),
                                     Turning("lowered", above.value_or(upright), upright)};
    Allow(legs);
    Go(legs[0]);
    static_cast<void>(loop.Look());
    if (!loop.may_move()) {
      throw std::runtime_error("the tool was lifted, but the robot may not move: " + loop.cause());
    }
    if (!seen().seen()) {
      throw std::runtime_error(
          std::string("the tool was lifted, but its position is not visible in the picture: ") +
          vision::Name(seen().missing));
    }
    region.SetGauze(task.p_world_base() * task.calibration().p_base_cam * seen().p_cam_target);
    try {
      Allow(std::span(legs).subspan(1));
      Go(legs[1]);
      Go(legs[2]);
    } catch (const std::exception&) {
      region.ForgetGauze();
      throw;
    }
    region.ForgetGauze();
  }

  // Runs one period of a robot that is not armed. Another program may move the arm, and the arm
  // need not be ready. Throws for any other reason to hold, because picture or joints are then
  // invalid.
  void TickIdle() {
    loop.Tick();
    const HoldReason found = loop.blocking();
    const bool others = found == HoldReason::kSecondCommander || found == HoldReason::kArmNotReady;
    if (found != HoldReason::kNone && !others) throw std::runtime_error(loop.blocking_words());
    // A second commander or an arm that is not ready hides a fault of the measurements.
    const hardware::PsmClient& client = driver.client();
    const hardware::PsmStatus status = client.hold_reason() == hardware::PsmStatus::kSecondConsole
                                           ? client.hold_reason()
                                           : client.MeasurementHoldReason();
    if (status != hardware::PsmStatus::kOk) {
      throw std::runtime_error(std::string(hardware::Name(status)) + "; " +
                               hardware::Remedy(status));
    }
  }

  // Waits for a new picture while the robot is not armed.
  robot::Camera::Answer ObserveIdle(std::span<double> state, bool marks) {
    TickIdle();  // the request uses the joints
    const std::int64_t after_ns = real_time.WallNs() + std::llround(1e9 * image_latency_s);
    if (marks) {
      camera.AskForMarks(after_ns);
    } else {
      static_cast<void>(camera.Ask(after_ns));
    }
    constexpr int kPatience = 400;  // periods; 2 s with periods of 5 ms
    auto answer = robot::Camera::Answer::kPending;
    for (int n = 0; answer == robot::Camera::Answer::kPending; ++n) {
      TickIdle();
      if (n > kPatience) throw std::runtime_error("no picture arrived; check the camera");
      answer = camera.Take(state);
    }
    return answer;
  }

  void AskForTruth() {
    if (lock_step) {
      truth = link->Truth();
      return;
    }
    if (link) {
      // The loop continues during the wait, because the console may have died.
      static_cast<void>(link->Truth(truth, [this] { return loop.Tick(); }));
      return;
    }
    if (!seen().seen()) return;
    truth.collided = truth.collided || std::abs(seen().distance_m) > LineTask::kCollision;
    truth.progress_m = LineTask::Progress(first_seen, seen());
    truth.completed = !truth.collided && truth.progress_m >= LineTask::kCompletion;
  }

  bool simulated;
  double answer_s;  // timeout of a simulator's answers
  double lift_m;
  double image_latency_s;
  kinematics::PsmGeneration generation;
  LineTask task;
  line_task::TipRegion region;
  dds::Participant network;
  dds::Participant images;
  hardware::PsmDriver driver;
  std::unique_ptr<SimulatorLink> link;
  std::unique_ptr<LockStep> lock_step;
  robot::RealTimeClock real_time;
  std::array<char, 96> refusal{};
  hardware::PsmArm arm;
  ToolTask tool;
  RunLog log;
  hardware::EmergencyStopMonitor stop;
  std::unique_ptr<hardware::PlatformMotion> platform;
  ImageWorker camera;
  robot::ControlLoop loop;

  hardware::Company company;
  vision::LineObservation first_seen;
  SimulatorTruth truth;
};

RobotPlant::RobotPlant(const RobotConfig& config, const line_task::LineCalibration& calibration,
                       recording::Recorder* recorder, const RunOperator& run_operator)
    : impl_(std::make_unique<Impl>(config, calibration, recorder, run_operator)) {
  if (impl_->link) impl_->link->Await(std::max(10.0, config.simulator_answer_s), config.arm);
}

RobotPlant::~RobotPlant() = default;  // the driver tells the console to hold

void RobotPlant::BringUp(const hardware::Say& say, const hardware::Confirms& confirms) {
  Impl& i = *impl_;
  if (i.lock_step) i.link->Reset(0);  // enables and homes the arm
  hardware::BringUp({.loop = &i.loop,
                     .arm = &i.arm,
                     .name = i.driver.arm(),
                     .simulated = i.simulated,
                     .homed = i.lock_step != nullptr,
                     .platform_home_s = i.platform ? hardware::SprkDriver::kHomeTime : 0.0,
                     .accepts_others = [&] { return AcceptsOthers(say, confirms); },
                     .knows_others = [&] { return KnowsOthers(); },
                     .patience_s = std::max(10.0, i.answer_s),
                     .remedy =
                         [&i] {
                           // The remedy for another reason would be misleading.
                           const hardware::PsmStatus found = i.driver.client().hold_reason();
                           const bool blocks = hardware::HoldReasonFor(found) == i.loop.blocking();
                           const std::string remedy = blocks ? hardware::Remedy(found) : "";
                           return (remedy.empty() ? "" : "; " + remedy) +
                                  dds::ExplainRefused(i.network);
                         }},
                    say, confirms);
}

bool RobotPlant::AcceptsOthers(const hardware::Say& say, const hardware::Confirms& confirms) {
  Impl& i = *impl_;
  return i.company.Accepts(i.driver.Requesters(), i.simulated, say, confirms);
}

bool RobotPlant::KnowsOthers() const { return impl_->company.Knows(impl_->driver.Requesters()); }

robot::ControlLoop& RobotPlant::loop() noexcept { return impl_->loop; }
const robot::ControlLoop& RobotPlant::loop() const noexcept { return impl_->loop; }

bool RobotPlant::Clear() noexcept {
  if (impl_->lock_step) impl_->lock_step->Retry();
  return impl_->loop.Clear();
}

const core::StateLayout& RobotPlant::layout() const noexcept { return impl_->task.layout(); }

void RobotPlant::Reset(std::uint64_t seed) {
  Impl& i = *impl_;
  Halt();
  i.loop.Idle(0.05);
  if (i.link) i.link->Reset(seed);
  if (i.lock_step) i.lock_step->Forget();
  i.camera.Forget();
  i.truth = {};
  // States and pictures may be late while a simulator sets up its scene. A robot begins immediately
  // after its operator's confirmation, or not at all.
  if (const HoldReason reason = i.loop.Start(i.lock_step ? i.answer_s
                                             : i.link    ? 3.0
                                                         : 0.0);
      reason != HoldReason::kNone) {
    throw std::runtime_error("the robot is not started: " + (reason == i.loop.blocking()
                                                                 ? i.loop.blocking_words()
                                                                 : i.loop.cause()));
  }
  i.TurnUpright();
  static_cast<void>(i.loop.Look());
  i.first_seen = i.seen();
  i.AskForTruth();
  i.loop.MovePlatform();
}

PlantStatus RobotPlant::Apply(std::span<const double> control) noexcept {
  Impl& i = *impl_;
  if (const PlantStatus status = i.loop.Apply(control); status != PlantStatus::kOk) return status;
  try {
    i.AskForTruth();
  } catch (const std::exception& e) {
    i.loop.Hold(HoldReason::kArmSilent, e.what());
  }
  return i.loop.may_move() ? PlantStatus::kOk : PlantStatus::kFault;
}

void RobotPlant::Observe(std::span<double> state) const noexcept {
  std::ranges::copy(impl_->loop.observation(), state.begin());
}

bool RobotPlant::completed() const noexcept { return impl_->truth.completed; }
bool RobotPlant::collided() const noexcept { return impl_->truth.collided; }

void RobotPlant::Halt() noexcept {
  Impl& i = *impl_;
  if (i.truth.collided) {
    i.loop.Hold(HoldReason::kControllerHalted, "collided");
  } else if (i.truth.completed) {
    i.loop.Complete();
  } else if (!i.seen().seen()) {
    i.loop.Hold(HoldReason::kNotSeen, vision::Name(i.seen().missing));
  } else if (i.loop.may_move()) {
    i.loop.Hold(HoldReason::kOperator, "halted");
  }
  i.loop.Halt();
}

bool RobotPlant::ObserveIdle(std::span<double> state) {
  return impl_->ObserveIdle(state, false) == robot::Camera::Answer::kSeen;
}

vision::CalibrationFrame RobotPlant::CaptureCalibrationFrame() {
  Impl& i = *impl_;
  constexpr double kStill = 1e-4;  // m
  const Eigen::Vector3d before = i.task.Tip(i.driver.client().measured_js().position);
  std::vector<double> none(static_cast<std::size_t>(i.task.layout().state_dim()));
  static_cast<void>(i.ObserveIdle(none, true));
  const PsmJoints joints = i.driver.client().measured_js().position;
  if (!((i.task.Tip(joints) - before).norm() <= kStill))
    throw std::runtime_error("the arm is moving; hold it still");
  const ImageAnswer& answer = i.camera.last();
  if (answer.marks_px.empty()) throw std::runtime_error("the marks are not visible in the picture");
  if (!answer.tip_px.allFinite()) throw std::runtime_error("the tip is not visible in the picture");
  vision::CalibrationFrame frame;
  std::copy_n(joints.data(), 6, frame.joints.begin());
  frame.tip_px = answer.tip_px;
  frame.marks_px = answer.marks_px;
  return frame;
}

const ImageAnswer& RobotPlant::last_image() const noexcept { return impl_->camera.last(); }
double RobotPlant::progress_m() const noexcept { return impl_->truth.progress_m; }
const runtime::PeriodicTimer* RobotPlant::timer() const noexcept {
  return impl_->real_time.timer();
}

}  // namespace dfr::apps::line_tracking
