#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>
#include <string>

namespace dfr::apps {

/// Frames of one video file in the order of their numbers.
class FrameSource {
 public:
  /// @throws core::Error with reason and remedy, without the file's name.
  explicit FrameSource(std::string file);

  [[nodiscard]] const std::string& file() const noexcept { return file_; }
  /// Number of the next frame.
  [[nodiscard]] std::int64_t next() const noexcept { return next_; }
  /// Checks the size of frames and their rate. @throws core::Error if one differs.
  void Require(cv::Size size, double fps) const;
  /// Decodes and discards the frames before `frame`. @throws core::Error if there are fewer.
  void Skip(std::int64_t frame);
  /// Returns the next frame, BGR, valid until the next call. @throws core::Error if there is none.
  const cv::Mat& Take();

 private:
  [[noreturn]] void FailAtEnd() const;

  std::string file_;
  cv::VideoCapture capture_;
  cv::Mat frame_;
  std::int64_t next_ = 0;
};

}  // namespace dfr::apps
