#pragma once

#include "dfr/kinematics/psm.h"

namespace dfr::test {

/// Joints at which homing ends: the tool points straight down.
inline kinematics::PsmJoints PsmHome() {
  kinematics::PsmJoints joints = kinematics::PsmJoints::Zero();
  joints[2] = 0.12;
  return joints;
}

/// PsmHome() with another value of one joint.
inline kinematics::PsmJoints PsmHomeWith(int joint, double value) {
  kinematics::PsmJoints joints = PsmHome();
  joints[joint] = value;
  return joints;
}

}  // namespace dfr::test
