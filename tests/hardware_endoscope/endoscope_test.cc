// Pictures from GStreamer pipelines and DDS topics.
#include "dfr/hardware/endoscope.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <string>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/hardware_endoscope/pictures.h"
#include "tests/support/eventually.h"

namespace dfr::hardware {
namespace {

using test::Eventually;
using test::kHeight;
using test::kWidth;
using test::Message;
using test::Noise;
using test::SmallPictures;

// Returns a pipeline with GStreamer's test pictures in place of a capture card.
std::string Pipeline(const std::string& source) {
  return "videotestsrc " + source +
         " ! video/x-raw,width=64,height=48,framerate=30/1 ! videoconvert ! "
         "video/x-raw,format=BGR ! appsink sync=false";
}

TEST(PipelineTest, DeliversUntilItsSourceEnds) {
  const auto endoscope = OpenVideo(Pipeline("pattern=snow num-buffers=20"), SmallPictures());
  Frame frame;
  std::uint64_t seen = 0;
  std::uint64_t missed = 0;
  std::uint64_t last = 0;
  FrameStatus status = FrameStatus::kOk;
  Eventually([&] {
    status = endoscope->Grab(frame);
    missed += frame.num_missed;
    if (frame.sequence != last) {
      last = frame.sequence;
      ++seen;
      EXPECT_EQ(frame.image.width, kWidth);
      EXPECT_EQ(frame.image.height, kHeight);
    }
    return status != FrameStatus::kOk && status != FrameStatus::kNever;
  });
  EXPECT_EQ(status, FrameStatus::kFailed);
  EXPECT_EQ(seen + missed, 20U);
  EXPECT_EQ(endoscope->counts().received, 20U);
}

TEST(PipelineTest, RepeatedPicturesAreFrozenAndBlackOnesDark) {
  const auto orange =
      OpenVideo(Pipeline("pattern=solid-color foreground-color=0xffff8000"), SmallPictures());
  Frame frame;
  Eventually([&] { return orange->Grab(frame) == FrameStatus::kFrozen; });
  ASSERT_NE(frame.image.data, nullptr);
  constexpr int kRounding = 6;                       // rounding of the conversion through YUV
  EXPECT_NEAR(frame.image.data[0], 0, kRounding);    // blue
  EXPECT_NEAR(frame.image.data[1], 128, kRounding);  // green
  EXPECT_NEAR(frame.image.data[2], 255, kRounding);  // red
  const auto black = OpenVideo(Pipeline("pattern=black"), SmallPictures());
  Eventually([&] { return black->Grab(frame) == FrameStatus::kDark; });
}

TEST(PipelineTest, AnInvalidPipelineIsRefusedWithTheRemedy) {
  EXPECT_THAT([] { (void)OpenVideo("nosuchsource ! appsink", SmallPictures()); },
              testing::ThrowsMessage<std::runtime_error>(testing::HasSubstr("gst-launch-1.0")));
}

// The camera sends best effort, as ROS 2 does for sensor data: a reliable subscriber would not
// match.
TEST(TopicTest, ABestEffortCameraIsReceived) {
  dds::Participant camera({.domain = test::OwnDomain()});
  dds::Participant participant({.domain = test::OwnDomain()});
  dds::Publisher<dds::CompressedImage> publisher(camera, "/left/image_raw/compressed",
                                                 dds::Role::kSensorImage);
  const auto endoscope = OpenTopic(participant, "/left/image_raw/compressed", SmallPictures());
  Frame frame;
  std::uint64_t sent = 0;
  Eventually([&] {
    dds::CompressedImage image;
    image.stamp = dds::Stamp::Now();
    image.format = "jpeg";
    cv::imencode(".jpg", Noise(sent++), image.data);
    (void)publisher.Write(image);
    return endoscope->Grab(frame) == FrameStatus::kOk;
  });
}

}  // namespace
}  // namespace dfr::hardware
