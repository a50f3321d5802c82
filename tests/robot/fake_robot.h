#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <utility>

#include "dfr/robot/control_loop.h"

namespace dfr::test {

inline constexpr std::int64_t kPeriodNs = 5'000'000;

/// A clock that advances by one period per Wait(), and runs planned actions at their times.
class FakeClock final : public robot::Clock {
 public:
  robot::Finding Wait(double dt_s) noexcept override {
    now_ns += std::llround(1e9 * dt_s) + std::exchange(late_ns, 0);
    ++periods;
    if (plan && now_ns >= plan_ns) std::exchange(plan, nullptr)();
    return found;
  }
  std::int64_t SteadyNs() const noexcept override { return now_ns; }
  std::int64_t WallNs() const noexcept override { return 1'700'000'000'000'000'000 + now_ns; }
  std::int64_t MachineNs() const noexcept override { return now_ns; }
  bool lock_step() const noexcept override { return in_lock_step; }
  robot::Finding Rest() noexcept override {
    ++rests;
    return at_rest;
  }

  std::int64_t now_ns = 1'000'000'000;
  std::int64_t late_ns = 0;  // delay of the next period
  int periods = 0;
  int rests = 0;
  bool in_lock_step = false;
  robot::Finding found;
  robot::Finding at_rest;
  std::int64_t plan_ns = 0;
  std::function<void()> plan;
};

/// An arm with two joints that comes to rest `lag` periods after the end of a motion.
class FakeArm final : public robot::Manipulator {
 public:
  robot::Finding Tick(std::int64_t steady_ns, std::int64_t /*wall_ns*/) noexcept override {
    if (hold_wanted_ && armed_) held_ns = steady_ns;
    if (hold_wanted_ || !found.ok()) armed_ = false;
    if (hold_wanted_ && homing_in_ > 0) {
      disabled_ns = steady_ns;
      homing_in_ = 0;
    }
    hold_wanted_ = false;
    if (homing_in_ > 0 && --homing_in_ == 0) unhomed = false;
    if (unhomed && found.ok()) {
      needs_homing_ = true;
      return {runtime::HoldReason::kArmNotReady, "DISABLED"};
    }
    needs_homing_ = false;
    if (moving_ && armed_) {
      // The arm sends one set-point in each period of a motion.
      ++setpoints;
      moving_ = ++sent_ < steps;
      if (!moving_) at = goal_;
      rest_in_ = lag;
    } else if (rest_in_ > 0) {
      --rest_in_;
    }
    return found;
  }
  bool needs_homing() const noexcept override { return needs_homing_; }
  robot::Finding Home() noexcept override {
    ++homings;
    homing_in_ = homing_takes;
    return {};
  }
  bool homing() const noexcept override { return homing_in_ > 0; }
  robot::Finding Arm() noexcept override {
    if (!refuses_arm.ok()) return refuses_arm;
    armed_ = true;
    moving_ = false;
    return {};
  }
  void Hold() noexcept override { hold_wanted_ = true; }
  robot::Finding MoveTo(std::span<const double> joints, double duration_s) noexcept override {
    if (!refuses_motion.ok()) return refuses_motion;
    std::copy(joints.begin(), joints.end(), goal_.begin());
    steps = static_cast<int>(std::lround(duration_s / 0.005));
    sent_ = 0;
    moving_ = true;
    return {};
  }
  bool armed() const noexcept override { return armed_; }
  bool moving() const noexcept override { return moving_; }
  bool at_rest() const noexcept override { return armed_ && !moving_ && rest_in_ == 0; }

  robot::Finding found;
  robot::Finding refuses_arm;
  robot::Finding refuses_motion;
  std::array<double, 2> at{};
  std::int64_t held_ns = 0;
  int setpoints = 0;
  int steps = 0;
  int lag = 3;
  bool unhomed = false;
  int homings = 0;
  int homing_takes = 200;
  std::int64_t disabled_ns = 0;  // time at which homing was interrupted

 private:
  bool needs_homing_ = false;
  int homing_in_ = 0;
  std::array<double, 2> goal_{};
  bool armed_ = false;
  bool hold_wanted_ = false;
  bool moving_ = false;
  int sent_ = 0;
  int rest_in_ = 0;
};

/// Shows the arm's position `delay` periods after a request.
class FakeCamera final : public robot::Camera {
 public:
  FakeCamera(const FakeClock& clock, const FakeArm& arm) : clock_(&clock), arm_(&arm) {}

  robot::ThreadHealth Report() noexcept override {
    if (!hangs) checked_ns_ = clock_->now_ns;
    return {found, checked_ns_};
  }
  robot::Finding Ask(std::int64_t asked_after_ns) noexcept override {
    ++questions;
    after_ns = asked_after_ns;
    asked_in_ = clock_->periods;
    return refuses;
  }
  Answer Take(std::span<double> state) noexcept override {
    if (blind || clock_->periods < asked_in_ + delay) return Answer::kPending;
    if (unseen > 0) {
      --unseen;
      std::fill(state.begin(), state.end(), std::numeric_limits<double>::quiet_NaN());
      return Answer::kNotSeen;
    }
    if (!frozen) picture_ = shown_[static_cast<std::size_t>(std::max(0, pictures_late - 1))];
    if (!frozen && pictures_late == 0) picture_ = arm_->at;
    std::copy_backward(shown_.begin(), shown_.end() - 1, shown_.end());
    shown_[0] = arm_->at;
    state[0] = scale * 1e3 * picture_[0] + off[0];
    state[1] = scale * 1e3 * picture_[1] + off[1];
    if (state.size() > 2) state[2] = target;
    return Answer::kSeen;
  }

