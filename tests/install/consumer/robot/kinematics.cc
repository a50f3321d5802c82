#include "dfr/kinematics/psm.h"

// At home (insertion 0.12 m), the wrist is 113.5 mm below the remote centre of motion.
int main() {
  dfr::kinematics::PsmJoints q = dfr::kinematics::PsmJoints::Zero();
  q[2] = 0.12;
  const double z = dfr::kinematics::Psm::Forward(q).translation().z();
  return z > -0.1136 && z < -0.1134 ? 0 : 1;
}
