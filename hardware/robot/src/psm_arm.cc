#include "dfr/hardware/psm_arm.h"

#include <cstdio>

namespace dfr::hardware {
namespace {

robot::Finding ArmFinding(PsmStatus status) noexcept {
  return {HoldReasonFor(status), Name(status)};
}

}  // namespace

robot::Finding PsmArm::Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept {
  const bool was_active = armed() || homing();
  const PsmStatus status = driver_->Tick(steady_ns, wall_ns);
  if (ConsoleMessage message; on_message_) {
    while (driver_->TakeMessage(message)) on_message_(message);
  }
  // For an inactive driver, status() would be the cause of an earlier hold. Reports instead the
  // present reason that prevents arming.
  found_ = was_active ? status : driver_->client().hold_reason();
  has_just_held_ = was_active && driver_->phase() == PsmPhase::kHolding;
  if (found_ == PsmStatus::kHeld) return {};  // held by this program, which has the reason
  const bool says_why = found_ == PsmStatus::kConsoleFault || found_ == PsmStatus::kConsoleError;
  const std::string_view error = says_why ? driver_->last_error()
                                 : driver_->held_by_others() && !driver_->who().empty()
                                     ? SaidBy(driver_->who())
                                     : std::string_view();
  return {HoldReasonFor(found_), error.empty() ? Name(found_) : error};
}

// Returns the reason and the participant that caused it.
std::string_view PsmArm::SaidBy(std::string_view who) noexcept {
  const char* const what = found_ == PsmStatus::kForeignMessage   ? "commanded the arm"
                           : found_ == PsmStatus::kOtherPublisher ? "can command the arm"
                           : found_ == PsmStatus::kForeignControl
                               ? "the console obeyed another program"
                               : "has just joined";
  std::snprintf(said_.data(), said_.size(), "%s: %.*s", what, static_cast<int>(who.size()),
                who.data());
  return said_.data();
}

bool PsmArm::needs_homing() const noexcept {
  if (has_just_held_) return false;  // the finding is the cause, such as an arm switched off
  return found_ == PsmStatus::kDisabled || found_ == PsmStatus::kNotHomed ||
         found_ == PsmStatus::kStateInvalid || (found_ == PsmStatus::kBusy && homing());
}

robot::Finding PsmArm::Home() noexcept { return ArmFinding(driver_->Home()); }

robot::Finding PsmArm::Arm() noexcept { return ArmFinding(driver_->Arm()); }

robot::Finding PsmArm::MoveTo(std::span<const double> joints, double duration_s) noexcept {
  const kinematics::PsmJoints goal(Eigen::Map<const kinematics::PsmJoints>(joints.data()));
  if (const std::string_view refused = check_(driver_->client().setpoint(), goal);
      !refused.empty()) {
    return {runtime::HoldReason::kCommandRefused, refused};
  }
  const PsmStatus status = driver_->MoveTo(goal, duration_s);
  if (status == PsmStatus::kOk) return {};
  return {runtime::HoldReason::kCommandRefused, Name(status)};
}

}  // namespace dfr::hardware