  robot::Finding found;
  robot::Finding refuses;
  bool hangs = false;
  bool blind = false;
  int unseen = 0;
  int delay = 4;
  int questions = 0;
  std::int64_t after_ns = 0;
  std::array<double, 2> off{};
  double scale = 1.0;
  double target = 0.0;    // third entry of a state with three entries
  bool frozen = false;    // repeats the last picture from now on
  int pictures_late = 0;  // delay of pictures, as a number of requests

 private:
  const FakeClock* clock_;
  const FakeArm* arm_;
  std::array<std::array<double, 2>, 8> shown_{};  // newest first
  std::array<double, 2> picture_{};
  std::int64_t checked_ns_ = 0;
  int asked_in_ = 0;
};

class FakeStop final : public robot::EmergencyStop {
 public:
  explicit FakeStop(const FakeClock& clock) : clock_(&clock) {}

  robot::ThreadHealth Report() noexcept override {
    if (!hangs) checked_ns_ = clock_->now_ns;
    latched_ = latched_ || pressed;
    if (latched_) return {{runtime::HoldReason::kEmergencyStop, "pressed"}, checked_ns_};
    return {found, checked_ns_};
  }
  void Beat(runtime::RunState state) noexcept override {
    ++beats;
    told = state;
  }
  void Acknowledge() noexcept override {
    ++acknowledged;
    latched_ = false;
  }

  robot::Finding found;
  bool pressed = false;  // remains found after the release, until it is acknowledged
  bool hangs = false;
  int beats = 0;
  int acknowledged = 0;
  runtime::RunState told = runtime::RunState::kIdle;

 private:
  const FakeClock* clock_;
  bool latched_ = false;
  std::int64_t checked_ns_ = 0;
};

class FakeRecorder final : public robot::Recorder {
 public:
  void Write(const runtime::Transition& transition, std::int64_t wall_ns) noexcept override {
    last = transition;
    last_wall_ns = wall_ns;
    ++written;
  }
  void Period(const robot::Finding& arm, const robot::Finding& stop, runtime::RunState state,
              std::int64_t /*wall_ns*/) noexcept override {
    ++periods;
    last_arm = arm.reason;
    last_stop = stop.reason;
    last_state = state;
  }
  bool failed() const noexcept override { return fails; }

  bool fails = false;
  int periods = 0;
  runtime::HoldReason last_arm = runtime::HoldReason::kNone;
  runtime::HoldReason last_stop = runtime::HoldReason::kNone;
  runtime::RunState last_state = runtime::RunState::kIdle;
  int written = 0;
  runtime::Transition last;
  std::int64_t last_wall_ns = 0;
};

/// Controls are displacements of the two joints in mm, carried out at 1 mm per 10 periods.
class FakeTask final : public robot::Task {
 public:
  FakeTask(const FakeArm& arm, int dim) : arm_(&arm), dim_(dim) {}

  int state_dim() const noexcept override { return dim_; }
  int control_dim() const noexcept override { return 2; }
  void Begin() noexcept override { command_ = arm_->at; }
  std::optional<robot::Motion> Plan(std::span<const double> control) noexcept override {
    if (unreachable) return std::nullopt;
    std::copy(control.begin(), control.end(), change_.begin());
    for (std::size_t k = 0; k < 2; ++k) command_[k] += 1e-3 * control[k];
    return robot::Motion{command_, 0.05 * std::hypot(control[0], control[1]), change_};
  }

  bool unreachable = false;

 private:
  const FakeArm* arm_;
  int dim_;
  std::array<double, 2> command_{};
  std::array<double, 2> change_{};
};

class FakePlatform final : public robot::Platform {
 public:
  robot::Finding Check() noexcept override { return found; }
  robot::Finding Home() noexcept override {
    moves = true;
    ++homings;
    return refuses;
  }
  robot::Finding Begin() noexcept override {
    moves = true;
    ++begins;
    return refuses;
  }
  robot::Finding Rest() noexcept override {
    if (moves) rested_ns = clock_->now_ns;
    if (fails.ok()) moves = false;
    return moves ? fails : robot::Finding{};
  }
  explicit FakePlatform(const FakeClock& clock) : clock_(&clock) {}

  robot::Finding found;
  robot::Finding refuses;
  robot::Finding fails;
  bool moves = false;
  int homings = 0;
  int begins = 0;
  std::int64_t rested_ns = 0;

 private:
  const FakeClock* clock_;
};

/// A control loop with fakes for all of its devices.
struct FakeRobot {
  explicit FakeRobot(const robot::ControlLoopOptions& options = {}, int state_dim = 2)
      : task(arm, state_dim),
        loop(options, {.clock = &clock,
                       .arm = &arm,
                       .camera = &camera,
                       .task = &task,
                       .emergency_stop = &stop,
                       .recorder = &recorder,
                       .platform = &platform,
                       .interrupted = &interrupted}) {}

  FakeClock clock;
  FakeArm arm;
  FakeCamera camera{clock, arm};
  FakeTask task;
  FakeStop stop{clock};
  FakeRecorder recorder;
  FakePlatform platform{clock};
  std::atomic<bool> interrupted = false;
  robot::ControlLoop loop;
};

}  // namespace dfr::test
