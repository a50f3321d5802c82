#pragma once

#include <filesystem>

#include "dfr/vision/camera_model.h"

namespace dfr::hardware {

/// Reads a camera's intrinsics as OpenCV's calibration sample writes them (cv::FileStorage, YAML or
/// XML: image_width, image_height, camera_matrix, distortion_coefficients with 4, 5 or 8 to 14
/// entries), or as ROS' camera_calibration does (the same keys, matrices as rows, cols, data).
/// Coefficients of the rational, prism and tilt models must be zero: the model here has k1, k2, p1,
/// p2, k3.
/// @throws std::runtime_error naming the file, the key and what is wrong.
[[nodiscard]] vision::CameraModel ReadIntrinsics(const std::filesystem::path& path);

/// Writes them as OpenCV does, YAML 1.0; ReadIntrinsics() gives back the same bits.
/// @throws std::invalid_argument as CameraModel::Check(); std::runtime_error naming the file and
///   what the system says.
void WriteIntrinsics(const std::filesystem::path& path, const vision::CameraModel& camera);

}  // namespace dfr::hardware
