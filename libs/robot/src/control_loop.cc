#include "dfr/robot/control_loop.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::robot {
namespace {

using core::PlantStatus;
using runtime::HoldReason;
using runtime::RunState;

std::int64_t Ns(double seconds) noexcept { return std::llround(1e9 * seconds); }

std::string InWords(HoldReason reason, std::string_view detail) {
  const std::string name = runtime::Name(reason);
  return detail.empty() ? name : name + ": " + std::string(detail);
}

}  // namespace

ControlLoop::ControlLoop(const ControlLoopOptions& options, const Devices& devices)
    : options_(options),
      devices_(devices),
      machine_({.max_period_s = options.max_period_s, .settle_time_s = options.settle_time_s}) {
  DFR_THROW_UNLESS(devices.clock != nullptr && devices.arm != nullptr &&
                       devices.camera != nullptr && devices.task != nullptr,
                   "a control loop needs a clock, an arm, a camera and a task");
  constexpr double kLongest = 1e6;  // s
  constexpr double kFarthest = std::numeric_limits<double>::max();
  const auto check = [](const char* name, double value, double least, double most) {
    // The comparison is false for NaN.
    DFR_THROW_UNLESS(value >= least && value <= most, "control loop: " << name << " must lie in ["
                                                                       << least << ", " << most
                                                                       << "], not " << value);
  };
  const auto check_positive = [](const char* name, double value, double most) {
    DFR_THROW_UNLESS(value > 0.0 && value <= most,
                     "control loop: " << name << " must lie in (0, " << most << "], not " << value);
  };
  check_positive("period_s", options.period_s, kLongest);
  check("image_latency_s", options.image_latency_s, 0.0, kLongest);
  check_positive("image_timeout_s", options.image_timeout_s, kLongest);
  check("max_images", options.max_images, 1.0, std::numeric_limits<int>::max());
  check_positive("max_camera_check_s", options.max_camera_check_s, kLongest);
  check_positive("max_stop_check_s", options.max_stop_check_s, kLongest);
  check_positive("max_state_jump", options.max_state_jump, kFarthest);
  check("max_drift", options.max_drift, 0.0, kFarthest);
  check("drift_noise", options.drift_noise, 0.0, kFarthest);
  check("drift_share", options.drift_share, 0.0, kFarthest);
  check_positive("drift_stretch", options.drift_stretch, kFarthest);
  check("max_target_jump", options.max_target_jump, 0.0, kFarthest);
  observation_.assign(static_cast<std::size_t>(devices.task->state_dim()),
                      std::numeric_limits<double>::quiet_NaN());
  before_ = observation_;
  moved_.assign(observation_.size(), 0.0);
  way_.assign(kWaypoints, {observation_, moved_});
}

// -- periods --------------------------------------------------------------------------------------

bool ControlLoop::Tick(double dt_s) noexcept {
  const Finding found = devices_.clock->Wait(dt_s);
  machine_.Tick(devices_.clock->SteadyNs());
  machine_.Hold(found.reason, found.detail);
  CheckThreads();
  Report();
  if (devices_.emergency_stop != nullptr) devices_.emergency_stop->Beat(machine_.state());
  return machine_.may_move();
}

void ControlLoop::CheckThreads() noexcept {
  const auto& [clock, arm, camera, task, stop, recorder, platform, interrupted] = devices_;
  const Finding found = arm->Tick(clock->SteadyNs(), clock->WallNs());
  if (!homing_ || !arm->needs_homing()) machine_.Hold(found.reason, found.detail);
  Finding stop_found;
  if (stop != nullptr) {
    const ThreadHealth health = stop->Report();
    stop_pressed_ = health.finding.reason == HoldReason::kEmergencyStop;
    stop_found = CheckThread(health, Ns(options_.max_stop_check_s),
                             {HoldReason::kEmergencyStopSilent, "its listening thread hangs"});
    NoteSilence(stop_found.reason);
  }
  if (!homing_) {  // homing needs no pictures
    static_cast<void>(CheckThread(camera->Report(), Ns(options_.max_camera_check_s),
                                  {HoldReason::kImageSilent, "its processing thread hangs"}));
  }
  if (platform != nullptr) {
    const Finding platform_found = platform->Check();
    machine_.Hold(platform_found.reason, platform_found.detail);
  }
  if (interrupted != nullptr && *interrupted) machine_.Hold(HoldReason::kOperator, "interrupted");
  if (recorder != nullptr && recorder->failed()) {
    machine_.Hold(HoldReason::kRecorder,
                  "the recording cannot be written: check that the disk is not full");
  }
  if (recorder != nullptr) recorder->Period(found, stop_found, machine_.state(), clock->WallNs());
  const bool ends_homing = arm->homing() && machine_.blocking() != HoldReason::kNone;
  if (ends_homing || (!machine_.may_move() && arm->armed())) {
    arm->Hold();
    static_cast<void>(arm->Tick(clock->SteadyNs(), clock->WallNs()));  // holds in this period
  }
}

