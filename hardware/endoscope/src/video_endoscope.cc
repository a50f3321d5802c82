#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "dfr/core/error.h"
#include "dfr/dds/messages.h"
#include "dfr/hardware/endoscope.h"
#include "reading_endoscope.h"

namespace dfr::hardware {
namespace {

using Clock = std::chrono::steady_clock;

[[noreturn]] void Fail(const std::string& source, const std::string& what,
                       const std::string& remedy) {
  throw core::Error(source + ": " + what, remedy);
}

// Reports the system's error for a device or a file, because OpenCV only reports a failure to open.
void CheckReadable(const std::string& path, bool device) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (fd >= 0) {
    ::close(fd);
    return;
  }
  const int error = errno;
  std::string remedy = "check the path";
  if (device && (error == ENOENT || error == ENODEV || error == ENXIO)) {
    remedy = "plug in the camera or frame grabber; `ls /dev/video*` lists the devices";
  } else if (device && (error == EACCES || error == EPERM)) {
    remedy = "add the user to the group video (`sudo adduser $USER video`) and log in again";
  } else if (error == EACCES) {
    remedy = "give this user permission to read it";
  } else if (error == EBUSY) {
    remedy = "another program has it open; `fuser` names it";
  }
  Fail(path, std::string("cannot be opened: ") + std::strerror(error), remedy);
}

class Video {
 public:
  Video(std::string source, const EndoscopeOptions& options, internal::Pace pace)
      : source_(std::move(source)), options_(options), pace_(std::move(pace)) {
    Open();
  }

  void Read(internal::Feed& feed, const std::atomic<bool>& stop) {
    if (file_) pace_(0.0, stop);
    double count = 0.0;
    for (cv::Mat picture = first_; !stop.load(std::memory_order_relaxed);) {
      Put(picture, feed);
      count += 1.0;
      if (file_) pace_(count * options_.period_s, stop);
      if (!capture_.read(picture)) {
        const bool whole = count >= announced_ - 1.0;
        feed.End(!file_ ? FrameStatus::kFailed
                        : (whole ? FrameStatus::kEnded : FrameStatus::kTruncated));
        return;
      }
    }
  }

 private:
  void Open() {
    const bool number = !source_.empty() && std::all_of(source_.begin(), source_.end(), [](char c) {
      return std::isdigit(static_cast<unsigned char>(c)) != 0;
    });
    const std::string path = number ? "/dev/video" + source_ : source_;
    const bool pipeline = source_.find('!') != std::string::npos;
    const bool device = path.rfind("/dev/", 0) == 0;
    file_ = !pipeline && !device;
    if (!pipeline) CheckReadable(path, device);
    bool open = false;
    try {
      const int backend = pipeline ? cv::CAP_GSTREAMER : (device ? cv::CAP_V4L2 : cv::CAP_FFMPEG);
      open = capture_.open(path, backend);
      if (open && device) {
        capture_.set(cv::CAP_PROP_FRAME_WIDTH, options_.width);
        capture_.set(cv::CAP_PROP_FRAME_HEIGHT, options_.height);
        capture_.set(cv::CAP_PROP_BUFFERSIZE, 1);  // drops old pictures
      }
      if (file_ && open) {
        const double rate = capture_.get(cv::CAP_PROP_FPS);
        if (rate > 0.1 && rate < 1e4) options_.period_s = 1.0 / rate;
        announced_ = capture_.get(cv::CAP_PROP_FRAME_COUNT);
      }
      if (open && !capture_.read(first_)) open = false;
    } catch (const cv::Exception& e) {
      Fail(source_, std::string("OpenCV cannot open it: ") + e.what(), "check that it is a video");
    }
    if (!open && pipeline) {
      Fail(source_, "GStreamer delivers no pictures from this pipeline",
           "try it with gst-launch-1.0. It must end with 'videoconvert ! video/x-raw,format=BGR ! "
           "appsink', and the packages of its elements (gstreamer1.0-plugins-*) must be installed");
    }
    if (!open && device) {
      Fail(source_, "delivers no pictures",
           "check that it is a capture device (`v4l2-ctl --list-devices`) that no other program "
           "uses");
    }
    if (!open) Fail(source_, "is not a video that can be decoded", "check that it is complete");
    if (first_.cols != options_.width || first_.rows != options_.height) {
      Fail(source_,
           "delivers pictures of " + std::to_string(first_.cols) + " x " +
               std::to_string(first_.rows) + ", but the intrinsics are for " +
               std::to_string(options_.width) + " x " + std::to_string(options_.height),
           Remedy(FrameStatus::kWrongSize));
    }
  }

  static void Put(const cv::Mat& picture, internal::Feed& feed) {
    const std::int64_t wall_ns = dds::Stamp::Now().nanoseconds();
    const std::int64_t arrival_ns = internal::SteadyNs();
    if (picture.depth() != CV_8U || (picture.channels() != 3 && picture.channels() != 1)) {
      feed.PutWrongEncoding(wall_ns, arrival_ns);
      return;
    }
    feed.Put(picture.data, picture.cols, picture.rows, picture.step, picture.channels(), false,
             wall_ns, arrival_ns);
  }

  std::string source_;
  EndoscopeOptions options_;
  internal::Pace pace_;
  cv::VideoCapture capture_;
  cv::Mat first_;
  double announced_ = 0.0;
  bool file_ = false;
};

}  // namespace

std::unique_ptr<Endoscope> internal::OpenVideo(const std::string& source,
                                               const EndoscopeOptions& options, const Pace& pace) {
  options.Check();
  const auto video = std::make_shared<Video>(source, options, pace);
  return MakeEndoscope(source, options, [video](Feed& feed, const std::atomic<bool>& stop) {
    video->Read(feed, stop);
  });
}

std::unique_ptr<Endoscope> OpenVideo(const std::string& source, const EndoscopeOptions& options) {
  return internal::OpenVideo(
      source, options,
      [start = std::optional<Clock::time_point>()](double time_s,
                                                   const std::atomic<bool>&) mutable {
        if (!start) start = Clock::now();
        std::this_thread::sleep_until(*start + std::chrono::duration_cast<Clock::duration>(
                                                   std::chrono::duration<double>(time_s)));
      });
}

}  // namespace dfr::hardware
