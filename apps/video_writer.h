#pragma once

#include <filesystem>
#include <opencv2/videoio.hpp>

namespace dfr::apps {

/// Writes pictures of one size to a video file. The ending of its name chooses the format: .mp4
/// (H.264) or .webm (VP8). Encoders need even sizes, so an odd last row or column is left out.
class VideoWriter {
 public:
  /// @throws std::runtime_error naming the file if it cannot be written or its ending is unknown.
  VideoWriter(const std::filesystem::path& path, cv::Size size, double frames_per_second);

  /// @throws std::runtime_error naming a file whose ending is unknown.
  static void CheckName(const std::filesystem::path& path);
  /// Appends a picture, BGR.
  void Write(const cv::Mat& picture);

 private:
  cv::Size even_;
  cv::VideoWriter writer_;
};

/// Writes a picture, BGR, as a core::AtomicFile. The ending of its name chooses the format.
/// @throws std::runtime_error naming the file if it cannot be written or its ending is unknown.
void WritePicture(const std::filesystem::path& path, const cv::Mat& picture);

}  // namespace dfr::apps
