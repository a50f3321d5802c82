#include <stdexcept>

#include "dfr/calibration/calibrate.h"

// Calibrates without any data.
int main() try {
  static_cast<void>(dfr::calibration::Calibrate({}, {}, {}, Eigen::Isometry3d::Identity()));
  return 1;
} catch (const std::invalid_argument&) {
  return 0;
}
