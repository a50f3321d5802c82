#include "dfr/hardware/sprk_lag.h"

#include <cmath>

namespace dfr::hardware {

void SprkLag::Rest(const kinematics::PlatformPose& pose, double time_s) noexcept {
  from_ = pose;
  commanded_ = pose;
  time_s_ = time_s;
}

void SprkLag::Command(const kinematics::PlatformPose& pose, double time_s) noexcept {
  from_ = At(time_s);
  commanded_ = pose;
  time_s_ = time_s;
}

kinematics::PlatformPose SprkLag::At(double time_s) const noexcept {
  const double left = std::exp(-(time_s - time_s_) / kinematics::SprkPlatform::kTimeConstant);
  kinematics::PlatformPose pose;
  pose.translation_m =
      commanded_.translation_m + left * (from_.translation_m - commanded_.translation_m);
  pose.angles_rad = commanded_.angles_rad + left * (from_.angles_rad - commanded_.angles_rad);
  return pose;
}

}  // namespace dfr::hardware
