// Arbitrary pictures: detected features have finite numbers, and missing features have a reason.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "dfr/vision/line_vision.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

namespace {

constexpr int kWidth = 160;
constexpr int kHeight = 120;

dfr::vision::LineVision Vision() {
  dfr::vision::CameraModel camera;
  camera.width = kWidth;
  camera.height = kHeight;
  camera.fx = camera.fy = 175.0;
  camera.cx = (kWidth - 1) / 2.0;
  camera.cy = (kHeight - 1) / 2.0;
  dfr::vision::LineVisionOptions options;
  for (const double y : {-0.025, 0.025}) {
    for (const double x : {-0.036, -0.012, 0.012, 0.036}) options.target.marks_m.emplace_back(x, y);
  }
  options.p_cam_target.linear() << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  options.p_cam_target.translation().z() = 0.1;
  return {camera, options};
}

// Returns a grey picture with coloured rectangles. Each rectangle uses seven bytes of the input.
std::vector<std::uint8_t> Picture(const std::uint8_t* data, std::size_t size) {
  std::vector<std::uint8_t> pixels(std::size_t{3} * kWidth * kHeight, 128);
  constexpr std::size_t kRectangle = 7;
  for (; size >= kRectangle; data += kRectangle, size -= kRectangle) {
    const int left = data[0] * kWidth / 256;
    const int top = data[1] * kHeight / 256;
    for (int row = top; row < std::min(kHeight, top + data[2] / 4); ++row) {
      for (int column = left; column < std::min(kWidth, left + data[3]); ++column) {
        for (int c = 0; c < 3; ++c) {
          pixels[3 * (static_cast<std::size_t>(row) * kWidth + column) + c] = data[4 + c];
        }
      }
    }
  }
  return pixels;
}

}  // namespace

DFR_FUZZ_TARGET(vision) {
  static dfr::vision::LineVision vision = Vision();
  const auto pixels = Picture(data, size);
  const Eigen::Hyperplane<double, 3> plane(Eigen::Vector3d::UnitZ(), -0.09);
  vision.ForgetLastImage();
  const auto seen = vision.Observe({.data = pixels.data(),
                                    .width = kWidth,
                                    .height = kHeight,
                                    .stride = std::size_t{3} * kWidth},
                                   plane);
  if (!(seen.confidence >= 0.0 && seen.confidence <= 1.0)) std::abort();
  if (seen.seen() && !(std::isfinite(seen.distance_m) && seen.p_cam_tip.allFinite() &&
                       std::abs(seen.tangent_cam.norm() - 1.0) < 1e-6 && seen.line.allFinite())) {
    std::abort();
  }
  std::vector<Eigen::Vector2d> marks(8);
  static_cast<void>(vision.FindTip({pixels.data(), kWidth, kHeight, std::size_t{3} * kWidth}));
  static_cast<void>(
      vision.FindMarks({pixels.data(), kWidth, kHeight, std::size_t{3} * kWidth}, marks));
  return 0;
}
