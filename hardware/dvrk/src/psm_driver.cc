#include "dfr/hardware/psm_driver.h"

#include <semaphore.h>

#include <string>

#include "dfr/core/contract.h"
#include "dfr/runtime/periodic_timer.h"
#include "psm_link.h"

namespace dfr::hardware {
namespace {

using internal::Outgoing;
using internal::Who;

}  // namespace

const char* Name(ConsoleMessage::Severity severity) noexcept {
  switch (severity) {
    case ConsoleMessage::Severity::kError:
      return "error";
    case ConsoleMessage::Severity::kWarning:
      return "warning";
    case ConsoleMessage::Severity::kStatus:
      return "status";
  }
  return "unknown";
}

PsmDriver::PsmDriver(dds::Participant& participant, const PsmDriverOptions& options)
    : arm_(options.arm), client_(options.client) {
  DFR_THROW_UNLESS(
      !options.arm.empty() && options.arm.front() != '/',
      "arm must be the arm's name without a slash, such as PSM1, not '" << options.arm << "'");
  link_ = std::make_unique<Link>(participant, options);
}

PsmDriver::~PsmDriver() {
  if (client_.phase() == PsmPhase::kArmed || client_.homing()) link_->hold_wanted.Want();
  if (client_.homing()) {
    Outgoing disable;
    disable.request = PsmRequest::kDisable;
    disable.stamp = dds::Stamp::Now();
    if (!link_->outbox.Put(disable)) link_->disable_wanted.Want();
  }
}

PsmStatus PsmDriver::Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept {
  Link& link = *link_;
  PsmInput input;
  link.tick_ns.store(steady_ns, std::memory_order_relaxed);
  (void)link.new_error.Take(last_error_);
  // Newcomers are read before the number of publishers, which is therefore at least as recent.
  input.newcomers = link.newcomers.exchange(0, std::memory_order_acq_rel);
  const auto take = [](auto& mailbox, auto& entry) {
    if (!mailbox.Take(entry.emplace())) entry.reset();
  };
  take(link.new_operating, input.operating_state);
  take(link.new_measured_js, input.measured_js);
  take(link.new_setpoint_js, input.setpoint_js);
  take(link.new_measured_cp, input.measured_cp);
  take(link.new_local_cp, input.local_measured_cp);
  take(link.new_jaw_measured, input.jaw_measured);
  take(link.new_jaw_setpoint, input.jaw_setpoint);
  input.errors = link.num_errors.exchange(0, std::memory_order_acq_rel);
  input.state_publishers = state_publishers_ =
      link.state_publishers.load(std::memory_order_relaxed);
  input.incompatible = link.incompatible.load(std::memory_order_relaxed);
  input.other_publishers = other_publishers_ =
      link.other_publishers.load(std::memory_order_relaxed);
  servo_subscribers_ = link.servo_subscribers.load(std::memory_order_relaxed);
  input.command_subscribers = request_subscribers_ =
      link.command_subscribers.load(std::memory_order_relaxed);
  hold_subscribers_ = link.hold_subscribers.load(std::memory_order_relaxed);
  input.goals_reached = link.goals_reached.exchange(0, std::memory_order_acq_rel);
  input.foreign_messages = link.foreign_messages.exchange(0, std::memory_order_acq_rel);
  input.pose_controls = link.pose_controls.exchange(0, std::memory_order_acq_rel);
  input.other_controls = link.other_controls.exchange(0, std::memory_order_acq_rel);
  input.tool_changes = link.tool_changes.exchange(0, std::memory_order_acq_rel);
  input.instrument = link.instrument.load(std::memory_order_acquire);
  input.teleoperated = link.was_teleoperated.exchange(false, std::memory_order_acq_rel);
  input.teleoperated = link.is_teleoperated.load(std::memory_order_acquire) || input.teleoperated;
  input.clutched = link.was_clutched.exchange(false, std::memory_order_acq_rel);
  input.clutched = link.is_clutched.load(std::memory_order_acquire) || input.clutched;
  input.send_failed = link.failed.exchange(false, std::memory_order_relaxed);

  // Keeps the first participant that made the arm hold.
  const bool was_held = held_by_others();
  if (Who who; link.new_who.Take(who) && !was_held) who_ = who.text;
  if (Who who; link.new_control.Take(who)) control_ = who.text;
  const PsmOutput output = client_.Step(input, steady_ns, wall_ns);
  if (!was_held && held_by_others() && status() == PsmStatus::kForeignControl) who_ = control_;
  if (output.hold) link.hold_wanted.Want();  // before the request that the hold precedes
  if (output.servo || output.servo_jaw || output.request != PsmRequest::kNone) {
    Outgoing next;
    next.servo = output.servo;
    next.position_m = output.servo_cp.translation();
    next.orientation = Eigen::Quaterniond(output.servo_cp.linear());
    next.twist = output.twist;
    next.servo_jaw = output.servo_jaw;
    next.jaw = output.jaw;
    next.request = output.request;
    next.stamp = dds::Stamp::FromNanoseconds(wall_ns);
    if (!link.outbox.Put(next)) {
      link.failed.store(true, std::memory_order_relaxed);
      if (output.request == PsmRequest::kDisable) link.disable_wanted.Want();
    }
  }
  ::sem_post(&link.wake);
  return status();
}

PsmStatus PsmDriver::Tick() noexcept {
  return Tick(runtime::SteadyNow(), dds::Stamp::Now().nanoseconds());
}

bool PsmDriver::TakeMessage(ConsoleMessage& message) noexcept {
  return link_->messages.Take(message);
}

bool PsmDriver::held_by_others() const noexcept {
  const PsmStatus now = status();
  return client_.phase() == PsmPhase::kHolding &&
         (now == PsmStatus::kNewcomer || now == PsmStatus::kForeignMessage ||
          now == PsmStatus::kOtherPublisher || now == PsmStatus::kForeignControl);
}

std::vector<dds::Newcomer> PsmDriver::Requesters() const {
  return link_->p.OthersPublishers(
      [this](std::string_view topic) { return link_->Requests(topic); });
}

std::string PsmDriver::Explain() const {
  const PsmStatus now = status();
  std::string text = arm_ + ": " + Name(now);
  if ((now == PsmStatus::kConsoleFault || now == PsmStatus::kConsoleError ||
       now == PsmStatus::kTimedOut) &&
      !last_error().empty()) {
    text += " (\"" + std::string(last_error()) + "\")";
  }
  if (held_by_others() && !who().empty()) text += " (" + std::string(who()) + ")";
  if (*Remedy(now) != '\0') text += std::string("; ") + Remedy(now);
  return text;
}

std::uint64_t PsmDriver::setpoints_sent() const noexcept {
  return link_->sent.load(std::memory_order_acquire);
}

void PsmDriver::Flush() {
  const std::uint64_t wanted = link_->cycle_wanted.fetch_add(1, std::memory_order_acq_rel) + 1;
  ::sem_post(&link_->wake);
  for (std::uint64_t done = link_->cycle_done.load(std::memory_order_acquire); done < wanted;
       done = link_->cycle_done.load(std::memory_order_acquire)) {
    link_->cycle_done.wait(done, std::memory_order_acquire);
  }
}

}  // namespace dfr::hardware
