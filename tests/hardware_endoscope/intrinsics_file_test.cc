#include "dfr/hardware/intrinsics_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>
#include <stdexcept>
#include <string>
#include <utility>

#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"
#include "tests/support/write_intrinsics.h"

namespace dfr::hardware {
namespace {

using testing::HasSubstr;

vision::CameraModel Odd() {
  vision::CameraModel camera;
  camera.width = 720;
  camera.height = 576;
  camera.fx = 1.0 / 3.0 * 2000.0;
  camera.fy = 700.1;
  camera.cx = 359.123456789012345;
  camera.cy = 287.7;
  camera.distortion = {-0.31, 0.1 / 3.0, 1e-4, -2.2e-5, 1e-300};
  return camera;
}

class IntrinsicsFileTest : public testing::Test {
 protected:
  std::filesystem::path Write(const std::string& text) {
    std::filesystem::path path = folder_ / "camera.yaml";
    std::ofstream(path) << text;
    return path;
  }

  std::string ErrorOf(const std::string& text) {
    const auto path = Write(text);
    std::string error =
        dfr::test::MessageOf<std::runtime_error>([&] { (void)ReadIntrinsics(path); });
    EXPECT_THAT(error, HasSubstr(path.string()));
    return error;
  }

  const dfr::test::TempFolder folder_;
};

TEST_F(IntrinsicsFileTest, AllBitsAreRead) {
  test::WriteIntrinsics(folder_ / "camera.yaml", Odd());
  EXPECT_EQ(ReadIntrinsics(folder_ / "camera.yaml"), Odd());
}

TEST_F(IntrinsicsFileTest, FilesOfOpenCvAreRead) {
  const auto path = folder_ / "camera.yaml";
  test::WriteIntrinsics(path, Odd());
  cv::FileStorage in(path.string(), cv::FileStorage::READ);
  ASSERT_TRUE(in.isOpened());
  cv::Mat k;
  cv::Mat d;
  in["camera_matrix"] >> k;
  in["distortion_coefficients"] >> d;
  ASSERT_EQ(d.total(), 5U);
  for (const char* name : {"other.yml", "other.xml"}) {
    cv::FileStorage out((folder_ / name).string(), cv::FileStorage::WRITE);
    out << "calibration_time"
        << "today"
        << "image_width" << 720 << "image_height" << 576 << "camera_matrix" << k
        << "distortion_coefficients" << cv::Mat(d.t()) << "avg_reprojection_error" << 0.2;
    out.release();
    EXPECT_EQ(ReadIntrinsics(folder_ / name), Odd()) << name;
  }
}

// Files as written by ROS's camera_calibration, without OpenCV's first line and types.
TEST_F(IntrinsicsFileTest, RosFilesAreRead) {
  const auto path = Write(
      "image_width: 640\nimage_height: 480\ncamera_name: ecm_left\ncamera_matrix:\n  rows: 3\n  "
      "cols: 3\n  data: [700.5, 0., 319.5, 0., 701, 239.5, 0., 0., 1.]\ndistortion_model: "
      "plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.3, 0.1, 0., 0.001, "
      "0.]\n");
  const vision::CameraModel camera = ReadIntrinsics(path);
  EXPECT_EQ(camera.width, 640);
  EXPECT_EQ(camera.fx, 700.5);
  EXPECT_EQ(camera.fy, 701.0);
  EXPECT_EQ(camera.distortion[0], -0.3);
  EXPECT_EQ(camera.distortion[3], 0.001);
}

// The file has a list below its key, keys in another order, comments, and entries of other keys.
TEST_F(IntrinsicsFileTest, OtherWaysToWriteYamlAreRead) {
  const auto path = Write(
      "# made by hand\nother:\n  image_width: 1\n  rows: 7\n"
      "distortion_coefficients:\n  data:\n  - -0.3\n  - 0.1\n  - 0\n  - 1e-3\n  cols: 4\n  "
      "rows: 1\n\nimage_height : 480\r\nimage_width:   640   \ncamera_matrix:\n  rows: 3\n  "
      "cols: 3\n  data: [700.5, 0., 319.5,\n0., 701, 239.5,\n     0., 0., 1.]\n");
  const vision::CameraModel camera = ReadIntrinsics(path);
  EXPECT_EQ(camera.width, 640);
  EXPECT_EQ(camera.height, 480);
  EXPECT_EQ(camera.cy, 239.5);
  EXPECT_EQ(camera.distortion[0], -0.3);
  EXPECT_EQ(camera.distortion[3], 1e-3);
}

// OpenCV's parser crashed on the first file and threw an unhandled exception on the second.
TEST_F(IntrinsicsFileTest, FilesThatCrashOpenCvAreErrors) {
  for (const char* name : {"intr_segv.yml", "intr_length_error.yml"}) {
    const auto path = std::filesystem::path(DFR_REGRESSIONS) / "intrinsics" / name;
    EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] { (void)ReadIntrinsics(path); }),
                HasSubstr(name));
  }
}

TEST_F(IntrinsicsFileTest, ErrorsNameFileAndKey) {
  const std::string size = "image_width: 640\nimage_height: 480\n";
  const std::string k =
      "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [700., 0., 319.5, 0., 700., 239.5, 0., 0., "
      "1.]\n";
  const auto d = [](const std::string& data, int cols) {
    return "distortion_coefficients:\n  rows: 1\n  cols: " + std::to_string(cols) + "\n  data: [" +
           data + "]\n";
  };
  const std::pair<std::string, const char*> rows[] = {
      {"<?xml version=\"1.0\"?>\n<opencv", "neither YAML nor XML"},
      {std::string("image_width: 6\0", 15), "neither YAML nor XML"},
      {std::string(1 << 21, '#'), "longer than a mebibyte"},
      {k, "image_width is missing"},
      {"image_width: big\nimage_height: 1\n", "image_width is not a whole number"},
      {size, "camera_matrix is missing"},
      {size + "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 2",
       "camera_matrix has a list that does not end with ]"},
      {size + "camera_matrix:\n  rows: 2147483647\n  cols: 2147483647\n  data: []\n",
       "has 0 entries, not 2147483647 x 2147483647"},
      {size + "camera_matrix: 7\n", "camera_matrix is not a matrix"},
      {size + k, "distortion_coefficients is missing"},
      {size + k + d("1., 2., 3.", 3), "has 3 entries; supported: 4, 5"},
      {size + k + d("1., 2., 3.", 5), "has 3 entries, not 1 x 5"},
      {size + k + d("0., 0., 0., 0., 0., 0.1, 0., 0.", 8), "entry 6"},
      {size + k + d("0., 0., 0., 0., 0., 0.1, 0., 0.", 8), "CALIB_RATIONAL_MODEL"},
      {size + k + d("0., .Nan, 0., 0., 0.", 5),
       "distortion_coefficients has an entry that is not a finite number"},
      {"image_width: -640\nimage_height: 480\n" + k + d("0., 0., 0., 0.", 4),
       "camera_matrix is not valid"}};
  for (const auto& [text, words] : rows) EXPECT_THAT(ErrorOf(text), HasSubstr(words));
  EXPECT_THROW((void)ReadIntrinsics(folder_ / "none.yaml"), std::runtime_error);
}

}  // namespace
}  // namespace dfr::hardware
