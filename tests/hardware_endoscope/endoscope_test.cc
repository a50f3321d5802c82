#include "dfr/hardware/endoscope.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <stdexcept>
#include <string>
#include <thread>

#include "dfr/core/random.h"
#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/support/no_alloc.h"

namespace dfr::hardware {
namespace {

using Clock = std::chrono::steady_clock;
using testing::AllOf;
using testing::HasSubstr;

constexpr int kWidth = 64;
constexpr int kHeight = 48;

EndoscopeOptions Small() {
  EndoscopeOptions options;
  options.width = kWidth;
  options.height = kHeight;
  options.max_age_s = 1.0;  // of a machine that is busy with other things
  return options;
}

// Noise over grey, so that no two pictures are the same.
cv::Mat Picture(std::uint64_t seed, int width = kWidth, int height = kHeight) {
  core::Random random(seed);
  cv::Mat picture(height, width, CV_8UC3);
  for (int i = 0; i < 3 * width * height; ++i) {
    picture.data[i] = static_cast<std::uint8_t>(100 + random.Below(50));
  }
  return picture;
}

bool Eventually(const std::function<bool()>& condition) {
  const auto end = Clock::now() + std::chrono::seconds(60);
  while (!condition()) {
    if (Clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

// Looks at each picture once, until there is something wrong: what it is.
FrameStatus LookUntilWrong(Endoscope& endoscope, const std::function<void(const Frame&)>& look) {
  Frame frame;
  std::uint64_t last = 0;
  FrameStatus status = FrameStatus::kOk;
  EXPECT_TRUE(Eventually([&] {
    status = endoscope.Grab(frame);
    if (status == FrameStatus::kOk && frame.sequence != last) look(frame);
    last = frame.sequence;
    return status != FrameStatus::kOk && status != FrameStatus::kNever;
  }));
  return status;
}

class VideoTest : public testing::Test {
 protected:
  VideoTest()
      : folder_(std::filesystem::path(testing::TempDir()) /
                (std::string("endoscope_") +
                 testing::UnitTest::GetInstance()->current_test_info()->name())) {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~VideoTest() override { std::filesystem::remove_all(folder_); }

  // Without loss, so that what is read is what was written.
  std::string Video(int num_frames, double rate) {
    std::string path = (folder_ / "video.avi").string();
    cv::VideoWriter writer(path, cv::CAP_FFMPEG, cv::VideoWriter::fourcc('F', 'F', 'V', '1'), rate,
                           {kWidth, kHeight});
    EXPECT_TRUE(writer.isOpened());
    for (int i = 0; i < num_frames; ++i) writer.write(Picture(static_cast<std::uint64_t>(i)));
    return path;
  }

  static std::string ErrorOf(const std::string& source, const EndoscopeOptions& options) {
    try {
      (void)OpenVideo(source, options);
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "no error";
  }

  std::filesystem::path folder_;
};

TEST_F(VideoTest, AFileOrDeviceIsNoTopic) {
  for (const char* topic : {"/ECM/image_raw", "/image", "/ECM/image_raw/compressed", "/a_1/b2"}) {
    EXPECT_TRUE(IsImageTopic(topic)) << topic;
  }
  for (const char* other : {"", "0", "image_raw", "/dev/video0", "/dev/none", "case7.avi",
                            "/data/case7.avi", "/data/my video", "videotestsrc ! appsink"}) {
    EXPECT_FALSE(IsImageTopic(other)) << other;
  }
  const std::string file = (folder_ / "recorded").string();
  ASSERT_EQ(file.find('.'), std::string::npos) << "else its name tells";
  EXPECT_TRUE(IsImageTopic(file));
  std::ofstream(file) << "a video";
  EXPECT_FALSE(IsImageTopic(file)) << "it exists";
}

TEST_F(VideoTest, FilePlaysInItsOwnTimeAndEnds) {
  const std::string path = Video(10, 20.0);
  const auto start = Clock::now();
  const auto endoscope = OpenVideo(path, Small());
  EXPECT_EQ(endoscope->source(), path);
  std::uint64_t missed = 0;
  int seen = 0;
  const FrameStatus status = LookUntilWrong(*endoscope, [&](const Frame& frame) {
    // Colours go through YUV in this codec: a few grey values off.
    const cv::Mat expected = Picture(frame.sequence - 1);
    EXPECT_EQ(frame.image.width, kWidth);
    double worst = 0.0;
    for (int i = 0; i < kHeight; ++i) {
      for (int j = 0; j < 3 * kWidth; ++j) {
        const double difference =
            static_cast<double>(frame.image.data[static_cast<std::size_t>(i) * frame.image.stride +
                                                 static_cast<std::size_t>(j)]) -
            expected.at<std::uint8_t>(i, j);
        worst += std::abs(difference) / (3.0 * kWidth * kHeight);
      }
    }
    EXPECT_LT(worst, 12.0);
    missed += frame.num_missed;
    ++seen;
  });
  EXPECT_EQ(status, FrameStatus::kEnded);
  EXPECT_EQ(seen + static_cast<int>(missed), 10);
  EXPECT_EQ(endoscope->counts().received, 10U);
  EXPECT_EQ(endoscope->counts().missed, missed);
  EXPECT_GE(Clock::now() - start, std::chrono::milliseconds(450));  // 20 pictures a second
}

// GStreamer's test pictures, as a capture card's pipeline has them.
std::string Pipeline(const std::string& source) {
  return "videotestsrc is-live=true " + source +
         " ! video/x-raw,width=64,height=48,framerate=30/1 ! videoconvert ! "
         "video/x-raw,format=BGR ! appsink";
}

TEST_F(VideoTest, PipelineDeliversUntilItsSourceEnds) {
  const auto endoscope = OpenVideo(Pipeline("pattern=snow num-buffers=20"), Small());
  int seen = 0;
  const FrameStatus status = LookUntilWrong(*endoscope, [&](const Frame& frame) {
    EXPECT_EQ(frame.image.width, kWidth);
    EXPECT_EQ(frame.image.height, kHeight);
    EXPECT_LT(frame.age_s, 1.0);
    ++seen;
  });
  EXPECT_EQ(status, FrameStatus::kFailed);
  EXPECT_GT(seen, 1);
  EXPECT_EQ(endoscope->counts().received, 20U);
}

TEST_F(VideoTest, PipelineOfOnePictureIsFrozenAndOfNoneDark) {
  const auto orange =
      OpenVideo(Pipeline("pattern=solid-color foreground-color=0xffff8000"), Small());
  Frame frame;
  ASSERT_TRUE(Eventually([&] { return orange->Grab(frame) == FrameStatus::kFrozen; }));
  ASSERT_NE(frame.image.data, nullptr);
  constexpr int kRounding = 6;                       // of the way through YUV
  EXPECT_NEAR(frame.image.data[0], 0, kRounding);    // blue
  EXPECT_NEAR(frame.image.data[1], 128, kRounding);  // green
  EXPECT_NEAR(frame.image.data[2], 255, kRounding);  // red
  const auto black = OpenVideo(Pipeline("pattern=black"), Small());
  EXPECT_TRUE(Eventually([&] { return black->Grab(frame) == FrameStatus::kDark; }));
}

TEST_F(VideoTest, PicturesNobodyLooksAtAreCounted) {
  const auto endoscope = OpenVideo(Video(30, 100.0), Small());
  ASSERT_TRUE(Eventually([&] { return endoscope->counts().received >= 10; }));
  Frame frame;
  (void)endoscope->Grab(frame);
  EXPECT_GE(frame.num_missed, 9U);
  EXPECT_EQ(endoscope->counts().missed, frame.num_missed);
}

TEST_F(VideoTest, TruncatedFileIsToldFromOneThatEnded) {
  const std::string path = Video(30, 200.0);
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  const auto endoscope = OpenVideo(path, Small());
  Frame frame;
  FrameStatus status = FrameStatus::kOk;
  ASSERT_TRUE(Eventually([&] {
    status = endoscope->Grab(frame);
    return status != FrameStatus::kOk && status != FrameStatus::kNever;
  }));
  EXPECT_EQ(status, FrameStatus::kTruncated);
  // All but a head: nothing to see.
  std::filesystem::resize_file(path, 300);
  EXPECT_THAT(ErrorOf(path, Small()), HasSubstr("is not a video that can be decoded"));
}

TEST_F(VideoTest, WhatCannotBeOpenedIsNamedWithTheRemedy) {
  EXPECT_THAT(ErrorOf("/dev/video97", Small()),
              AllOf(HasSubstr("/dev/video97: cannot be opened: No such file"),
                    HasSubstr("ls /dev/video*")));
  EXPECT_THAT(ErrorOf("97", Small()), HasSubstr("/dev/video97"));
  EXPECT_THAT(ErrorOf("/dev/null", Small()), HasSubstr("is it a capture device"));
  EXPECT_THAT(ErrorOf((folder_ / "none.avi").string(), Small()), HasSubstr("is the path right?"));
  std::ofstream(folder_ / "text.avi") << "no video";
  EXPECT_THAT(ErrorOf((folder_ / "text.avi").string(), Small()),
              HasSubstr("is not a video that can be decoded"));
  EXPECT_THAT(ErrorOf("nosuchsource ! appsink", Small()), HasSubstr("gst-launch-1.0"));
  EndoscopeOptions other = Small();
  other.width = 640;
  EXPECT_THAT(
      ErrorOf(Video(2, 30.0), other),
      AllOf(HasSubstr("64 x 48, and the intrinsics are for 640 x 48"), HasSubstr("calibrate")));
  EXPECT_THROW((void)OpenVideo("0", {.width = 0}), std::invalid_argument);
  EXPECT_THROW((void)OpenVideo("0", {.max_repeats = 1}), std::invalid_argument);
}

class TopicTest : public testing::Test {
 protected:
  static dds::Image Message(const cv::Mat& picture, const std::string& encoding = "bgr8") {
    dds::Image image;
    image.stamp = dds::Stamp::Now();
    image.width = static_cast<std::uint32_t>(picture.cols);
    image.height = static_cast<std::uint32_t>(picture.rows);
    image.encoding = encoding;
    image.step = static_cast<std::uint32_t>(picture.step);
    image.data.assign(picture.data, picture.data + picture.total() * picture.elemSize());
    return image;
  }

  // Sends pictures of `make` until one is judged as `expected`.
  bool Becomes(FrameStatus expected, const std::function<dds::Image(std::uint64_t)>& make) {
    return Eventually([&] {
      (void)publisher_.Write(make(next_++));
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      return endoscope_->Grab(frame_) == expected;
    });
  }

  dds::Participant camera_{{.domain = test::OwnDomain()}};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  dds::Publisher<dds::Image> publisher_{camera_, "/ECM/image_raw", dds::Role::kImage};
  std::unique_ptr<Endoscope> endoscope_ = OpenTopic(participant_, "/ECM/image_raw", Small());
  Frame frame_;
  std::uint64_t next_ = 1;
};

TEST_F(TopicTest, PicturesArriveAsTheyWereSent) {
  EXPECT_EQ(endoscope_->Grab(frame_), FrameStatus::kNever);
  ASSERT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) { return Message(Picture(i)); }));
  // One more, to be sure which it is.
  const cv::Mat sent = Picture(12345);
  const dds::Image message = Message(sent);
  const std::uint64_t before = frame_.sequence;
  ASSERT_TRUE(publisher_.Write(message));
  ASSERT_TRUE(Eventually([&] {
    return endoscope_->Grab(frame_) == FrameStatus::kOk && frame_.sequence > before &&
           frame_.stamp_ns == message.stamp.nanoseconds();
  }));
  EXPECT_EQ(std::memcmp(frame_.image.data, sent.data, 3UL * kWidth * kHeight), 0);
  EXPECT_GE(frame_.age_s, 0.0);
}

// As ROS 2 sends sensor data: a subscriber that relies on repeats would refuse it.
TEST(SensorTopicTest, ACameraThatRepeatsNothingIsHeard) {
  dds::Participant camera({.domain = test::OwnDomain()});
  dds::Participant participant({.domain = test::OwnDomain()});
  dds::Publisher<dds::CompressedImage> publisher(camera, "/left/image_raw/compressed",
                                                 dds::Role::kSensorImage);
  const auto endoscope = OpenTopic(participant, "/left/image_raw/compressed", Small());
  Frame frame;
  std::uint64_t next = 1;
  EXPECT_TRUE(Eventually([&] {
    dds::CompressedImage image;
    image.stamp = dds::Stamp::Now();
    image.format = "jpeg";
    cv::imencode(".jpg", Picture(next++), image.data);
    publisher.Write(image);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return endoscope->Grab(frame) == FrameStatus::kOk;
  }));
}

TEST_F(TopicTest, EncodingsBecomeBlueGreenRed) {
  ASSERT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) {
    cv::Mat picture = Picture(i);
    picture.at<cv::Vec3b>(0, 0) = {10, 120, 200};
    return Message(picture, "rgb8");
  }));
  EXPECT_EQ(frame_.image.data[0], 200);
  EXPECT_EQ(frame_.image.data[1], 120);
  EXPECT_EQ(frame_.image.data[2], 10);
  const auto grey = [](std::uint64_t i) {
    cv::Mat picture(kHeight, kWidth, CV_8UC1, cv::Scalar(90));
    picture.data[0] = static_cast<std::uint8_t>(i % 200);
    return Message(picture, "mono8");
  };
  ASSERT_TRUE(Becomes(FrameStatus::kOk, grey));
  ASSERT_TRUE(Eventually([&] {
    (void)publisher_.Write(grey(next_++));
    return endoscope_->Grab(frame_) == FrameStatus::kOk && frame_.image.data[3] == 90 &&
           frame_.image.data[4] == 90 && frame_.image.data[5] == 90;
  }));
  EXPECT_TRUE(Becomes(FrameStatus::kWrongEncoding,
                      [](std::uint64_t i) { return Message(Picture(i), "bayer_rggb8"); }));
  EXPECT_TRUE(Becomes(FrameStatus::kWrongEncoding, [](std::uint64_t i) {
    dds::Image cut = Message(Picture(i));
    cut.data.pop_back();
    return cut;
  }));
  EXPECT_EQ(frame_.image.data, nullptr);
}

TEST_F(TopicTest, BlackFrozenSmallAndBadlyStampedPicturesAreNamed) {
  EXPECT_TRUE(Becomes(FrameStatus::kDark, [](std::uint64_t i) {
    cv::Mat picture(kHeight, kWidth, CV_8UC3, cv::Scalar(5, 5, 5));
    picture.data[0] = static_cast<std::uint8_t>(i);
    return Message(picture);
  }));
  EXPECT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) { return Message(Picture(i)); }));
  EXPECT_TRUE(Becomes(FrameStatus::kFrozen, [](std::uint64_t) { return Message(Picture(7)); }));
  EXPECT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) { return Message(Picture(i)); }));
  EXPECT_TRUE(Becomes(FrameStatus::kWrongSize,
                      [](std::uint64_t i) { return Message(Picture(i, 32, 24)); }));
  EXPECT_EQ(frame_.width, 32);
  EXPECT_EQ(frame_.height, 24);
  EXPECT_TRUE(Becomes(FrameStatus::kInvalidStamp, [](std::uint64_t i) {
    dds::Image image = Message(Picture(i));
    image.stamp = {};
    return image;
  }));
  EXPECT_TRUE(Becomes(FrameStatus::kOld, [](std::uint64_t i) {
    dds::Image image = Message(Picture(i));
    image.stamp.sec -= 3;
    return image;
  }));
  EXPECT_TRUE(Becomes(FrameStatus::kAhead, [](std::uint64_t i) {
    dds::Image image = Message(Picture(i));
    image.stamp.sec += 3;
    return image;
  }));
}

