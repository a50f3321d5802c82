#include "dfr/line_task/tip_region.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::line_task {
namespace {

using kinematics::PsmJoints;

// Maximum deviation of the jaw tips from a straight line during one control, m.
constexpr double kBend = 5e-5;

constexpr const char* kBox = "the task's box";
constexpr Breach kNowhere = {std::numeric_limits<double>::infinity(), "all bounds"};

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

template <typename Visit>
void TipRegion::ForEachBound(const Visit& visit) const {
  const Eigen::Vector3d& min = options_.box_min_m;
  const Eigen::Vector3d& max = options_.box_max_m;
  visit([&](const Eigen::Vector3d& tip) { return min.z() - tip.z(); }, "the floor");
  if (gauze_seen_) {
    visit([&](const Eigen::Vector3d& tip) { return min.z() - gauze_.signedDistance(tip); },
          "the observed gauze");
  }
  for (int k = 0; k < 3; ++k) {
    if (k < 2) visit([&](const Eigen::Vector3d& tip) { return min[k] - tip[k]; }, kBox);
    visit([&](const Eigen::Vector3d& tip) { return tip[k] - max[k]; }, kBox);
  }
  for (const Eigen::AlignedBox3d& box : options_.forbidden) {
    // Inside, this is the distance to the nearest face.
    visit(
        [&](const Eigen::Vector3d& tip) {
          return std::min((tip - box.min()).minCoeff(), (box.max() - tip).minCoeff());
        },
        "a forbidden box");
  }
  for (const Eigen::Hyperplane<double, 3>& plane : options_.planes) {
    visit([&](const Eigen::Vector3d& tip) { return -plane.signedDistance(tip); }, "a plane");
  }
}

Breach TipRegion::At(const Eigen::Vector3d& tip_m) const noexcept {
  if (!tip_m.allFinite()) return kNowhere;
  Breach worst;
  ForEachBound([&](const auto& depth, const char* what) { Deeper(depth(tip_m), what, worst); });
  return worst;
}

Breach TipRegion::Along(const PsmJoints& from, const PsmJoints& to) const noexcept {
  const PsmJoints way = to - from;
  const int looks = kinematics::Psm::NumParts(way);
  std::array<Eigen::Vector3d, kinematics::Psm::kMostParts + 1> tips;
  for (int i = 0; i <= looks; ++i) {
    Eigen::Vector3d& tip = tips[static_cast<std::size_t>(i)];
    tip = task_->Tip(from + (static_cast<double>(i) / looks) * way);
    if (!tip.allFinite()) return kNowhere;
  }
  Breach worst;
  ForEachBound([&](const auto& depth, const char* what) {
    // A path that starts beyond the bound must not lead farther out.
    double allowed = std::max(0.0, depth(tips[0]));
    for (int i = 1; i <= looks; ++i) {
      const double here = std::max(0.0, depth(tips[static_cast<std::size_t>(i)]));
      if (here > 0.0 && here > allowed + kBend) Deeper(here, what, worst);
      allowed = std::min(allowed, here);
    }
  });
  return worst;
}

void TipRegion::SetGauze(const Eigen::Isometry3d& p_world_gauze) noexcept {
  gauze_ = Eigen::Hyperplane<double, 3>(p_world_gauze.linear().col(2), p_world_gauze.translation());
  gauze_seen_ = p_world_gauze.matrix().allFinite();
}

}  // namespace dfr::line_task