void ControlLoop::NoteSilence(HoldReason found) noexcept {
  const std::int64_t now_ns = devices_.clock->MachineNs();
  stop_silent_ = found == HoldReason::kEmergencyStopSilent;
  if (stop_silent_ && stop_heard_) stop_silence_ns_ += now_ns - stop_checked_ns_;
  stop_heard_ = stop_heard_ || !stop_silent_;
  stop_checked_ns_ = now_ns;
  if (stop_silence_ns_ == 0) return;
  std::snprintf(silence_detail_.data(), silence_detail_.size(),
                "its messages were overdue for %.2f s", stop_silence_s());
  if (found != HoldReason::kNone) return;
  machine_.Hold(HoldReason::kEmergencyStopSilent, silence_detail_.data());
}

Finding ControlLoop::CheckThread(const ThreadHealth& found, std::int64_t max_check_ns,
                                 const Finding& hangs) noexcept {
  const bool late = devices_.clock->MachineNs() - found.checked_ns > max_check_ns;
  const Finding& finding = late ? hangs : found.finding;
  machine_.Hold(finding.reason, finding.detail);
  return finding;
}

void ControlLoop::RestPlatform() noexcept {
  if (devices_.platform == nullptr || machine_.may_move() || homing_platform_) return;
  const Finding found = devices_.platform->Rest();
  machine_.Hold(found.reason, found.detail);
}

void ControlLoop::Report() noexcept {
  RestPlatform();
  runtime::Transition transition;
  while (machine_.Take(transition)) {
    if (transition.reason != HoldReason::kNone || transition.to == RunState::kArmed) {
      last_reason_ = transition.reason;
      last_detail_ = transition.detail;
    }
    if (devices_.recorder != nullptr) {
      devices_.recorder->Write(transition, devices_.clock->WallNs());
    }
  }
}

void ControlLoop::Idle(double seconds) noexcept {
  const int periods = static_cast<int>(std::ceil(seconds / options_.period_s));
  for (int n = 0; n < periods; ++n) Tick();
}

bool ControlLoop::AwaitReady(double timeout_s, const std::function<void(std::string_view)>& say) {
  return Await(timeout_s, say);
}

bool ControlLoop::AwaitHomeable(double timeout_s,
                                const std::function<void(std::string_view)>& say) {
  homing_ = true;
  const bool ready = Await(timeout_s, say);
  homing_ = false;
  return ready;
}

bool ControlLoop::Await(double timeout_s, const std::function<void(std::string_view)>& say) {
  const std::int64_t start_ns = devices_.clock->MachineNs();
  Idle(options_.settle_time_s +
       0.05);  // long enough for the state machine to detect reasons to hold
  for (bool said = false;; Idle(0.1)) {
    if (blocking() == HoldReason::kNone) return true;
    if (blocking() == HoldReason::kEmergencyStop) return false;
    if (stop_silence_ns_ > 0 && !stop_silent_) return false;
    if (devices_.interrupted != nullptr && *devices_.interrupted) return false;
    const std::int64_t waited_ns = devices_.clock->MachineNs() - start_ns;
    if (waited_ns > Ns(timeout_s)) return false;
    if (!said && waited_ns > Ns(1.0)) {
      if (say) say("waiting: " + blocking_words());
      said = true;
    }
  }
}

// -- commands of the operator, the controller and the task ----------------------------------------

HoldReason ControlLoop::Home() noexcept {
  if (devices_.arm->armed()) return HoldReason::kOperator;
  homing_ = true;
  const HoldReason reason = TryToHome();
  homing_ = false;
  return reason;
}

HoldReason ControlLoop::TryToHome() noexcept {
  Idle(options_.settle_time_s + 0.05);
  if (blocking() != HoldReason::kNone || !devices_.arm->needs_homing()) return blocking();
  if (const Finding refused = devices_.arm->Home(); !refused.ok()) {
    Hold(refused.reason, refused.detail);
    return refused.reason;
  }
  do {
    Tick();
    if (blocking() != HoldReason::kNone) return blocking();
  } while (devices_.arm->homing());
  return HoldReason::kNone;
}

HoldReason ControlLoop::HomePlatform(double duration_s) noexcept {
  if (blocking() != HoldReason::kNone || devices_.platform == nullptr) return blocking();
  homing_platform_ = true;
  const Finding refused = devices_.platform->Home();
  Hold(refused.reason, refused.detail);
  const int periods = static_cast<int>(std::ceil(duration_s / options_.period_s));
  for (int n = 0; n < periods && blocking() == HoldReason::kNone; ++n) Tick();
  homing_platform_ = false;
  Report();  // stops the platform
  return blocking();
}

