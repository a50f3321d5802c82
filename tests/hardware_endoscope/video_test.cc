// Video files, played on a clock that the test advances.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>
#include <stdexcept>
#include <string>
#include <utility>

#include "dfr/hardware/endoscope.h"
#include "reading_endoscope.h"
#include "tests/hardware_endoscope/pictures.h"
#include "tests/support/eventually.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::hardware {
namespace {

using test::Eventually;
using test::kHeight;
using test::kWidth;
using test::Noise;
using testing::AllOf;
using testing::HasSubstr;

class VideoTest : public testing::Test {
 protected:
  // Writes a lossless video: only the conversion of colours changes the pictures.
  std::string Video(int num_frames, double rate) {
    std::string path = (folder_ / "video.avi").string();
    cv::VideoWriter writer(path, cv::CAP_FFMPEG, cv::VideoWriter::fourcc('F', 'F', 'V', '1'), rate,
                           {kWidth, kHeight});
    EXPECT_TRUE(writer.isOpened());
    for (int i = 0; i < num_frames; ++i) writer.write(Noise(static_cast<std::uint64_t>(i)));
    return path;
  }

  static std::string ErrorOf(const std::string& source, const EndoscopeOptions& options) {
    return dfr::test::MessageOf<std::runtime_error>([&] { (void)OpenVideo(source, options); });
  }

  // Plays the file at a speed that the test sets.
  std::unique_ptr<Endoscope> Play(const std::string& path) {
    return internal::OpenVideo(path, test::SmallPictures(),
                               [this](double time_s, const std::atomic<bool>& stop) {
                                 Eventually([&] { return played_s_ >= time_s || stop; });
                               });
  }

  const dfr::test::TempFolder folder_;
  std::atomic<double> played_s_{0.0};
  Frame frame_;
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
  ASSERT_EQ(file.find('.'), std::string::npos) << "its name has an extension";
  EXPECT_TRUE(IsImageTopic(file));
  std::ofstream(file) << "a video";
  EXPECT_FALSE(IsImageTopic(file)) << "it exists";
}

TEST_F(VideoTest, FilePlaysInItsOwnTimeAndEnds) {
  const std::string path = Video(10, 20.0);
  const auto endoscope = Play(path);
  EXPECT_EQ(endoscope->source(), path);
  for (std::uint64_t i = 0; i < 10; ++i) {
    Eventually([&] { return endoscope->counts().received > i; });
    ASSERT_EQ(endoscope->Grab(frame_), FrameStatus::kOk);
    EXPECT_EQ(frame_.sequence, i + 1) << "20 pictures a second";
    EXPECT_EQ(frame_.num_missed, 0U);
    EXPECT_EQ(frame_.image.width, kWidth);
    // This codec converts colours through YUV, with errors of a few grey values.
    const cv::Mat expected = Noise(i);
    const cv::Mat shown(kHeight, kWidth, CV_8UC3, const_cast<std::uint8_t*>(frame_.image.data),
                        frame_.image.stride);
    EXPECT_LT(cv::norm(shown, expected, cv::NORM_L1) / (3.0 * kWidth * kHeight), 12.0);
    played_s_ = 0.05 * static_cast<double>(i + 1) + 0.001;
  }
  Eventually([&] { return endoscope->Grab(frame_) != FrameStatus::kOk; });
  EXPECT_EQ(endoscope->Grab(frame_), FrameStatus::kEnded);
  EXPECT_EQ(endoscope->counts().received, 10U);
  EXPECT_EQ(endoscope->counts().missed, 0U);
}

TEST_F(VideoTest, MissedPicturesAreCounted) {
  const auto endoscope = Play(Video(30, 100.0));
  played_s_ = 0.095;
  Eventually([&] { return endoscope->counts().received == 10; });
  ASSERT_EQ(endoscope->Grab(frame_), FrameStatus::kOk);
  EXPECT_EQ(frame_.sequence, 10U);
  EXPECT_EQ(frame_.num_missed, 9U);
  EXPECT_EQ(endoscope->counts().missed, 9U);
}

TEST_F(VideoTest, TruncatedFileIsDistinguishedFromOneThatEnded) {
  const std::string path = Video(30, 200.0);
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  played_s_ = std::numeric_limits<double>::infinity();
  {
    const auto endoscope = Play(path);
    FrameStatus status = FrameStatus::kNever;
    Eventually([&] {
      status = endoscope->Grab(frame_);
      return status != FrameStatus::kOk && status != FrameStatus::kNever;
    });
    EXPECT_EQ(status, FrameStatus::kTruncated);
  }
  // Keeps only the head of the file, without a picture.
  std::filesystem::resize_file(path, 300);
  EXPECT_THAT(ErrorOf(path, test::SmallPictures()),
              HasSubstr("is not a video that can be decoded"));
}

TEST_F(VideoTest, AnUnreadableVideoIsNamedWithTheRemedy) {
  std::ofstream(folder_ / "text.avi") << "no video";
  const std::pair<std::string, const char*> rows[] = {
      {"/dev/video97", "/dev/video97: cannot be opened: No such file"},
      {"/dev/video97", "ls /dev/video*"},
      {"97", "/dev/video97"},
      {"/dev/null", "check that it is a capture device"},
      {(folder_ / "none.avi").string(), "check the path"},
      {(folder_ / "text.avi").string(), "is not a video that can be decoded"}};
  for (const auto& [source, words] : rows) {
    EXPECT_THAT(ErrorOf(source, test::SmallPictures()), HasSubstr(words));
  }
  EndoscopeOptions other = test::SmallPictures();
  other.width = 640;
  EXPECT_THAT(
      ErrorOf(Video(2, 30.0), other),
      AllOf(HasSubstr("64 x 48, but the intrinsics are for 640 x 48"), HasSubstr("calibrate")));
  EXPECT_THROW((void)hardware::OpenVideo("0", {.width = 0}), std::invalid_argument);
  EXPECT_THROW((void)hardware::OpenVideo("0", {.max_repeats = 1}), std::invalid_argument);
}

TEST(FrameStatusTest, EveryStatusHasANameAndARemedy) {
  for (int i = 1; i <= static_cast<int>(FrameStatus::kFrozen); ++i) {
    EXPECT_STRNE(Name(static_cast<FrameStatus>(i)), "unknown") << i;
    EXPECT_STRNE(Remedy(static_cast<FrameStatus>(i)), "") << i;
  }
}

}  // namespace
}  // namespace dfr::hardware
