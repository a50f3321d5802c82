// Processing of ROS 2 images, with a clock that the test sets.
#include <gtest/gtest.h>

#include <cstring>
#include <opencv2/imgcodecs.hpp>

#include "reading_endoscope.h"
#include "tests/hardware_endoscope/pictures.h"

namespace dfr::hardware::internal {
namespace {

using test::kHeight;
using test::kWidth;
using test::Message;
using test::Noise;

constexpr std::int64_t kStamp = 1'700'000'000'000'000'000;
constexpr std::int64_t kArrival = 5'000'000'000;

class ImageMessagesTest : public testing::Test {
 protected:
  template <typename Image>
  FrameStatus StatusOf(const Image& image) {
    Put(feed_, image, kArrival);
    return feed_.Grab(kArrival, kStamp, frame_);
  }
  // Returns blue, green and red of a pixel.
  std::array<int, 3> Pixel(int row, int col) {
    const std::uint8_t* at = frame_.image.data +
                             static_cast<std::size_t>(row) * frame_.image.stride +
                             3 * static_cast<std::size_t>(col);
    return {at[0], at[1], at[2]};
  }

  Feed feed_{test::SmallPictures()};
  Frame frame_;
};

TEST_F(ImageMessagesTest, BlueGreenRedIsUnchanged) {
  const cv::Mat sent = Noise(1);
  ASSERT_EQ(StatusOf(Message(sent, kStamp - 7)), FrameStatus::kOk);
  EXPECT_EQ(std::memcmp(frame_.image.data, sent.data, 3UL * kWidth * kHeight), 0);
  EXPECT_EQ(frame_.stamp_ns, kStamp - 7);
}

TEST_F(ImageMessagesTest, EncodingsBecomeBlueGreenRed) {
  cv::Mat colour = Noise(1);
  colour.at<cv::Vec3b>(0, 0) = {10, 120, 200};
  ASSERT_EQ(StatusOf(Message(colour, kStamp, "rgb8")), FrameStatus::kOk);
  EXPECT_EQ(Pixel(0, 0), (std::array<int, 3>{200, 120, 10}));
  ASSERT_EQ(StatusOf(Message(cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(90)), kStamp, "mono8")),
            FrameStatus::kOk);
  EXPECT_EQ(Pixel(0, 1), (std::array<int, 3>{90, 90, 90}));
}

TEST_F(ImageMessagesTest, UnsupportedEncodingsAreNamed) {
  EXPECT_EQ(StatusOf(Message(Noise(1), kStamp, "bayer_rggb8")), FrameStatus::kWrongEncoding);
  EXPECT_EQ(frame_.image.data, nullptr);
  dds::Image cut = Message(Noise(2), kStamp);
  cut.data.pop_back();
  EXPECT_EQ(StatusOf(cut), FrameStatus::kWrongEncoding);
  dds::Image overlapping = Message(Noise(3), kStamp);
  overlapping.step -= 1;
  EXPECT_EQ(StatusOf(overlapping), FrameStatus::kWrongEncoding);
  EXPECT_EQ(StatusOf(Message(Noise(4, 32, 24), kStamp)), FrameStatus::kWrongSize);
  EXPECT_EQ(frame_.width, 32);
  EXPECT_EQ(frame_.height, 24);
  EXPECT_EQ(StatusOf(Message(Noise(5), 0)), FrameStatus::kInvalidStamp);
  EXPECT_EQ(StatusOf(Message(Noise(6), kStamp)), FrameStatus::kOk);
}

TEST_F(ImageMessagesTest, CompressedPicturesAreDecoded) {
  dds::CompressedImage message;
  message.stamp = dds::Stamp::FromNanoseconds(kStamp);
  message.format = "bgr8; jpeg compressed bgr8";
  cv::imencode(".jpg", cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(60, 120, 180)), message.data);
  ASSERT_EQ(StatusOf(message), FrameStatus::kOk);
  const std::array<int, 3> middle = Pixel(kHeight / 2, kWidth / 2);
  EXPECT_NEAR(middle[0], 60, 4);  // loss of JPEG on a plain colour
  EXPECT_NEAR(middle[1], 120, 4);
  EXPECT_NEAR(middle[2], 180, 4);
  message.data.assign(100, 7);
  EXPECT_EQ(StatusOf(message), FrameStatus::kWrongEncoding);
  message.data.clear();
  EXPECT_EQ(StatusOf(message), FrameStatus::kWrongEncoding);
}

}  // namespace
}  // namespace dfr::hardware::internal
