#include <stdexcept>

#include "dfr/calibration/calibrate.h"

// Succeeds if the library rejects a calibration without data.
int main() try {
  static_cast<void>(dfr::calibration::Calibrate({}, {}, {}, Eigen::Isometry3d::Identity()));
  return 1;
} catch (const std::invalid_argument&) {
  return 0;
}
