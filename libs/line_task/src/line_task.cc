#include "dfr/line_task/line_task.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace dfr::line_task {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

constexpr double kMillimetre = 1e3;
constexpr double kHeadingScale = 10.0;  // mm per rad

// Returns the orientation of the tool in the base frame at the arm's home pose.
Eigen::Matrix3d ToolRotation() {
  PsmJoints home = PsmJoints::Zero();
  home[2] = 0.12;
  return Psm::Forward(home).linear();
}

}  // namespace

vision::LineTarget StandardTarget() {
  vision::LineTarget target;
  for (double y : {-0.0265, 0.0265}) {
    for (double x : {-0.038, -0.0127, 0.0127, 0.038}) target.marks_m.emplace_back(x, y);
  }
  return target;
}

LineTask::LineTask(const LineCalibration& calibration, const Eigen::Isometry3d& p_world_base,
                   kinematics::PsmGeneration generation)
    : calibration_(calibration),
      p_world_base_(p_world_base),
      p_base_world_(p_world_base.inverse()),
      p_world_cam_(p_world_base * calibration.p_base_cam),
      p_cam_world_(p_world_cam_.inverse()),
      tool_rotation_(ToolRotation()),
      generation_(generation) {
  layout_.Add("tip", 2);
  layout_.Add("distance", 1);
  layout_.Add("heading", 1);
  vision_.target = StandardTarget();
  vision_.p_cam_target = p_cam_world_;
}

bool LineTask::Reading(const Eigen::Vector3d& tip_m, PsmJoints& reading) const noexcept {
  Eigen::Isometry3d wrist = Eigen::Isometry3d::Identity();
  wrist.linear() = tool_rotation_;
  wrist.translation() = p_base_world_ * tip_m - tool_rotation_.col(2) * Psm::kJawLength;
  PsmJoints q;
  if (Psm::Inverse(wrist, q, generation_) != kinematics::PsmReach::kOk) return false;
  reading = calibration_.arm.Invert(q);
  return Psm::WithinLimits(reading, generation_);
}

Eigen::Vector3d LineTask::Tip(const PsmJoints& reading) const noexcept {
  return p_world_base_ * Psm::Tip(calibration_.arm.Apply(reading));
}

Eigen::Vector3d LineTask::Displacement(std::span<const double> control) noexcept {
  return {kStep * std::clamp(control[0], -1.0, 1.0), kStep * std::clamp(control[1], -1.0, 1.0),
          0.0};
}

Eigen::Hyperplane<double, 3> LineTask::TipPlane(const PsmJoints& reading) const noexcept {
  const Eigen::Vector3d up = p_cam_world_.linear() * Eigen::Vector3d::UnitZ();
  return {up, p_cam_world_ * Tip(reading)};
}

void LineTask::State(const vision::LineObservation& seen, std::span<double> state) const noexcept {
  if (!seen.seen()) {
    std::fill(state.begin(), state.end(), std::numeric_limits<double>::quiet_NaN());
    return;
  }
  const Eigen::Vector3d tangent = p_world_cam_.linear() * seen.tangent_cam;
  State(p_world_cam_ * seen.p_cam_tip, seen.distance_m, std::atan2(tangent.y(), tangent.x()),
        state);
}

double LineTask::Progress(const vision::LineObservation& first,
                          const vision::LineObservation& now) noexcept {
  if (!first.seen() || !now.seen()) return std::numeric_limits<double>::quiet_NaN();
  const auto x_on_gauze = [](const vision::LineObservation& seen) {
    return (seen.p_cam_target.inverse() * seen.p_cam_tip).x();
  };
  const double begin = x_on_gauze(first);
  const double end = x_on_gauze(now);
  // Simpson's rule is accurate, because the lines are nearly straight.
  constexpr int kHalves = 8;
  const double h = (end - begin) / kHalves;
  double sum = 0.0;
  for (int i = 0; i <= kHalves; ++i) {
    const double slope = now.line[1] + 2.0 * now.line[2] * (begin + i * h);
    const double weight = i == 0 || i == kHalves ? 1.0 : (i % 2 == 1 ? 4.0 : 2.0);
    sum += weight * std::sqrt(1.0 + slope * slope);
  }
  return sum * h / 3.0;
}

void LineTask::State(const Eigen::Vector3d& tip_m, double distance_m, double heading_rad,
                     std::span<double> state) noexcept {
  state[0] = kMillimetre * tip_m.x();
  state[1] = kMillimetre * tip_m.y();
  state[2] = kMillimetre * distance_m;
  state[3] = kHeadingScale * heading_rad;
}

}  // namespace dfr::line_task