TEST_F(TopicTest, SilenceIsNamedAndTimeIsTheCallers) {
  ASSERT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) { return Message(Picture(i)); }));
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  const std::int64_t steady =
      std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch()).count();
  const std::int64_t wall = dds::Stamp::Now().nanoseconds();
  EXPECT_EQ(endoscope_->Grab(steady, wall, frame_), FrameStatus::kOk);
  constexpr std::int64_t kLater = 2'000'000'000;
  EXPECT_EQ(endoscope_->Grab(steady + kLater, wall + kLater, frame_), FrameStatus::kSilent);
  EXPECT_EQ(endoscope_->Grab(steady + kLater, wall, frame_), FrameStatus::kSilent);
}

TEST_F(TopicTest, GapsBetweenStampsCountAsLosses) {
  ASSERT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) { return Message(Picture(i)); }));
  const std::uint64_t received = endoscope_->counts().received;
  dds::Image image = Message(Picture(1));
  // Not before the last one has been taken.
  const auto send = [&](double later_s) {
    image.stamp = dds::Stamp::FromNanoseconds(image.stamp.nanoseconds() +
                                              static_cast<std::int64_t>(1e9 * later_s));
    const std::uint64_t before = endoscope_->counts().received;
    return publisher_.Write(image) &&
           Eventually([&] { return endoscope_->counts().received > before; });
  };
  ASSERT_TRUE(send(0.0));
  const std::uint64_t lost = endoscope_->counts().lost;
  ASSERT_TRUE(send(1.0 / 30.0));
  EXPECT_EQ(endoscope_->counts().lost, lost);
  ASSERT_TRUE(send(4.0 / 30.0));
  EXPECT_EQ(endoscope_->counts().lost, lost + 3);
  EXPECT_GE(endoscope_->counts().received, received + 3);
}

