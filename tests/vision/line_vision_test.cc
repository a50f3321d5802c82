#include "dfr/vision/line_vision.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::vision {
namespace {

constexpr double kDepth = 0.1;  // m; 7 pixels per millimetre

LineVisionOptions Options() {
  LineVisionOptions options;
  for (double y : {-0.025, 0.025}) {
    for (double x : {-0.036, -0.012, 0.012, 0.036}) options.target.marks_m.emplace_back(x, y);
  }
  options.p_cam_target.linear() << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  options.p_cam_target.translation().z() = kDepth;
  return options;
}

// A picture of a target seen perpendicularly by an ideal camera. Computes each pixel and shares no
// code with the tested library.
class Picture {
 public:
  double line_y = 0.002;  // m, on the target
  double line_slope = 0.05;
  bool line = true;
  double tip_x = 0.003;
  double tip_y = 0.004;
  bool tip = true;
  bool second_tip = false;
  std::vector<Eigen::Vector2d> marks = Options().target.marks_m;
  CameraModel camera;  // without distortion
  double depth = kDepth;

  void Draw() {
    data_.resize(static_cast<std::size_t>(camera.width) * camera.height * 3);
    half_width_ = 0.00075 * std::hypot(1.0, line_slope);
    core::Random random(1);
    for (int row = 0; row < camera.height; ++row) {
      for (int column = 0; column < camera.width; ++column) {
        double bgr[3] = {0, 0, 0};
        constexpr int kSub = 2;  // sub-pixels produce soft edges
        for (int i = 0; i < kSub; ++i) {
          for (int j = 0; j < kSub; ++j) {
            const double u = column + (j + 0.5) / kSub - 0.5;
            const double v = row + (i + 0.5) / kSub - 0.5;
            AddColor((u - camera.cx) / camera.fx * depth, -(v - camera.cy) / camera.fy * depth,
                     bgr);
          }
        }
        for (int c = 0; c < 3; ++c) {
          const double value = bgr[c] / (kSub * kSub) + 2.0 * random.Normal() + 0.5;
          const int entry = (row * camera.width + column) * 3 + c;
          data_[static_cast<std::size_t>(entry)] =
              static_cast<std::uint8_t>(std::fmin(255.0, std::fmax(0.0, value)));
        }
      }
    }
  }

  void Fill(std::uint8_t value) { std::fill(data_.begin(), data_.end(), value); }
  [[nodiscard]] ImageView view() const {
    return {data_.data(), camera.width, camera.height, static_cast<std::size_t>(camera.width) * 3};
  }

 private:
  void AddColor(double x, double y, double* bgr) const {
    const auto add = [bgr](double b, double g, double r) {
      bgr[0] += b;
      bgr[1] += g;
      bgr[2] += r;
    };
    const auto within = [](double dx, double dy, double r) { return dx * dx + dy * dy < r * r; };
    if (tip && within(x - tip_x, y - tip_y, 0.001)) return add(40, 160, 40);
    if (second_tip && within(x + tip_x, y + tip_y, 0.001)) return add(40, 160, 40);
    for (const Eigen::Vector2d& m : marks) {
      if (within(x - m.x(), y - m.y(), 0.002)) return add(160, 40, 30);
    }
    const double away = y - line_y - line_slope * x;
    if (line && std::fabs(away) < half_width_ && std::fabs(x) < 0.03) return add(30, 30, 180);
    add(190, 195, 200);
  }