void ControlLoop::MovePlatform() noexcept {
  if (devices_.platform == nullptr || !may_move()) return;
  const Finding refused = devices_.platform->Begin();
  Hold(refused.reason, refused.detail);
}

HoldReason ControlLoop::TryToStart() noexcept {
  Idle(options_.settle_time_s + 0.05);
  if (!machine_.Arm()) {
    if (blocking() != HoldReason::kNone) return blocking();
    return last_reason_ != HoldReason::kNone ? last_reason_ : HoldReason::kOperator;
  }
  if (const Finding refused = devices_.arm->Arm(); !refused.ok()) {
    Hold(refused.reason, refused.detail);
    return refused.reason;
  }
  devices_.task->Begin();
  static_cast<void>(machine_.Start());
  Report();
  return HoldReason::kNone;
}

HoldReason ControlLoop::Start(double patience_s) noexcept {
  const std::int64_t end_ns = devices_.clock->MachineNs() + Ns(patience_s);
  HoldReason reason = TryToStart();
  while (reason != HoldReason::kNone && state() != RunState::kFaulted &&
         devices_.clock->MachineNs() < end_ns) {
    reason = TryToStart();
  }
  return reason;
}

bool ControlLoop::Clear() noexcept {
  constexpr double kForgetting = 0.05;  // s, until the stop has forgotten silent buttons
  if (devices_.emergency_stop != nullptr) devices_.emergency_stop->Acknowledge();
  Idle(kForgetting);
  stop_silence_ns_ = 0;
  Idle(options_.settle_time_s + 0.05);
  const bool cleared =
      state() == RunState::kIdle ? blocking() == HoldReason::kNone : machine_.Clear();
  Report();
  return cleared;
}

void ControlLoop::Hold(HoldReason reason, std::string_view detail) noexcept {
  machine_.Hold(reason, detail);
  Report();
}

void ControlLoop::Complete() noexcept {
  machine_.Done();
  Report();
}

void ControlLoop::Decided(const control::Step& step) noexcept {
  using control::Mode;
  machine_.Recovering(step.mode == Mode::kProbe || step.mode == Mode::kRecovery);
  if (step.mode == Mode::kHalt) {
    machine_.Hold(step.cause == control::HaltCause::kControlInvalid ? HoldReason::kControlInvalid
                                                                    : HoldReason::kControllerHalted,
                  control::Name(step.cause));
  }
  Report();
}

// -- motion ---------------------------------------------------------------------------------------

PlantStatus ControlLoop::Refuse(const Finding& why) noexcept {
  Hold(why.reason, why.detail);
  return PlantStatus::kRefused;
}

PlantStatus ControlLoop::Apply(std::span<const double> control) noexcept {
  if (control.size() != static_cast<std::size_t>(devices_.task->control_dim()) ||
      !std::all_of(control.begin(), control.end(), [](double u) { return std::isfinite(u); })) {
    return Refuse({HoldReason::kControlInvalid});
  }
  if (!may_move()) return PlantStatus::kFault;
  const std::optional<Motion> motion = devices_.task->Plan(control);
  if (!motion) return Refuse({HoldReason::kCommandRefused, "the arm cannot reach the target"});
  const PlantStatus status = Move(motion->joints, motion->duration_s);
  if (status != PlantStatus::kOk) return status;
  std::copy(observation_.begin(), observation_.end(), before_.begin());
  if (!Observe()) return PlantStatus::kFault;
  if (Jumped(motion->change)) {
    Hold(HoldReason::kStateJump, "the tip is not where the control should have taken it");
  } else if (TargetJumped(motion->change)) {
    Hold(HoldReason::kStateJump, "the line moves faster than the loop can follow");
  }
  if (Drifted(motion->change)) {
    Hold(HoldReason::kImageInvalid, "the pictures do not show the arm's motion");
  }
  return may_move() ? PlantStatus::kOk : PlantStatus::kFault;
}

PlantStatus ControlLoop::Move(std::span<const double> joints, double duration_s) noexcept {
  const auto& [clock, arm, camera, task, stop, recorder, platform, interrupted] = devices_;
  if (const Finding refused = arm->MoveTo(joints, duration_s); !refused.ok()) {
    return Refuse(refused);
  }
  const double dt_s = duration_s / std::max(1.0, std::ceil(duration_s / options_.period_s - 1e-9));
  while (arm->moving()) {
    if (!Tick(dt_s)) return PlantStatus::kFault;
  }
  if (clock->lock_step()) {
    // The arm has not reached the last set-point: time must advance.
    if (!Tick(dt_s)) return PlantStatus::kFault;
    if (const Finding lost = clock->Rest(); !lost.ok()) {
      Hold(lost.reason, lost.detail);
      return PlantStatus::kFault;
    }
  }
  while (!arm->at_rest()) {
    if (!Tick()) return PlantStatus::kFault;
  }
  return PlantStatus::kOk;
}

