#include "dfr/hardware/platform_motion.h"

namespace dfr::hardware {
namespace {

robot::Finding Found(SprkStatus status) noexcept {
  if (status == SprkStatus::kOk) return {};
  return {runtime::HoldReason::kPlatform, status == SprkStatus::kDeviceFailed
                                              ? "its port failed: cut its power, then start again"
                                              : Name(status)};
}

}  // namespace

PlatformMotion::PlatformMotion(const PlatformOptions& options)
    : options_(options), driver_({.device = options.device, .clock_s = {}}) {}

PlatformMotion::~PlatformMotion() {
  if (moves_) static_cast<void>(driver_.Hold());
}

robot::Finding PlatformMotion::Check() noexcept { return Found(driver_.Check()); }

robot::Finding PlatformMotion::Home() noexcept {
  moves_ = true;
  return Found(driver_.Home());
}

robot::Finding PlatformMotion::Begin() noexcept {
  if (!options_.wave) return {};
  moves_ = true;  // even if this fails, because a part of the frame may have arrived
  return Found(driver_.Start(*options_.wave, options_.motion));
}

robot::Finding PlatformMotion::Rest() noexcept {
  if (!moves_) return {};
  const SprkStatus status = driver_.Hold();
  moves_ = status != SprkStatus::kOk && status != SprkStatus::kGoesHome;
  return moves_ ? Found(status) : robot::Finding{};
}

}  // namespace dfr::hardware
