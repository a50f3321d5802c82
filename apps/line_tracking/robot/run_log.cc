#include "robot/run_log.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <span>
#include <string_view>

#include "dfr/kinematics/psm.h"

namespace dfr::apps::line_tracking {

using runtime::HoldReason;

void RunLog::Write(const runtime::Transition& transition, std::int64_t wall_ns) noexcept {
  if (recorder_ != nullptr) {
    recording::TransitionRecord record;
    record.time_ns = wall_ns;
    record.from = runtime::Name(transition.from);
    record.to = runtime::Name(transition.to);
    const bool reasoned = transition.reason != HoldReason::kNone;
    std::array<char, 160> text{};
    const int size = std::snprintf(text.data(), text.size(), "%s%s%s",
                                   reasoned ? runtime::Name(transition.reason) : "",
                                   reasoned ? ": " : "", transition.detail.data());
    record.cause = std::string_view(text.data(), static_cast<std::size_t>(std::max(0, size)));
    static_cast<void>(recorder_->Transition(record));
  }
  if (on_transition_) on_transition_(transition);
}
void RunLog::Period(const robot::Finding& arm, const robot::Finding& stop, runtime::RunState state,
                    std::int64_t wall_ns) noexcept {
  if (recorder_ == nullptr) return;
  const hardware::PsmClient& client = driver_->client();
  // Records each new sample of the arm, and changes between two samples.
  const bool same = client.num_samples() == num_samples_ && arm.reason == arm_ &&
                    stop.reason == stop_ && state == state_;
  if (same) return;
  num_samples_ = client.num_samples();
  arm_ = arm.reason;
  stop_ = stop.reason;
  state_ = state;
  recording::ArmRecord record;
  record.time_ns = wall_ns;
  record.measured_ns = client.measured_js().stamp.nanoseconds();
  const auto joints = [](const kinematics::PsmJoints& q) { return std::span(q.data(), 6); };
  record.position.Assign(joints(client.measured_js().position));
  record.velocity.Assign(joints(client.measured_js().velocity));
  if (client.phase() == hardware::PsmPhase::kArmed) {
    record.setpoint.Assign(joints(client.setpoint()));
  }
  record.console_setpoint.Assign(joints(client.setpoint_js().position));
  record.operating_state = hardware::Name(client.operating_state().state);
  record.homed = client.operating_state().homed;
  record.busy = client.operating_state().busy;
  record.machine = runtime::Name(state);
  if (!arm.ok()) {
    std::array<char, 96> fault{};
    std::snprintf(fault.data(), fault.size(), "%s: %.*s", runtime::Name(arm.reason),
                  static_cast<int>(arm.detail.size()), arm.detail.data());
    record.fault = std::string_view(fault.data());
  }
  record.stop = !stop_required_                             ? "none"
                : stop.ok()                                 ? "released"
                : stop.reason == HoldReason::kEmergencyStop ? "pressed"
                                                            : "silent";
  static_cast<void>(recorder_->Arm(record));
}

}  // namespace dfr::apps::line_tracking
