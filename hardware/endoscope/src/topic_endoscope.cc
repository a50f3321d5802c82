#include <atomic>
#include <cstddef>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <string_view>

#include "dfr/dds/channel.h"
#include "dfr/hardware/endoscope.h"
#include "reading_endoscope.h"

namespace dfr::hardware {
namespace internal {

void Put(Feed& feed, const dds::Image& image, std::int64_t arrival_ns) {
  const std::int64_t stamp_ns = image.stamp.nanoseconds();
  const bool grey = image.encoding == "mono8" || image.encoding == "8UC1";
  const bool swap = image.encoding == "rgb8";
  const int channels = grey ? 1 : 3;
  const bool known = grey || swap || image.encoding == "bgr8" || image.encoding == "8UC3";
  constexpr std::uint32_t kLargest = 1U << 20U;
  if (!known || image.width > kLargest || image.height > kLargest ||
      image.step < static_cast<std::size_t>(channels) * image.width ||
      image.data.size() < static_cast<std::size_t>(image.step) * image.height) {
    feed.PutWrongEncoding(stamp_ns, arrival_ns);
    return;
  }
  feed.Put(image.data.data(), static_cast<int>(image.width), static_cast<int>(image.height),
           image.step, channels, swap, stamp_ns, arrival_ns);
}

void Put(Feed& feed, const dds::CompressedImage& image, std::int64_t arrival_ns) {
  const std::int64_t stamp_ns = image.stamp.nanoseconds();
  cv::Mat picture;
  try {
    if (!image.data.empty()) picture = cv::imdecode(image.data, cv::IMREAD_COLOR);
  } catch (const cv::Exception&) {
    picture.release();
  }
  if (picture.empty()) {
    feed.PutWrongEncoding(stamp_ns, arrival_ns);
    return;
  }
  feed.Put(picture.data, picture.cols, picture.rows, picture.step, 3, false, stamp_ns, arrival_ns);
}

}  // namespace internal

namespace {

template <typename Message>
internal::Read Subscribe(dds::Participant& participant, const std::string& topic) {
  using Subscriber = dds::Subscriber<Message>;
  const auto reliable = std::make_shared<Subscriber>(participant, topic, dds::Role::kImage);
  return [&participant, topic, reliable](internal::Feed& feed, const std::atomic<bool>& stop) {
    constexpr double kLookForStop = 0.05;
    Message message;
    // A reliable subscriber refuses best-effort publishers, which cameras use for ROS 2 sensor
    // data.
    std::unique_ptr<Subscriber> best_effort;
    while (!stop.load(std::memory_order_relaxed)) {
      Subscriber& subscriber = best_effort ? *best_effort : *reliable;
      if (!subscriber.Wait(kLookForStop)) {
        const dds::Health health = reliable->health();
        if (!best_effort && health.publishers == 0 && health.incompatible > 0) {
          best_effort = std::make_unique<Subscriber>(participant, topic, dds::Role::kSensorImage);
        } else if (best_effort && health.publishers > 0) {
          best_effort.reset();
        }
        continue;
      }
      while (subscriber.Take(message)) internal::Put(feed, message, internal::SteadyNs());
    }
  };
}

}  // namespace

std::unique_ptr<Endoscope> OpenTopic(dds::Participant& participant, const std::string& topic,
                                     const EndoscopeOptions& options) {
  constexpr std::string_view kCompressed = "/compressed";
  const bool compressed =
      topic.size() > kCompressed.size() &&
      topic.compare(topic.size() - kCompressed.size(), kCompressed.size(), kCompressed) == 0;
  options.Check();
  return internal::MakeEndoscope(topic, options,
                                 compressed ? Subscribe<dds::CompressedImage>(participant, topic)
                                            : Subscribe<dds::Image>(participant, topic));
}

}  // namespace dfr::hardware
