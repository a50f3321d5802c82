#include "dfr/hardware/intrinsics_file.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <opencv2/core.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <vector>

namespace dfr::hardware {
namespace {

class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : file_(path.string()) {
    std::ifstream in(path, std::ios::binary);
    std::ostringstream content;
    if (!in || !(content << in.rdbuf())) {
      Fail(std::string("cannot be read: ") + std::strerror(errno));
    }
    std::string text = content.str();
    // ROS leaves the line out that OpenCV knows its files by.
    if (text.rfind("%YAML", 0) != 0 && text.rfind("<?xml", 0) != 0) {
      text = "%YAML:1.0\n---\n" + text;
    }
    try {
      if (!storage_.open(text, cv::FileStorage::READ | cv::FileStorage::MEMORY)) {
        Fail("is neither YAML nor XML as OpenCV reads them");
      }
    } catch (const cv::Exception& e) {
      Fail("is neither YAML nor XML as OpenCV reads them: " + e.err);
    }
  }

  [[noreturn]] void Fail(const std::string& what) const {
    throw std::runtime_error(file_ + ": " + what);
  }

  int Integer(const char* key) const {
    const cv::FileNode node = Node(key);
    if (!node.isInt()) Fail(std::string(key) + " is not a whole number");
    return static_cast<int>(node);
  }

  std::vector<double> Matrix(const char* key, int& rows, int& cols) const {
    const cv::FileNode node = Node(key);
    std::vector<double> values;
    try {
      if (node.isMap() && node["data"].isSeq() && node["rows"].isInt() && node["cols"].isInt()) {
        rows = static_cast<int>(node["rows"]);
        cols = static_cast<int>(node["cols"]);
        for (const cv::FileNode& entry : node["data"]) {
          if (!entry.isInt() && !entry.isReal()) {
            Fail(std::string(key) + " has an entry that is not a number");
          }
          values.push_back(static_cast<double>(entry));
        }
      } else {
        Fail(std::string(key) + " is not a matrix (rows, cols, data)");
      }
    } catch (const cv::Exception& e) {
      Fail(std::string(key) + " is not a matrix: " + e.err);
    }
    if (rows < 0 || cols < 0 ||
        static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols) != values.size()) {
      Fail(std::string(key) + " has " + std::to_string(values.size()) + " entries, not " +
           std::to_string(rows) + " x " + std::to_string(cols));
    }
    for (const double value : values) {
      if (!std::isfinite(value)) Fail(std::string(key) + " has an entry that is not finite");
    }
    return values;
  }

 private:
  cv::FileNode Node(const char* key) const {
    const cv::FileNode node = storage_[key];
    if (node.empty()) {
      Fail(std::string(key) +
           " is missing; a calibration has image_width, image_height, camera_matrix and "
           "distortion_coefficients");
    }
    return node;
  }

  std::string file_;
  cv::FileStorage storage_;
};

}  // namespace

vision::CameraModel ReadIntrinsics(const std::filesystem::path& path) {
  const Reader reader(path);
  vision::CameraModel camera;
  camera.width = reader.Integer("image_width");
  camera.height = reader.Integer("image_height");
  int rows = 0;
  int cols = 0;
  const std::vector<double> k = reader.Matrix("camera_matrix", rows, cols);
  if (rows != 3 || cols != 3) reader.Fail("camera_matrix is not 3 x 3");
  if (k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0) {
    reader.Fail("camera_matrix is not (fx 0 cx; 0 fy cy; 0 0 1): skew is not supported");
  }
  camera.fx = k[0];
  camera.fy = k[4];
  camera.cx = k[2];
  camera.cy = k[5];
  const std::vector<double> d = reader.Matrix("distortion_coefficients", rows, cols);
  if (d.size() != 4 && d.size() != 5 && d.size() != 8 && d.size() != 12 && d.size() != 14) {
    reader.Fail("distortion_coefficients has " + std::to_string(d.size()) +
                " entries; known are 4, 5, 8, 12 and 14");
  }
  for (std::size_t i = 0; i < d.size(); ++i) {
    if (i < camera.distortion.size()) {
      camera.distortion[i] = d[i];
    } else if (d[i] != 0.0) {
      reader.Fail("distortion_coefficients: entry " + std::to_string(i + 1) +
                  " belongs to a model that is not supported; calibrate with k1, k2, p1, p2, k3 "
                  "alone (no CALIB_RATIONAL_MODEL)");
    }
  }
  try {
    camera.Check();
  } catch (const std::invalid_argument& e) {
    reader.Fail(std::string("camera_matrix makes no camera: ") + e.what());
  }
  return camera;
}

void WriteIntrinsics(const std::filesystem::path& path, const vision::CameraModel& camera) {
  camera.Check();
  cv::FileStorage storage(".yml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY);
  storage << "image_width" << camera.width << "image_height" << camera.height;
  storage << "camera_matrix"
          << cv::Mat(
                 cv::Matx33d(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0));
  cv::Mat distortion(1, 5, CV_64F);
  std::copy(camera.distortion.begin(), camera.distortion.end(), distortion.begin<double>());
  storage << "distortion_coefficients" << distortion;
  const std::string text = storage.releaseAndGetString();
  // Beside it, and renamed when it is whole: a full disk leaves the old one.
  const std::filesystem::path temporary = path.string() + ".part";
  errno = 0;
  std::ofstream out(temporary, std::ios::binary);
  out << text;
  out.close();
  std::error_code error;
  if (out) std::filesystem::rename(temporary, path, error);
  if (!out || error) {
    const std::string why = error ? error.message() : std::strerror(errno);
    std::filesystem::remove(temporary, error);
    throw std::runtime_error(path.string() + ": cannot be written: " + why);
  }
}

}  // namespace dfr::hardware
