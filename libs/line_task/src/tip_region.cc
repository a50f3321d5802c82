#include "dfr/line_task/tip_region.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::line_task {
namespace {

using kinematics::PsmJoints;

// Maximum deviation of the jaw tips from a straight line during one control, m.
constexpr double kBend = 5e-5;

void Deeper(double depth_m, const char* what, Breach& worst) noexcept {
  if (depth_m > worst.depth_m) worst = {depth_m, what};
}

}  // namespace

void TipRegionOptions::Check() const {
  DFR_THROW_UNLESS(box_min_m.allFinite() && box_max_m.allFinite() &&
                       (box_min_m.array() < box_max_m.array()).all(),
                   "box_min_m must be below box_max_m in every entry, and both must be finite");
  for (const Eigen::AlignedBox3d& box : forbidden) {
    DFR_THROW_UNLESS(box.min().allFinite() && box.max().allFinite() && !box.isEmpty(),
                     "a forbidden box must be finite, and its lower corner must be below its upper "
                     "corner");
  }
  for (const Eigen::Hyperplane<double, 3>& plane : planes) {
    DFR_THROW_UNLESS(plane.coeffs().allFinite() && std::abs(plane.normal().norm() - 1.0) < 1e-6,
                     "a plane must be finite and have a normal of length 1");
  }
}

TipRegion::TipRegion(const LineTask& task, const TipRegionOptions& options)
    : task_(&task), options_(options) {
  options.Check();
}

Breach TipRegion::At(const Eigen::Vector3d& tip_m) const noexcept {
  if (!tip_m.allFinite()) return {std::numeric_limits<double>::infinity(), "all bounds"};
  Breach worst;
  Deeper(options_.box_min_m.z() - tip_m.z(), "the floor", worst);
  if (gauze_seen_) {
    Deeper(options_.box_min_m.z() - gauze_.signedDistance(tip_m), "the observed gauze", worst);
  }
  const double outside = std::max((options_.box_min_m - tip_m).head<2>().maxCoeff(),
                                  (tip_m - options_.box_max_m).maxCoeff());
  Deeper(outside, "the task's box", worst);
  for (const Eigen::AlignedBox3d& box : options_.forbidden) {
    // Inside, this is the distance to the nearest face.
    const double inside = std::min((tip_m - box.min()).minCoeff(), (box.max() - tip_m).minCoeff());
    Deeper(inside, "a forbidden box", worst);
  }
  for (const Eigen::Hyperplane<double, 3>& plane : options_.planes) {
    Deeper(-plane.signedDistance(tip_m), "a plane", worst);
  }
  return worst;
}

Breach TipRegion::Along(const PsmJoints& from, const PsmJoints& to) const noexcept {
  const PsmJoints way = to - from;
  const int looks = kinematics::Psm::NumParts(way);
  Breach worst;
  double allowed = At(task_->Tip(from)).depth_m;
  for (int i = 1; i <= looks; ++i) {
    const Breach here = At(task_->Tip(from + (static_cast<double>(i) / looks) * way));
    // A path that starts outside the region must not lead farther out.
    if (here.any() && here.depth_m > allowed + kBend && here.depth_m > worst.depth_m) worst = here;
    allowed = std::min(allowed, here.depth_m);
  }
  return worst;
}

void TipRegion::SetGauze(const Eigen::Isometry3d& p_world_gauze) noexcept {
  gauze_ = Eigen::Hyperplane<double, 3>(p_world_gauze.linear().col(2), p_world_gauze.translation());
  gauze_seen_ = p_world_gauze.matrix().allFinite();
}

}  // namespace dfr::line_task
