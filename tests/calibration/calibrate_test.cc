#include "dfr/calibration/calibrate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <initializer_list>
#include <limits>
#include <span>
#include <sstream>
#include <string>
#include <utility>

#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::calibration {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;
using test::PsmHome;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<Eigen::Vector2d> Marks() {
  std::vector<Eigen::Vector2d> marks;
  for (double y : {-0.025, 0.025}) {
    for (double x : {-0.036, -0.012, 0.012, 0.036}) marks.emplace_back(x, y);
  }
  return marks;
}

Eigen::Isometry3d TargetInCamera() {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  pose.translation().z() = 0.125;
  return pose;
}

// The true calibration. The camera looks down at an angle to the tool, which points along -z of the
// arm's base.
line_task::LineCalibration True() {
  line_task::LineCalibration known;
  known.camera.fx = 705.0;
  known.camera.fy = 698.0;
  known.camera.cx = 321.0;
  known.camera.cy = 237.0;
  known.camera.distortion = {-0.15, 0.04, 6e-4, -5e-4, 0.0};
  Eigen::Isometry3d cam_base = Eigen::Isometry3d::Identity();
  cam_base.linear() = (Eigen::AngleAxisd(3.14159 - 0.7, Eigen::Vector3d::UnitX()) *
                       Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()))
                          .toRotationMatrix();
  cam_base.translation() =
      Eigen::Vector3d(0.0, 0.0, 0.12) - cam_base.linear() * Psm::Tip(PsmHome());
  known.p_base_cam = cam_base.inverse();
  known.arm.offset << 0.02, -0.015, 0.002, 0.03, -0.04, 0.05;
  known.arm.scale << 0.02, -0.01, 0.01, 0.0, 0.02, -0.02;
  known.arm.reference = PsmHome();
  return known;
}

line_task::LineCalibration Guess() {
  line_task::LineCalibration guess = True();
  guess.camera = vision::CameraModel{};
  guess.arm.offset.setZero();
  guess.arm.scale.setZero();
  guess.p_base_cam.translation() += Eigen::Vector3d(0.004, -0.006, 0.005);
  guess.p_base_cam.rotate(Eigen::AngleAxisd(0.04, Eigen::Vector3d::UnitX()));
  return guess;
}

// Records exact geometry plus noise, in pixels.
std::vector<vision::CalibrationFrame> Record(const line_task::LineCalibration& known, int count,
                                             double mark_noise, double tip_noise) {
  core::Random random(1);
  std::vector<vision::CalibrationFrame> frames;
  const auto noisy = [&random](const Eigen::Vector2d& p, double sd) {
    return Eigen::Vector2d(p.x() + sd * random.Normal(), p.y() + sd * random.Normal());
  };
  for (int i = 0; i < count; ++i) {
    vision::CalibrationFrame frame;
    Eigen::Isometry3d target = TargetInCamera();
    target.translation() += Eigen::Vector3d(
        random.Uniform(-0.006, 0.006), random.Uniform(-0.006, 0.006), random.Uniform(-0.01, 0.01));
    target.rotate(Eigen::AngleAxisd(random.Uniform(-0.15, 0.15), Eigen::Vector3d::UnitX()));
    target.rotate(Eigen::AngleAxisd(random.Uniform(-0.15, 0.15), Eigen::Vector3d::UnitY()));
    for (const Eigen::Vector2d& m : Marks()) {
      frame.marks_px.push_back(
          noisy(known.camera.Project(target * Eigen::Vector3d(m.x(), m.y(), 0.0)), mark_noise));
    }
    PsmJoints q = PsmHome();
    q[0] += random.Uniform(-0.25, 0.25);
    q[1] += random.Uniform(-0.2, 0.2);
    q[2] += random.Uniform(-0.02, 0.01);
    for (int k = 3; k < 6; ++k) q[k] += random.Uniform(-0.3, 0.3);
    frame.touching = i % 2 == 0;
    if (frame.touching) {
      // Finds the insertion that brings the tip to the plane, by the secant method.
      const auto above = [&](double insertion) {
        q[2] = insertion;
        return (target.inverse() * known.TipInCamera(q)).z();
      };
      double a = 0.11;
      double b = 0.12;
      for (int k = 0; k < 8; ++k) {
        const double above_a = above(a);
        const double above_b = above(b);
        if (above_a == above_b) break;
        a = std::exchange(b, b - above_b * (b - a) / (above_b - above_a));
      }
      q[2] = b;
    }
    std::copy_n(q.data(), 6, frame.joints.begin());
    frame.tip_px = noisy(known.camera.Project(known.TipInCamera(q)), tip_noise);
    frames.push_back(frame);
  }
  return frames;
}

double MeanTipError(const line_task::LineCalibration& a, const line_task::LineCalibration& b) {
  core::Random random(2);
  double sum = 0.0;
  for (int i = 0; i < 200; ++i) {
    PsmJoints q = PsmHome();
    for (int k = 0; k < 6; ++k) q[k] += (k == 2 ? 0.015 : 0.2) * random.Uniform(-1.0, 1.0);
    sum += (a.TipInCamera(q) - b.TipInCamera(q)).norm();
  }
  return sum / 200;
}

// The effect of the priors is negligible for such accurate data.
TEST(CalibrateTest, FindsTheTruthInExactData) {
  const line_task::LineCalibration known = True();
  CalibrationSummary summary;
  CalibrateOptions options;
  options.tip_sd_px = 0.05;
  options.touch_sd_m = 1e-5;
  const line_task::LineCalibration found =
      Calibrate(Record(known, 60, 0.0, 0.0), Marks(), Guess(), TargetInCamera(), options, &summary);
  EXPECT_TRUE(summary.converged) << summary.message;
  EXPECT_LT(summary.mark_rms_px, 0.01);
  EXPECT_LT(summary.tip_rms_px, 0.05);
  EXPECT_NEAR(found.camera.fx, known.camera.fx, 1.0);
  EXPECT_NEAR(found.camera.distortion[0], known.camera.distortion[0], 5e-3);
  EXPECT_LT(MeanTipError(found, known), 1e-4);
  EXPECT_GT(MeanTipError(Guess(), known), 3e-3);
}

