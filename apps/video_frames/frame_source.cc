#include "apps/video_frames/frame_source.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <opencv2/videoio/registry.hpp>
#include <string_view>
#include <utility>

#include "dfr/core/error.h"
#include "dfr/core/text/format.h"

namespace dfr::apps {
namespace {

constexpr std::size_t kBoxHead = 8;  // Bytes of the size and type of a box in an MP4 file.
constexpr std::size_t kMostMovie = std::size_t{16} << 20;

std::uint64_t BigEndian(std::string_view bytes) {
  std::uint64_t value = 0;
  for (const char byte : bytes) value = value << 8 | static_cast<unsigned char>(byte);
  return value;
}

std::string ReadBytes(std::istream& in, std::size_t size) {
  std::string bytes(size, '\0');
  in.read(bytes.data(), static_cast<std::streamsize>(size));
  bytes.resize(static_cast<std::size_t>(in.gcount()));
  return bytes;
}

// Returns the four letters of the first codec of an MP4 file, such as "av01"; "" if there are none.
std::string CodecOf(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  std::uint64_t at = 0;
  while (in.seekg(static_cast<std::streamoff>(at))) {
    const std::string head = ReadBytes(in, 2 * kBoxHead);
    if (head.size() < kBoxHead) return "";
    std::uint64_t size = BigEndian(head.substr(0, 4));
    if (size == 1 && head.size() == 2 * kBoxHead) size = BigEndian(head.substr(kBoxHead));
    if (head.substr(4, 4) == "moov") {
      in.clear();
      in.seekg(static_cast<std::streamoff>(at));
      const std::string movie =
          ReadBytes(in, static_cast<std::size_t>(std::min<std::uint64_t>(size, kMostMovie)));
      // The box of sample descriptions: its type, version, number of entries; the first entry's
      // size and type.
      const std::size_t table = movie.find("stsd");
      if (table == std::string::npos || table + 20 > movie.size()) return "";
      std::string codec = movie.substr(table + 16, 4);
      std::ranges::replace_if(
          codec, [](char c) { return c < ' ' || c > '~'; }, '?');
      return codec;
    }
    if (size < kBoxHead || size > (std::uint64_t{1} << 60)) return "";
    at += size;
  }
  return "";
}

[[noreturn]] void FailToDecode(const std::string& file) {
  const std::string codec = CodecOf(file);
  if (codec.empty()) {
    throw core::Error("is not a video that can be decoded: it has no list of frames",
                      "check that the download is complete");
  }
  throw core::Error("cannot decode any frame of its codec '" + codec + "'",
                    "this OpenCV may lack the codec: ffmpeg -i OLD.mp4 -c:v libx264 NEW.mp4 "
                    "converts it. Otherwise the file is damaged: download it again");
}

}  // namespace

FrameSource::FrameSource(std::string file) : file_(std::move(file)) {
  std::ifstream in(file_, std::ios::binary);
  if (!in) {
    throw core::Error(std::string("cannot be opened: ") + std::strerror(errno),
                      "give this user permission to read it");
  }
  constexpr std::string_view kPointer = "version https://git-lfs";
  if (ReadBytes(in, kPointer.size()) == kPointer) {
    throw core::Error("is a Git LFS pointer, not the video", "`git lfs pull` downloads it");
  }
  if (!cv::videoio_registry::hasBackend(cv::CAP_FFMPEG)) {
    throw core::Error("this OpenCV is built without FFmpeg, which decodes videos",
                      "install Debian's libopencv-videoio, or build OpenCV with FFmpeg");
  }
  bool open = false;
  try {
    open = capture_.open(file_, cv::CAP_FFMPEG);
  } catch (const cv::Exception&) {
    open = false;
  }
  if (!open) FailToDecode(file_);
}

void FrameSource::Require(cv::Size size, double fps) const {
  const cv::Size found(static_cast<int>(capture_.get(cv::CAP_PROP_FRAME_WIDTH)),
                       static_cast<int>(capture_.get(cv::CAP_PROP_FRAME_HEIGHT)));
  if (found != size) {
    throw core::Error(core::Format("its frames have %d x %d pixels (height x width); "
                                   "meta/info.json states %d x %d",
                                   found.height, found.width, size.height, size.width),
                      "correct the feature's shape and names there");
  }
  const double own = capture_.get(cv::CAP_PROP_FPS);
  if (own > 0.0 && std::abs(own - fps) > 0.01 * fps) {
    throw core::Error(
        core::Format("has %.6g frames per second; meta/info.json states %.6g", own, fps),
        "correct fps there if states were recorded at the video's rate");
  }
}

void FrameSource::FailAtEnd() const {
  const auto announced = std::llround(capture_.get(cv::CAP_PROP_FRAME_COUNT));
  if (next_ < announced) {
    if (next_ == 0) FailToDecode(file_);
    throw core::Error(
        core::Format("cannot decode frame %lld of %lld", static_cast<long long>(next_), announced),
        "the file is damaged or incomplete: download it again");
  }
  throw core::Error(core::Format("ends after %lld frames; the episode has more states",
                                 static_cast<long long>(next_)),
                    "check that the download is complete and fps in meta/info.json is right");
}

void FrameSource::Skip(std::int64_t frame) {
  for (; next_ < frame; ++next_) {
    if (!capture_.grab()) FailAtEnd();
  }
}

const cv::Mat& FrameSource::Take() {
  const cv::Size expected(static_cast<int>(capture_.get(cv::CAP_PROP_FRAME_WIDTH)),
                          static_cast<int>(capture_.get(cv::CAP_PROP_FRAME_HEIGHT)));
  if (!capture_.read(frame_)) FailAtEnd();
  if (frame_.size() != expected || frame_.type() != CV_8UC3) {
    throw core::Error(core::Format("frame %lld has %d x %d pixels, unlike the first frame",
                                   static_cast<long long>(next_), frame_.rows, frame_.cols),
                      "leave the episode out");
  }
  ++next_;
  return frame_;
}

}  // namespace dfr::apps
