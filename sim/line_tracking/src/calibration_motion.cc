#include "dfr/sim/line_tracking/calibration_motion.h"

#include <algorithm>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"

namespace dfr::sim {
namespace {

// Returns a reachable random pose of the platform: a random pose in a larger range, scaled towards
// home until it is reachable.
kinematics::PlatformPose RandomPlatform(core::Random& random) {
  kinematics::PlatformPose pose;
  pose.translation_m = {random.Uniform(-0.008, 0.008), random.Uniform(-0.006, 0.006),
                        random.Uniform(-0.012, 0.006)};
  pose.angles_rad = {random.Uniform(-0.12, 0.12), random.Uniform(-0.12, 0.12),
                     random.Uniform(-0.1, 0.1)};
  const double share = 0.95 * kinematics::SprkPlatform::ReachableShare(pose);
  pose.translation_m *= share;
  pose.angles_rad *= share;
  return pose;
}

void MoveTipAnywhere(LineTrackingPlant& plant, core::Random& random) {
  while (!plant.MoveTip(
      {random.Uniform(-0.03, 0.03), random.Uniform(-0.02, 0.015), random.Uniform(0.002, 0.032)})) {
  }
}

// Moves the tip straight down, or up, until the true tip is in the gauze's plane, like an operator
// who feels the contact.
bool Touch(LineTrackingPlant& plant, core::Random& random) {
  Eigen::Vector3d command(random.Uniform(-0.03, 0.03), random.Uniform(-0.02, 0.015), 0.003);
  for (int i = 0; i < 8; ++i) {
    if (!plant.MoveTip(command)) return false;
    const LineTrackingTruth truth = plant.truth();
    command.z() -= (truth.p_world_gauze.inverse() * truth.tip_m).z();
  }
  return true;
}

}  // namespace

line_task::LineCalibration NominalCalibration() {
  line_task::LineCalibration nominal;
  nominal.camera = vision::CameraModel{};
  Eigen::Isometry3d world_cam = LineTrackingPlant::p_world_cam();
  Eigen::Matrix3d down;
  down << 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0;
  world_cam.linear() = down;
  world_cam.translation() = Eigen::Vector3d(0.0, 0.0, 0.124);
  nominal.p_base_cam = LineTrackingPlant::p_world_base().inverse() * world_cam;
  nominal.arm.reference[2] = 0.12;
  return nominal;
}

std::vector<vision::CalibrationFrame> RecordCalibrationMotion(LineTrackingPlant& plant, int frames,
                                                              std::uint64_t seed) {
  DFR_THROW_UNLESS(frames > 0, "calibration motion: frames must be positive, not " << frames);
  const line_task::LineCalibration nominal = NominalCalibration();
  vision::LineVisionOptions options;
  options.target = LineTrackingPlant::target();
  options.p_cam_target = (LineTrackingPlant::p_world_base() * nominal.p_base_cam).inverse();
  vision::LineVision vision(nominal.camera, options);
  core::Random random(seed);
  std::vector<std::uint8_t> picture(plant.endoscope().image_size());
  std::vector<vision::CalibrationFrame> recorded;
  for (int i = 0; i < frames; ++i) {
    plant.MovePlatform(RandomPlatform(random));
    vision::CalibrationFrame frame;
    frame.touching = i % 2 == 0 && Touch(plant, random);
    if (!frame.touching) MoveTipAnywhere(plant, random);
    plant.RenderEndoscope(picture);
    const kinematics::PsmJoints joints = plant.reported_joints();
    std::copy_n(joints.data(), 6, frame.joints.begin());
    frame.tip_px = vision.FindTip(plant.endoscope().View(picture.data()));
    if (vision.FindMarks(plant.endoscope().View(picture.data()), frame.marks_px)) {
      recorded.push_back(std::move(frame));
    }
  }
  return recorded;
}

std::vector<double> HeldOutTipErrors(LineTrackingPlant& plant,
                                     const line_task::LineCalibration& calibration, int poses,
                                     std::uint64_t seed) {
  core::Random random(seed);
  const Eigen::Isometry3d cam_from_world = LineTrackingPlant::p_world_cam().inverse();
  const Eigen::Isometry3d cam_from_base = calibration.p_base_cam.inverse();
  std::vector<double> errors_mm;
  for (int i = 0; i < poses; ++i) {
    MoveTipAnywhere(plant, random);
    const Eigen::Vector3d known =
        cam_from_base * kinematics::Psm::Tip(calibration.arm.Apply(plant.reported_joints()));
    errors_mm.push_back(1e3 * (known - cam_from_world * plant.truth().tip_m).norm());
  }
  return errors_mm;
}

}  // namespace dfr::sim
