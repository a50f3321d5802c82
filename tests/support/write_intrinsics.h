#pragma once

#include <filesystem>
#include <fstream>
#include <limits>

#include "dfr/vision/camera_model.h"

namespace dfr::test {

/// Writes intrinsics in OpenCV's YAML 1.0 format, with enough digits for every bit.
inline void WriteIntrinsics(const std::filesystem::path& path, const vision::CameraModel& camera) {
  const auto& d = camera.distortion;
  std::ofstream out(path);
  out.precision(std::numeric_limits<double>::max_digits10);
  out << "%YAML:1.0\n---\nimage_width: " << camera.width << "\nimage_height: " << camera.height
      << "\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ "
      << camera.fx << ", 0., " << camera.cx << ", 0., " << camera.fy << ", " << camera.cy
      << ", 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n"
      << "   dt: d\n   data: [ " << d[0] << ", " << d[1] << ", " << d[2] << ", " << d[3] << ", "
      << d[4] << " ]\n";
}

}  // namespace dfr::test