TEST_F(TopicTest, GrabNeverAllocates) {
  ASSERT_TRUE(Becomes(FrameStatus::kOk, [](std::uint64_t i) { return Message(Picture(i)); }));
  for (int i = 0; i < 50; ++i) {
    (void)publisher_.Write(Message(Picture(next_++)));
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    const test::NoAlloc guard;
    (void)endoscope_->Grab(frame_);
  }
}

TEST_F(TopicTest, CompressedPicturesAreDecoded) {
  dds::Publisher<dds::CompressedImage> publisher(camera_, "/ECM/image_raw/compressed",
                                                 dds::Role::kImage);
  const auto endoscope = OpenTopic(participant_, "/ECM/image_raw/compressed", Small());
  cv::Mat grey(kHeight, kWidth, CV_8UC3, cv::Scalar(60, 120, 180));
  dds::CompressedImage message;
  message.format = "bgr8; jpeg compressed bgr8";
  ASSERT_TRUE(Eventually([&] {
    message.stamp = dds::Stamp::Now();
    grey.data[0] = static_cast<std::uint8_t>(next_++ % 250);
    cv::imencode(".jpg", grey, message.data);
    (void)publisher.Write(message);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    return endoscope->Grab(frame_) == FrameStatus::kOk;
  }));
  const std::uint8_t* middle =
      frame_.image.data + static_cast<std::size_t>(kHeight / 2) * frame_.image.stride + 90;
  EXPECT_NEAR(middle[0], 60, 4);  // jpeg's loss on a plain colour
  EXPECT_NEAR(middle[1], 120, 4);
  EXPECT_NEAR(middle[2], 180, 4);
  ASSERT_TRUE(Eventually([&] {
    message.stamp = dds::Stamp::Now();
    message.data.assign(100, 7);
    (void)publisher.Write(message);
    return endoscope->Grab(frame_) == FrameStatus::kWrongEncoding;
  }));
}

TEST(FrameStatusTest, EveryStatusHasANameAndARemedy) {
  for (int i = 1; i <= static_cast<int>(FrameStatus::kFrozen); ++i) {
    EXPECT_STRNE(Name(static_cast<FrameStatus>(i)), "unknown") << i;
    EXPECT_STRNE(Remedy(static_cast<FrameStatus>(i)), "") << i;
  }
}

}  // namespace
}  // namespace dfr::hardware
