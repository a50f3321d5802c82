#include "dfr/hardware/psm_arm.h"

// Without a console, the arm of a control loop is silent.
int main() {
  dfr::dds::Participant participant({.domain = 101});
  dfr::hardware::PsmDriver driver(participant, {.arm = "PSM1"});
  dfr::hardware::PsmArm arm(driver, [](const auto&, const auto&) { return std::string_view(); });
  return arm.Tick(0, 0).reason == dfr::runtime::HoldReason::kArmSilent && !arm.armed() ? 0 : 1;
}
