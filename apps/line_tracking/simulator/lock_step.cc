#include "simulator/lock_step.h"

#include <stdexcept>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::line_tracking {

using runtime::HoldReason;

std::int64_t LockStep::MachineNs() const noexcept { return runtime::SteadyNow(); }

// Converts an exception from `ask` to the reason `otherwise`. Does not call `ask` again after that.
template <typename F>
robot::Finding LockStep::Try(HoldReason otherwise, const F& ask) noexcept {
  if (lost_) return {otherwise, "the simulator does not answer"};
  try {
    ask();
    return {};
  } catch (const std::exception& e) {
    lost_ = true;
    error_ = e.what();
    return {otherwise, error_};
  }
}

robot::Finding LockStep::Wait(double dt_s) noexcept {
  return Try(HoldReason::kArmSilent, [&] { Run(dt_s); });
}

// Advances the simulator's time once the simulator has received the driver's set-points. The driver
// sends expired set-points again.
void LockStep::Run(double dt_s) {
  constexpr int kTries = 20;
  for (int n = 0; n < kTries; ++n) {
    driver_->Flush();
    const std::uint64_t sent = driver_->setpoints_sent();
    const bool ran = link_->Run(dt_s, n == 0 ? static_cast<int>(sent - setpoints_seen_) : 1);
    setpoints_seen_ = sent;
    if (ran) {
      driver_->Flush();
      return;
    }
    static_cast<void>(driver_->Tick(SteadyNs(), WallNs()));
  }
  throw std::runtime_error("set-points do not reach the simulator");
}

robot::Finding LockStep::Rest() noexcept {
  return Try(HoldReason::kArmSilent, [&] {
    driver_->Flush();
    link_->Rest();
    Forget();
  });
}

robot::Finding LockStep::Look() noexcept {
  return Try(HoldReason::kImageSilent, [&] {
    link_->Look();
    Forget();  // set-points expire while a picture is drawn, and nothing moves
  });
}

}  // namespace dfr::apps::line_tracking
