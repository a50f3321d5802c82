#pragma once

#include <filesystem>
#include <opencv2/videoio.hpp>
#include <string>

#include "dfr/core/files/atomic_file.h"

namespace dfr::apps {

/// Writes pictures of one size to a video file, a core::AtomicFile. The ending of its name chooses
/// the format: .mp4 (H.264) or .webm (VP8). Encoders need even sizes, so an odd last row or column
/// is left out.
class VideoWriter {
 public:
  /// @throws std::runtime_error naming the file if it cannot be written or its ending is unknown.
  VideoWriter(const std::filesystem::path& path, cv::Size size, double frames_per_second);
  /// Encodes a test video beside `path` and discards it. @throws as the constructor and Commit().
  static void Check(const std::filesystem::path& path);

  /// Appends a picture, BGR.
  void Write(const cv::Mat& picture);
  /// Ends the video and reads it once. Without this call the previous file stays.
  /// @throws std::runtime_error naming the file if the video is incomplete, as on a full disk, or
  ///   the file cannot be replaced.
  void Commit();

 private:
  void Finish();

  std::string name_;
  cv::Size even_;
  int pictures_ = 0;  // number of pictures written
  core::AtomicFile file_;
  cv::VideoWriter writer_;
};

/// Writes a picture, BGR, as a core::AtomicFile. The ending of its name chooses the format.
/// @throws std::runtime_error naming the file if it cannot be written or its ending is unknown.
void WritePicture(const std::filesystem::path& path, const cv::Mat& picture);

}  // namespace dfr::apps
