#include "robot/turn_about_tip.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace dfr::apps::line_tracking {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;
using kinematics::PsmReach;

constexpr double kTurn = 0.05;      // rad, angle between two points of the path
constexpr double kWay = 5e-4;       // m, distance between two points of the tips' path
constexpr double kMostJoint = 0.5;  // rad; a larger step between two points means another posture

// Returns true if the tips stay near the straight line while the joints move between two points.
bool StaysNear(const PsmJoints& a, const PsmJoints& b, const Eigen::Vector3d& tip_a,
               const Eigen::Vector3d& tip_b) {
  constexpr int kLooks = 4;
  for (int i = 1; i < kLooks; ++i) {
    const double s = static_cast<double>(i) / kLooks;
    const Eigen::Vector3d straight = tip_a + s * (tip_b - tip_a);
    if ((Psm::Tip(a + s * (b - a)) - straight).norm() > kMostAstray) return false;
  }
  return true;
}

}  // namespace

std::optional<std::vector<PsmJoints>> TurnAboutTip(const PsmJoints& from, const PsmJoints& to,
                                                   kinematics::PsmGeneration generation) {
  const Eigen::Quaterniond first(Psm::Forward(from).linear());
  const Eigen::Quaterniond last(Psm::Forward(to).linear());
  const Eigen::Vector3d begin = Psm::Tip(from);
  const Eigen::Vector3d end = Psm::Tip(to);
  const int parts =
      std::max(1, static_cast<int>(std::ceil(
                      std::max(first.angularDistance(last) / kTurn, (end - begin).norm() / kWay))));
  std::vector<PsmJoints> way;
  PsmJoints before = from;
  Eigen::Vector3d tip_before = begin;
  for (int i = 1; i <= parts; ++i) {
    const double s = static_cast<double>(i) / parts;
    const Eigen::Vector3d tip = begin + s * (end - begin);
    PsmJoints joints = to;
    if (i < parts) {
      Eigen::Isometry3d wrist = Eigen::Isometry3d::Identity();
      wrist.linear() = first.slerp(s, last).toRotationMatrix();
      wrist.translation() = tip - Psm::kJawLength * wrist.linear().col(2);
      if (Psm::Inverse(wrist, joints, generation) != PsmReach::kOk) return std::nullopt;
    }
    if ((joints - before).cwiseAbs().maxCoeff() > kMostJoint ||
        !StaysNear(before, joints, tip_before, tip)) {
      return std::nullopt;
    }
    way.push_back(joints);
    before = joints;
    tip_before = tip;
  }
  return way;
}

std::optional<PsmJoints> Displaced(const PsmJoints& joints, const Eigen::Vector3d& step_m,
                                   kinematics::PsmGeneration generation) {
  Eigen::Isometry3d wrist = Psm::Forward(joints);
  wrist.translation() += step_m;
  PsmJoints displaced;
  if (Psm::Inverse(wrist, displaced, generation) != PsmReach::kOk) return std::nullopt;
  return displaced;
}

}  // namespace dfr::apps::line_tracking