bool ControlLoop::Look() noexcept {
  const bool looked = Observe();
  way_size_ = way_next_ = 0;
  std::fill(moved_.begin(), moved_.end(), 0.0);
  Remember();
  return looked;
}

bool ControlLoop::Observe() noexcept {
  const auto& [clock, arm, camera, task, stop, recorder, platform, interrupted] = devices_;
  for (int image = 0; image < options_.max_images; ++image) {
    if (const Finding found = camera->Ask(clock->WallNs() + Ns(options_.image_latency_s));
        !found.ok()) {
      Hold(found.reason, found.detail);
      return false;
    }
    const std::int64_t end_ns = clock->MachineNs() + Ns(options_.image_timeout_s);
    Camera::Answer answer = camera->Take(observation_);
    while (answer == Camera::Answer::kPending) {
      if (clock->MachineNs() > end_ns) {
        Hold(HoldReason::kImageSilent, "no picture arrived to measure the state");
        return false;
      }
      if (!Tick()) return false;
      answer = camera->Take(observation_);
    }
    if (answer == Camera::Answer::kSeen) break;
  }
  return true;
}

bool ControlLoop::Jumped(std::span<const double> change) const noexcept {
  double squared = 0.0;
  for (std::size_t k = 0; k < change.size(); ++k) {
    const double off = observation_[k] - before_[k] - change[k];
    squared += off * off;
  }
  return std::sqrt(squared) > options_.max_state_jump;  // false if no state was observed
}

bool ControlLoop::TargetJumped(std::span<const double> change) const noexcept {
  double squared = 0.0;
  for (const double entry : change) squared += entry * entry;
  const double most = options_.max_target_jump + std::sqrt(squared);
  for (std::size_t k = change.size(); k < observation_.size(); ++k) {
    if (std::abs(observation_[k] - before_[k]) > most) return true;
  }
  return false;
}

void ControlLoop::Remember() noexcept {
  if (!std::isfinite(observation_[0])) return;  // no observation
  Waypoint& waypoint = way_[way_next_];
  std::copy(observation_.begin(), observation_.end(), waypoint.state.begin());
  std::copy(moved_.begin(), moved_.end(), waypoint.moved.begin());
  way_next_ = (way_next_ + 1) % kWaypoints;
  way_size_ = std::min(way_size_ + 1, kWaypoints);
  since_waypoint_ = 0.0;
}

bool ControlLoop::Drifted(std::span<const double> change) noexcept {
  double squared = 0.0;
  for (std::size_t k = 0; k < change.size(); ++k) {
    moved_[k] += change[k];
    squared += change[k] * change[k];
  }
  since_waypoint_ += std::sqrt(squared);
  if (!std::isfinite(observation_[0])) return false;
  bool drifted = false;
  for (std::size_t i = 0; i < way_size_; ++i) {
    double off = 0.0;
    double way = 0.0;
    for (std::size_t k = 0; k < change.size(); ++k) {
      const double moved = moved_[k] - way_[i].moved[k];
      const double error = observation_[k] - way_[i].state[k] - moved;
      off += error * error;
      way += moved * moved;
    }
    if (way > options_.drift_stretch * options_.drift_stretch) continue;
    const double most =
        std::min(options_.max_drift, options_.drift_noise + options_.drift_share * std::sqrt(way));
    drifted = drifted || std::sqrt(off) > most;
  }
  if (way_size_ == 0 || since_waypoint_ >= options_.drift_stretch / kWaypoints) Remember();
  return drifted;
}

void ControlLoop::Halt() noexcept {
  if (devices_.arm->armed()) devices_.arm->Hold();
  Tick();
}

// -- state ----------------------------------------------------------------------------------------

bool ControlLoop::ended_regularly() const noexcept {
  return state() != RunState::kFaulted &&
         (last_reason_ == HoldReason::kNone || last_reason_ == HoldReason::kControllerHalted ||
          last_reason_ == HoldReason::kNotSeen);
}

std::string ControlLoop::cause() const { return InWords(last_reason_, last_detail_.data()); }

std::string ControlLoop::silence_words() const {
  return InWords(HoldReason::kEmergencyStopSilent, silence_detail_.data());
}

std::string ControlLoop::blocking_words() const {
  return InWords(machine_.blocking(), machine_.blocking_detail());
}

}  // namespace dfr::robot