  double half_width_ = 0.0;  // m, along y
  std::vector<std::uint8_t> data_;
};

CameraModel Camera() { return {}; }

Eigen::Hyperplane<double, 3> TipPlane() {
  return {Eigen::Vector3d::UnitZ(), Eigen::Vector3d(0.0, 0.0, kDepth)};
}

TEST(LineVisionTest, MeasuresWhatWasDrawnOnBothSidesOfTheLine) {
  LineVision vision(Camera(), Options());
  Picture picture;
  for (const double tip_y : {0.004, -0.001}) {
    picture.tip_y = tip_y;
    picture.Draw();
    const LineObservation seen = vision.Observe(picture.view(), TipPlane());
    ASSERT_TRUE(seen.seen()) << Name(seen.missing);
    const double distance = (tip_y - 0.002 - 0.05 * 0.003) / std::hypot(1.0, 0.05);
    // A hundredth of a pixel is 1.4 um. Noise of 2 levels moves a centre by a few hundredths.
    EXPECT_NEAR(seen.distance_m, distance, 2e-5);
    EXPECT_NEAR(seen.p_cam_tip.x(), 0.003, 2e-5);
    EXPECT_NEAR(seen.p_cam_tip.y(), -tip_y, 2e-5);
    EXPECT_NEAR(seen.p_cam_tip.z(), kDepth, 1e-12);  // the given plane
    EXPECT_NEAR(seen.tangent_cam.y() / seen.tangent_cam.x(), -0.05, 1e-3);
    EXPECT_NEAR(seen.p_cam_target.translation().z(), kDepth, 1e-4);
    EXPECT_GT(seen.confidence, 0.8);
  }
}

TEST(LineVisionTest, DetectsMarksOfAnySize) {
  Picture picture;
  picture.camera = {
      .width = 1920, .height = 1080, .fx = 2000, .fy = 2000, .cx = 959.5, .cy = 539.5};
  picture.depth = 0.11;
  LineVisionOptions options = Options();
  options.p_cam_target.translation().z() = picture.depth;  // a mark covers 4150 pixels
  picture.Draw();
  LineVision vision(picture.camera, options);
  std::vector<Eigen::Vector2d> marks;
  ASSERT_TRUE(vision.FindMarks(picture.view(), marks));
  for (std::size_t i = 0; i < marks.size(); ++i) {
    const Eigen::Vector2d& on_target = picture.marks[i];
    const Eigen::Vector3d p_cam(on_target.x(), -on_target.y(), picture.depth);
    EXPECT_LT((marks[i] - picture.camera.Project(p_cam)).norm(), 0.05) << i;
  }
  const LineObservation seen =
      vision.Observe(picture.view(), {Eigen::Vector3d::UnitZ(), Eigen::Vector3d(0, 0, 0.11)});
  EXPECT_TRUE(seen.seen()) << Name(seen.missing);
}

TEST(LineVisionTest, NamesTheMissingFeature) {
  LineVision vision(Camera(), Options());
  Picture picture;
  const auto reason = [&] {
    picture.Draw();
    return vision.Observe(picture.view(), TipPlane()).missing;
  };
  picture.line = false;
  EXPECT_EQ(reason(), NotSeen::kLine);
  picture.line = true;
  picture.tip = false;
  EXPECT_EQ(reason(), NotSeen::kTip);
  picture.tip = true;
  picture.second_tip = true;  // two candidates for the tip
  EXPECT_EQ(reason(), NotSeen::kTip);
  picture.second_tip = false;
  picture.marks.resize(4);  // a single row does not determine the target's tilt
  EXPECT_EQ(reason(), NotSeen::kTarget);
  picture.marks.resize(3);
  EXPECT_EQ(reason(), NotSeen::kTarget);
}

TEST(LineVisionTest, RefusesUnusablePictures) {
  LineVision vision(Camera(), Options());
  Picture picture;
  picture.Draw();
  EXPECT_TRUE(vision.Observe(picture.view(), TipPlane()).seen());
  EXPECT_EQ(vision.Observe(picture.view(), TipPlane()).missing, NotSeen::kFrozen);
  vision.ForgetLastImage();
  EXPECT_TRUE(vision.Observe(picture.view(), TipPlane()).seen());
  picture.Fill(0);
  EXPECT_EQ(vision.Observe(picture.view(), TipPlane()).missing, NotSeen::kDark);
  picture.Fill(255);
  EXPECT_EQ(vision.Observe(picture.view(), TipPlane()).missing, NotSeen::kOverexposed);
  ImageView small = picture.view();
  small.height = 400;
  EXPECT_EQ(vision.Observe(small, TipPlane()).missing, NotSeen::kWrongSize);
}

// A lens with another focal length produces the same picture at another distance. Another
// distortion bends the frame.
TEST(LineVisionTest, DetectsAnotherCamera) {
  Picture picture;
  picture.Draw();
  CameraModel other = Camera();
  other.fx = other.fy = 1100.0;
  LineVision longer(other, Options());
  EXPECT_FALSE(longer.Observe(picture.view(), TipPlane()).seen());
  other = Camera();
  other.distortion[0] = -0.3;
  LineVision bent(other, Options());
  EXPECT_EQ(bent.Observe(picture.view(), TipPlane()).missing, NotSeen::kForeignCamera);
}

TEST(LineVisionTest, InvalidOptionsThrow) {
  using Change = void (*)(LineVisionOptions&);
  for (const Change change :
       std::initializer_list<Change>{[](auto& o) { o.target.marks_m.resize(3); },
                                     [](auto& o) { o.p_cam_target.translation().z() = -kDepth; },
                                     [](auto& o) { o.target.tip_radius_m = 0.0; }}) {
    LineVisionOptions options = Options();
    change(options);
    EXPECT_THROW(LineVision(Camera(), options), std::invalid_argument);
  }
}

}  // namespace
}  // namespace dfr::vision
