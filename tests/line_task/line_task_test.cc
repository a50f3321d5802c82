#include "dfr/line_task/line_task.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/core/random.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/no_alloc.h"

namespace dfr::line_task {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

// At home the tip is at the world's origin, and the arm points straight down. The camera looks down
// from 0.1 m, with its x along the world's x.
LineTask StraightTask(const kinematics::PsmCorrection& arm = {}) {
  Eigen::Isometry3d p_world_base = Eigen::Isometry3d::Identity();
  p_world_base.translation() = -Psm::Tip(test::PsmHome());
  Eigen::Isometry3d p_world_cam = Eigen::Isometry3d::Identity();
  p_world_cam.linear() = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
  p_world_cam.translation().z() = 0.1;
  LineCalibration calibration;
  calibration.p_base_cam = p_world_base.inverse() * p_world_cam;
  calibration.arm = arm;
  return {calibration, p_world_base};
}

kinematics::PsmCorrection SomeCorrection() {
  kinematics::PsmCorrection arm;
  arm.offset << 0.02, -0.01, 0.002, 0.03, 0.01, -0.02;
  arm.scale << 0.01, -0.02, 0.015, 0.0, 0.02, 0.01;
  arm.reference = test::PsmHome();
  return arm;
}

TEST(LineTaskTest, AnSiArmReachesDeeper) {
  const LineTask classic = StraightTask();
  const LineTask si(classic.calibration(), classic.p_world_base(), kinematics::PsmGeneration::kSi);
  const Eigen::Vector3d deep(0.0, 0.0, -0.13);
  PsmJoints reading;
  EXPECT_FALSE(classic.Reading(deep, reading));
  ASSERT_TRUE(si.Reading(deep, reading));
  EXPECT_LT((si.Tip(reading) - deep).norm(), 1e-14);
  EXPECT_FALSE(si.Reading({std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0}, reading));
}

TEST(LineTaskTest, ReadingsPlaceTheToolUprightDespiteTheArmsErrors) {
  const LineTask task = StraightTask(SomeCorrection());
  core::Random random(3);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector3d tip(random.Uniform(-0.03, 0.03), random.Uniform(-0.03, 0.03),
                              random.Uniform(-0.01, 0.02));
    PsmJoints reading;
    ASSERT_TRUE(task.Reading(tip, reading));
    // The limit covers the rounding of a chain of six joints with lengths below 0.5 m.
    EXPECT_LT((task.Tip(reading) - tip).norm(), 1e-14);
    const Eigen::Isometry3d truth = Psm::Forward(task.calibration().arm.Apply(reading));
    EXPECT_LT((truth.linear() - Psm::Forward(test::PsmHome()).linear()).norm(), 1e-13);
  }
}

TEST(LineTaskTest, ControlsAreTwoMillimetresAUnitAndSaturate) {
  EXPECT_EQ(LineTask::Displacement(std::array{0.5, -0.25}), Eigen::Vector3d(0.001, -0.0005, 0.0));
  EXPECT_EQ(LineTask::Displacement(std::array{7.0, -1.5}), Eigen::Vector3d(0.002, -0.002, 0.0));
}

TEST(LineTaskTest, StatesAreInTheWorldFrameInMillimetres) {
  const LineTask task = StraightTask();
  vision::LineObservation seen;
  seen.missing = vision::NotSeen::kNothing;
  // The camera's y and z are opposite to the world's.
  seen.p_cam_tip = {0.004, -0.003, 0.09};
  seen.distance_m = -0.0015;
  seen.tangent_cam = {std::cos(0.2), -std::sin(0.2), 0.0};
  std::array<double, 4> state{};
  task.State(seen, state);
  const std::array<double, 4> expected = {4.0, 3.0, -1.5, 2.0};
  for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(state[i], expected[i], 1e-12) << i;

  seen.missing = vision::NotSeen::kLine;
  task.State(seen, state);
  for (const double entry : state) EXPECT_TRUE(std::isnan(entry));
}

TEST(LineTaskTest, ProgressIsTheLengthAlongTheLineOnAMovedGauze) {
  vision::LineObservation first;
  first.missing = vision::NotSeen::kNothing;
  first.p_cam_tip = {-0.02, 0.001, 0.0};
  vision::LineObservation now = first;
  now.line = {0.002, 0.1, 0.0};
  now.p_cam_target.translation() << 0.003, -0.002, 0.001;
  now.p_cam_tip = {0.023, 0.001, 0.0};  // x = 0.02 on the gauze
  EXPECT_NEAR(LineTask::Progress(first, now), 0.04 * std::sqrt(1.01), 1e-12);
  // An arc: the length of y = c x^2 has a closed form.
  now.line = {0.0, 0.0, 3.0};
  const double s = 2.0 * 3.0 * 0.02;
  EXPECT_NEAR(LineTask::Progress(first, now),
              2.0 * (s * std::sqrt(1.0 + s * s) + std::asinh(s)) / (4.0 * 3.0), 1e-9);
  std::swap(first, now);
  first.line = now.line = {0.0, 0.0, 0.0};
  EXPECT_NEAR(LineTask::Progress(first, now), -0.04, 1e-12) << "backwards";
  now.missing = vision::NotSeen::kTip;
  EXPECT_TRUE(std::isnan(LineTask::Progress(first, now)));
}

TEST(LineTaskTest, TheTipIsOnItsPlaneAndThePlaneIsLevel) {
  const LineTask task = StraightTask(SomeCorrection());
  PsmJoints reading;
  ASSERT_TRUE(task.Reading({0.01, -0.02, 0.004}, reading));
  const Eigen::Hyperplane<double, 3> plane = task.TipPlane(reading);
  // A tip at a height of 4 mm is 96 mm from the camera, like everything at that height.
  EXPECT_NEAR(plane.signedDistance(Eigen::Vector3d(0.01, 0.02, 0.096)), 0.0, 1e-14);
  EXPECT_NEAR(plane.signedDistance(Eigen::Vector3d(-0.03, 0.0, 0.096)), 0.0, 1e-14);
  EXPECT_NEAR(plane.absDistance(Eigen::Vector3d(0.0, 0.0, 0.1)), 0.004, 1e-14);
}

TEST(LineTaskTest, NeverAllocates) {
  const LineTask task = StraightTask();
  const vision::LineObservation unseen;
  std::array<double, 4> state{};
  PsmJoints reading;
  const test::NoAlloc no_alloc;
  ASSERT_TRUE(task.Reading(LineTask::Displacement(std::array{1.0, 1.0}), reading));
  static_cast<void>(task.TipPlane(reading));
  task.State(unseen, state);
}

}  // namespace
}  // namespace dfr::line_task
