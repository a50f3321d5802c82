#include "dfr/line_task/line_task.h"

// Converts a tip position to joint values and back.
int main() {
  dfr::kinematics::PsmJoints home = dfr::kinematics::PsmJoints::Zero();
  home[2] = 0.12;
  Eigen::Isometry3d p_world_base = Eigen::Isometry3d::Identity();
  p_world_base.translation() = -dfr::kinematics::Psm::Tip(home);
  const dfr::line_task::LineTask task({}, p_world_base);
  dfr::kinematics::PsmJoints reading;
  if (!task.Reading({0.0, 0.0, 0.0}, reading)) return 1;
  return (reading - home).norm() < 1e-12 ? 0 : 1;
}