TEST(CalibrateTest, UncertaintyCoversTheErrorOfNoisyData) {
  const line_task::LineCalibration known = True();
  CalibrationSummary summary;
  const line_task::LineCalibration found =
      Calibrate(Record(known, 80, 0.05, 2.0), Marks(), Guess(), TargetInCamera(), {}, &summary);
  ASSERT_TRUE(summary.converged && summary.has_covariance) << summary.message;
  EXPECT_NEAR(summary.mark_rms_px, 0.05 * std::sqrt(2.0), 0.02);
  EXPECT_NEAR(summary.tip_rms_px, 2.0 * std::sqrt(2.0), 0.7);
  // Each error is below four standard deviations. The robust loss makes the standard deviations
  // slightly too small.
  EXPECT_LT(std::abs(found.camera.fx - known.camera.fx), 4 * summary.camera_sd[0]);
  EXPECT_LT(std::abs(found.camera.cx - known.camera.cx), 4 * summary.camera_sd[2]);
  for (int k = 0; k < 6; ++k) {
    const double sd = summary.offset_sd[static_cast<std::size_t>(k)];
    EXPECT_GT(sd, 0.0);
    EXPECT_LT(std::abs(found.arm.offset[k] - known.arm.offset[k]), 4 * sd) << k;
  }
  EXPECT_LT(MeanTipError(found, known), 1e-3);
  std::ostringstream table;
  Print(table, found, summary);
  EXPECT_NE(table.str().find("wrist yaw offset"), std::string::npos);
  EXPECT_NE(table.str().find("+-"), std::string::npos);
}

TEST(CalibrateTest, AKnownCameraStays) {
  const line_task::LineCalibration known = True();
  line_task::LineCalibration guess = Guess();
  guess.camera = known.camera;
  CalibrateOptions options;
  options.known_camera = true;
  options.tip_sd_px = 0.05;
  options.touch_sd_m = 1e-5;
  CalibrationSummary summary;
  const line_task::LineCalibration found =
      Calibrate(Record(known, 60, 0.05, 0.05), Marks(), guess, TargetInCamera(), options, &summary);
  EXPECT_EQ(found.camera, known.camera);
  EXPECT_TRUE(summary.converged) << summary.message;
  EXPECT_TRUE(summary.has_covariance);
  EXPECT_EQ(summary.camera_sd, (std::array<double, 9>{}));
  EXPECT_LT(MeanTipError(found, known), 2e-4);
}

TEST(CalibrateTest, WrongDetectionsDoNotCount) {
  const line_task::LineCalibration known = True();
  std::vector<vision::CalibrationFrame> frames = Record(known, 80, 0.05, 0.5);
  for (std::size_t i = 0; i < frames.size(); i += 10) {
    frames[i].tip_px += Eigen::Vector2d(150.0, -80.0);
    frames[i].marks_px[1] += Eigen::Vector2d(20.0, 20.0);
    frames[i].marks_px[2] = {kNaN, kNaN};
  }
  const line_task::LineCalibration found = Calibrate(frames, Marks(), Guess(), TargetInCamera());
  EXPECT_LT(MeanTipError(found, known), 1e-3);
}

TEST(CalibrateTest, TooLittleOrBrokenDataThrows) {
  using Frames = std::vector<vision::CalibrationFrame>;
  using Spoil = void (*)(Frames&);
  const Frames frames = Record(True(), 20, 0.0, 0.0);
  for (const Spoil spoil :
       std::initializer_list<Spoil>{[](Frames& all) { all.resize(9); },
                                    [](Frames& all) {
                                      for (auto& frame : all) frame.tip_px = {kNaN, kNaN};
                                    },
                                    [](Frames& all) { all[3].marks_px.pop_back(); },
                                    [](Frames& all) { all[3].joints[1] = kNaN; }}) {
    Frames broken = frames;
    spoil(broken);
    EXPECT_THROW(static_cast<void>(Calibrate(broken, Marks(), Guess(), TargetInCamera())),
                 std::invalid_argument);
  }
}

TEST(CalibrateTest, FilesKeepEveryBitAndOtherFilesAreRefused) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "calibration.dfr";
  line_task::LineCalibration known = True();
  known.provenance = {core::Origin::kReal, "PSM1", "A7", "left eye", "2026-11-23"};
  known.Save(path);
  const line_task::LineCalibration loaded = line_task::LineCalibration::Load(path);
  EXPECT_EQ(loaded.camera, known.camera);
  EXPECT_EQ(loaded.p_base_cam.matrix(), known.p_base_cam.matrix());
  EXPECT_EQ(loaded.arm.offset, known.arm.offset);
  EXPECT_EQ(loaded.arm.scale, known.arm.scale);
  EXPECT_EQ(loaded.arm.reference, known.arm.reference);
  EXPECT_EQ(loaded.provenance, known.provenance);
  std::filesystem::resize_file(path, 100);
  EXPECT_THROW(static_cast<void>(line_task::LineCalibration::Load(path)), std::runtime_error);
  core::ArchiveWriter("calibration", 1).Save(path);
  EXPECT_THAT(
      test::MessageOf<std::runtime_error>([&] { (void)line_task::LineCalibration::Load(path); }),
      testing::HasSubstr("is a calibration file of version 1"));
}

}  // namespace
}  // namespace dfr::calibration
