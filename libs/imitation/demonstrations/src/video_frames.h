#pragma once

#include <sys/types.h>

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <string>

#include "dfr/core/matrix.h"

namespace dfr::imitation::internal {

/// Consecutive frames of a video file.
struct VideoClip {
  std::filesystem::path file;
  int camera = 0;  ///< Index of the camera. The last file of each camera stays open.
  std::int64_t first = 0;
  std::int64_t count = 0;
  /// Properties that the file must have.
  double fps = 0.0;
  int height = 0;
  int width = 0;
  /// Size to which each frame is averaged, at most the size of the frame.
  int out_height = 0;
  int out_width = 0;
};

/// Decodes videos with the program video_frames. The process starts at the first call and ends with
/// this object. Files are untrusted, but can crash only that process. Each object belongs to one
/// thread.
class VideoFrames {
 public:
  VideoFrames() = default;
  VideoFrames(const VideoFrames&) = delete;
  VideoFrames& operator=(const VideoFrames&) = delete;
  ~VideoFrames() { End(); }

  /// Writes each frame to a row, out_height x out_width x channels values from 0 to 255. Three
  /// channels are RGB. A single channel is R, for grey videos.
  /// @param frames  count rows, out_height * out_width * (1 or 3) columns.
  /// @throws std::runtime_error with the reason and the remedy.
  void Read(const VideoClip& clip, Eigen::Ref<core::Matrix> frames);

 private:
  void Start();
  /// Ends the process. Returns " by signal N" if signal N had already ended it; otherwise "".
  std::string End() noexcept;

  int socket_ = -1;
  pid_t process_ = -1;
};

}  // namespace dfr::imitation::internal
