#pragma once

#include <filesystem>

#include "dfr/vision/camera_model.h"

namespace dfr::hardware {

/// Reads a camera's intrinsics from a file of OpenCV's calibration sample (cv::FileStorage, YAML or
/// XML: image_width, image_height, camera_matrix, distortion_coefficients with 4, 5, 8, 12 or 14
/// entries) or of ROS' camera_calibration (the same keys; matrices as rows, cols, data).
/// Coefficients of the rational, prism and tilt models must be zero: CameraModel has only k1, k2,
/// p1, p2, k3.
/// @throws std::runtime_error naming the file, the key and the error.
[[nodiscard]] vision::CameraModel ReadIntrinsics(const std::filesystem::path& path);

}  // namespace dfr::hardware
