#include "psm_messages.h"

namespace dfr::sim::internal {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

// Returns the twist (v, w) of the matrix [[w] v; 0 0], where [w] x is the cross product of w and x.
Eigen::Matrix<double, 6, 1> Twist(const Eigen::Matrix4d& matrix) {
  Eigen::Matrix<double, 6, 1> twist;
  twist << matrix.topRightCorner<3, 1>(), matrix(2, 1), matrix(0, 2), matrix(1, 0);
  return twist;
}

}  // namespace

const std::vector<std::string>& JointNames() {
  static const std::vector<std::string> kNames = {"yaw",  "pitch",       "insertion",
                                                  "roll", "wrist_pitch", "wrist_yaw"};
  return kNames;
}

dds::JointState Joints(const dds::Stamp& stamp, const PsmJoints& position) {
  dds::JointState message;
  message.stamp = stamp;
  message.name = JointNames();
  message.position.assign(position.data(), position.data() + position.size());
  return message;
}

dds::JointState Jaw(const dds::Stamp& stamp, double angle) {
  dds::JointState message;
  message.stamp = stamp;
  message.name = {"jaw"};
  message.position = {angle};
  return message;
}

dds::PoseStamped Pose(const dds::Stamp& stamp, const std::string& frame,
                      const Eigen::Isometry3d& pose) {
  dds::PoseStamped message;
  message.stamp = stamp;
  message.frame_id = frame;
  message.position_m = pose.translation();
  message.orientation = Eigen::Quaterniond(pose.linear());
  return message;
}

PsmJoints JointGoal(const dds::JointState& message) {
  if (message.position.size() != 6) {
    return PsmJoints::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  return Eigen::Map<const PsmJoints>(message.position.data());
}

dds::Matrix ByRows(const Eigen::Matrix<double, 6, 6>& jacobian) {
  dds::Matrix message;
  message.rows = message.cols = 6;
  message.data.reserve(36);
  for (int row = 0; row < 6; ++row) {
    for (int col = 0; col < 6; ++col) message.data.push_back(jacobian(row, col));
  }
  return message;
}

void Jacobians(const PsmJoints& joints, Eigen::Matrix<double, 6, 6>& body,
               Eigen::Matrix<double, 6, 6>& spatial) {
  constexpr double kHalf = 1e-5;  // rad, m: error 1e-10
  const Eigen::Matrix4d inverse = Psm::Forward(joints).inverse().matrix();
  for (int i = 0; i < 6; ++i) {
    PsmJoints step = PsmJoints::Zero();
    step[i] = kHalf;
    const Eigen::Matrix4d change =
        (Psm::Forward(joints + step).matrix() - Psm::Forward(joints - step).matrix()) /
        (2.0 * kHalf);
    body.col(i) = Twist(inverse * change);
    spatial.col(i) = Twist(change * inverse);
  }
}

double JawGoal(const dds::JointState& message) {
  return message.position.size() == 1 ? message.position[0]
                                      : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace dfr::sim::internal
