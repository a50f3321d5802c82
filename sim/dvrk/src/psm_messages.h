#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "dfr/dds/channel.h"
#include "dfr/kinematics/psm.h"

/// Converts poses and joints to a console's messages, and back.
namespace dfr::sim::internal {

/// All motion data published for one time.
struct Snapshot {
  double due_s = 0.0;
  dds::JointState measured_js;
  dds::JointState setpoint_js;
  dds::PoseStamped measured_cp;
  dds::PoseStamped setpoint_cp;
  dds::TwistStamped measured_cv;
  dds::JointState jaw_measured_js;
  dds::JointState jaw_setpoint_js;
  dds::PoseStamped local_measured_cp;
  dds::PoseStamped local_setpoint_cp;
  dds::WrenchStamped measured_cf;
  dds::Matrix body_jacobian;
  dds::Matrix spatial_jacobian;
};

[[nodiscard]] const std::vector<std::string>& JointNames();
[[nodiscard]] dds::JointState Joints(const dds::Stamp& stamp,
                                     const kinematics::PsmJoints& position);
[[nodiscard]] dds::JointState Jaw(const dds::Stamp& stamp, double angle);
[[nodiscard]] dds::PoseStamped Pose(const dds::Stamp& stamp, const std::string& frame,
                                    const Eigen::Isometry3d& pose);

/// Returns the pose in a PoseStamped, a CartesianState or a query.
template <typename Message>
Eigen::Isometry3d Transform(const Message& message) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = message.position_m;
  constexpr double kRounding = 1e-3;
  if (std::abs(message.orientation.norm() - 1.0) <= kRounding) {
    pose.linear() = message.orientation.normalized().toRotationMatrix();
  } else {
    // The message has no orientation. NaN makes the console reject it.
    pose.linear().setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return pose;
}

/// Returns the goal of a message; NaN if the message has the wrong number of joint values.
[[nodiscard]] kinematics::PsmJoints JointGoal(const dds::JointState& message);
[[nodiscard]] double JawGoal(const dds::JointState& message);

[[nodiscard]] dds::Matrix ByRows(const Eigen::Matrix<double, 6, 6>& jacobian);
/// Jacobians of the manipulator: column i is the twist (linear before angular) of the wrist due to
/// joint i, in the wrist's own frame (body), and in the base frame at its origin (spatial).
void Jacobians(const kinematics::PsmJoints& joints, Eigen::Matrix<double, 6, 6>& body,
               Eigen::Matrix<double, 6, 6>& spatial);

}  // namespace dfr::sim::internal
