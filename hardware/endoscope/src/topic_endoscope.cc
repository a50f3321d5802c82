#include <atomic>
#include <chrono>
#include <cstddef>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <string_view>
#include <thread>

#include "dfr/dds/channel.h"
#include "dfr/hardware/endoscope.h"
#include "feed.h"

namespace dfr::hardware {
namespace {

std::int64_t SteadyNs() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

void Put(internal::Feed& feed, const dds::Image& image) {
  const std::int64_t stamp_ns = image.stamp.nanoseconds();
  const bool grey = image.encoding == "mono8" || image.encoding == "8UC1";
  const bool swap = image.encoding == "rgb8";
  const int channels = grey ? 1 : 3;
  const bool known = grey || swap || image.encoding == "bgr8" || image.encoding == "8UC3";
  constexpr std::uint32_t kLargest = 1U << 20U;
  if (!known || image.width > kLargest || image.height > kLargest ||
      image.step < static_cast<std::size_t>(channels) * image.width ||
      image.data.size() < static_cast<std::size_t>(image.step) * image.height) {
    feed.PutWrongEncoding(stamp_ns, SteadyNs());
    return;
  }
  feed.Put(image.data.data(), static_cast<int>(image.width), static_cast<int>(image.height),
           image.step, channels, swap, stamp_ns, SteadyNs());
}

void Put(internal::Feed& feed, const dds::CompressedImage& image) {
  const std::int64_t stamp_ns = image.stamp.nanoseconds();
  cv::Mat picture;
  try {
    if (!image.data.empty()) picture = cv::imdecode(image.data, cv::IMREAD_COLOR);
  } catch (const cv::Exception&) {
    picture.release();
  }
  if (picture.empty()) {
    feed.PutWrongEncoding(stamp_ns, SteadyNs());
    return;
  }
  feed.Put(picture.data, picture.cols, picture.rows, picture.step, 3, false, stamp_ns, SteadyNs());
}

template <typename Message>
class TopicEndoscope final : public Endoscope {
 public:
  TopicEndoscope(dds::Participant& participant, const std::string& topic,
                 const EndoscopeOptions& options)
      : source_(topic), feed_(options), subscriber_(participant, topic, dds::Role::kImage) {
    thread_ = std::thread([this] { Read(); });
  }
  ~TopicEndoscope() override {
    stop_.store(true, std::memory_order_relaxed);
    thread_.join();
  }
  TopicEndoscope(const TopicEndoscope&) = delete;
  TopicEndoscope& operator=(const TopicEndoscope&) = delete;

  using Endoscope::Grab;
  FrameStatus Grab(std::int64_t steady_ns, std::int64_t wall_ns, Frame& frame) noexcept override {
    return feed_.Grab(steady_ns, wall_ns, frame);
  }
  [[nodiscard]] EndoscopeCounts counts() const noexcept override { return feed_.counts(); }
  [[nodiscard]] const std::string& source() const noexcept override { return source_; }

 private:
  void Read() noexcept {
    constexpr double kLookForStop = 0.05;
    try {
      Message message;
      while (!stop_.load(std::memory_order_relaxed)) {
        if (!subscriber_.Wait(kLookForStop)) continue;
        while (subscriber_.Take(message)) Put(feed_, message);
      }
    } catch (const std::exception&) {
      feed_.End(FrameStatus::kFailed);
    }
  }

  std::string source_;
  internal::Feed feed_;
  dds::Subscriber<Message> subscriber_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace

std::unique_ptr<Endoscope> OpenTopic(dds::Participant& participant, const std::string& topic,
                                     const EndoscopeOptions& options) {
  constexpr std::string_view kCompressed = "/compressed";
  const bool compressed =
      topic.size() > kCompressed.size() &&
      topic.compare(topic.size() - kCompressed.size(), kCompressed.size(), kCompressed) == 0;
  if (compressed) {
    return std::make_unique<TopicEndoscope<dds::CompressedImage>>(participant, topic, options);
  }
  return std::make_unique<TopicEndoscope<dds::Image>>(participant, topic, options);
}

}  // namespace dfr::hardware
