#include "apps/video_writer.h"

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <string_view>
#include <vector>

#include "dfr/core/files/atomic_file.h"

namespace dfr::apps {
namespace {

int CodecOf(const std::filesystem::path& path) {
  if (path.extension() == ".mp4") return cv::VideoWriter::fourcc('a', 'v', 'c', '1');
  if (path.extension() == ".webm") return cv::VideoWriter::fourcc('V', 'P', '8', '0');
  throw std::runtime_error(path.string() + ": the name of a video must end in .mp4 or .webm");
}

int CountPictures(const std::string& file) {
  cv::VideoCapture video(file, cv::CAP_FFMPEG);
  int count = 0;
  while (video.grab()) ++count;
  return count;
}

}  // namespace

VideoWriter::VideoWriter(const std::filesystem::path& path, cv::Size size, double frames_per_second)
    : name_(path.string()),
      even_(size.width & ~1, size.height & ~1),
      file_(path, path.extension()),
      writer_(file_.written(), cv::CAP_FFMPEG, CodecOf(path), frames_per_second, even_) {
  if (!writer_.isOpened()) {
    throw std::runtime_error(path.string() + ": the video cannot be encoded");
  }
}

void VideoWriter::Write(const cv::Mat& picture) {
  writer_.write(picture(cv::Rect({}, even_)));
  ++pictures_;
}

void VideoWriter::Check(const std::filesystem::path& path) {
  // A test video written to a pipe could not be removed.
  if (std::filesystem::exists(path) && !std::filesystem::is_regular_file(path)) return;
  const cv::Size size(64, 64);
  VideoWriter video(path, size, 10.0);
  video.Write(cv::Mat::zeros(size, CV_8UC3));
  video.Finish();
}

void VideoWriter::Commit() {
  Finish();
  file_.Commit();
}

void VideoWriter::Finish() {
  writer_.release();
  // OpenCV does not report that a picture could not be written. A pipe cannot be read again.
  if (std::filesystem::is_regular_file(file_.written()) &&
      CountPictures(file_.written()) < pictures_) {
    throw std::runtime_error(name_ + ": the video is incomplete; check that the disk is not full");
  }
}

void WritePicture(const std::filesystem::path& path, const cv::Mat& picture) {
  std::vector<unsigned char> bytes;
  try {
    if (!cv::imencode(path.extension().string(), picture, bytes)) bytes.clear();
  } catch (const cv::Exception& e) {
    throw std::runtime_error(path.string() + ": " + e.err);
  }
  if (bytes.empty()) throw std::runtime_error(path.string() + ": the picture cannot be encoded");
  core::ReplaceFile(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace dfr::apps
