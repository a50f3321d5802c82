#include "scene/line_tracking_scene.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "dfr/core/contract.h"
#include "dfr/kinematics/sprk_platform.h"
#include "line_tracking.xml.h"

namespace dfr::sim::internal {
namespace {

using kinematics::PlatformPose;
using kinematics::PsmJoints;
using kinematics::SprkPlatform;

void SetPose(const Eigen::Isometry3d& pose, mjtNum* position, mjtNum* quaternion) noexcept {
  Eigen::Map<Eigen::Vector3d>(position, 3) = pose.translation();
  const Eigen::Quaterniond q(pose.linear());
  quaternion[0] = q.w();
  quaternion[1] = q.x();
  quaternion[2] = q.y();
  quaternion[3] = q.z();
}

// Returns the displacement of the gauze's pose from home.
PlatformPose ToPlatformPose(const Eigen::Isometry3d& pose) noexcept {
  const Eigen::Matrix3d r = pose.linear();
  PlatformPose displacement;
  displacement.translation_m = pose.translation();
  displacement.angles_rad = {std::atan2(r(2, 1), r(2, 2)), -std::asin(r(2, 0)),
                             std::atan2(r(1, 0), r(0, 0))};
  return displacement;
}

// Triangle wave between -1 and 1 with period 1.
double Triangle(double t) noexcept { return 4.0 * std::abs(t - std::floor(t) - 0.5) - 1.0; }

}  // namespace

SceneModel::SceneModel(const ScenePlaces& places)
    : model_(LoadMujocoModel(embedded::kLineTrackingXml, "sim/line_tracking")) {
  mjModel& m = *model_;
  const auto joint = [&m](const char* name) {
    return m.jnt_qposadr[MujocoId(m, mjOBJ_JOINT, name)];
  };
  joint_qpos = {joint("yaw"),  joint("pitch"),       joint("insertion"),
                joint("roll"), joint("wrist_pitch"), joint("wrist_yaw")};
  tip_site = MujocoId(m, mjOBJ_SITE, "tip");
  gauze_body = MujocoId(m, mjOBJ_BODY, "gauze");
  gauze_mocap = m.body_mocapid[gauze_body];
  gauze_texture = MujocoId(m, mjOBJ_TEXTURE, "gauze");

  const int base = MujocoId(m, mjOBJ_BODY, "psm_base");
  SetPose(places.p_world_base, m.body_pos + 3 * base, m.body_quat + 4 * base);
  // MuJoCo's cameras look along -z with y up. OpenCV's cameras look along z with y down.
  Eigen::Isometry3d camera = places.p_world_cam;
  camera.linear().col(1) *= -1.0;
  camera.linear().col(2) *= -1.0;
  const int endoscope = MujocoId(m, mjOBJ_CAMERA, "endoscope");
  SetPose(camera, m.cam_pos + 3 * endoscope, m.cam_quat + 4 * endoscope);
  m.cam_fovy[endoscope] = places.camera_fovy_rad * 180.0 / std::numbers::pi;

  DFR_THROW_UNLESS(places.marks_m.size() == 8,
                   "the scene has 8 marks, not " << places.marks_m.size());
  for (std::size_t i = 0; i < places.marks_m.size(); ++i) {
    mjtNum* const position = m.geom_pos + 3 * MujocoId(m, mjOBJ_GEOM, "mark" + std::to_string(i));
    position[0] = places.marks_m[i].x();
    position[1] = places.marks_m[i].y();
  }
  for (int i = 0; i < 6; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto rod = [&](const std::string& name, double length) {
      const std::string numbered = name + std::to_string(i);
      m.geom_size[3 * MujocoId(m, mjOBJ_GEOM, numbered) + 1] = 0.5 * length;
      return m.body_mocapid[MujocoId(m, mjOBJ_BODY, numbered)];
    };
    arm_mocap[k] = rod("arm", SprkPlatform::kArmLength);
    leg_mocap[k] = rod("leg", SprkPlatform::kLegLength);
  }
}

MjModelPtr SceneModel::CopyMj() const { return MjModelPtr(mj_copyModel(nullptr, model_.get())); }

SceneData::SceneData(const SceneModel& model) : model_(&model), data_(mj_makeData(&model.mj())) {
  Place(PsmJoints::Zero(), Eigen::Isometry3d::Identity());
}

void SceneData::Place(const PsmJoints& joints, const Eigen::Isometry3d& p_world_gauze) noexcept {
  mjData& d = *data_;
  for (int i = 0; i < 6; ++i) d.qpos[model_->joint_qpos[static_cast<std::size_t>(i)]] = joints[i];
  SetPose(p_world_gauze, d.mocap_pos + 3 * model_->gauze_mocap,
          d.mocap_quat + 4 * model_->gauze_mocap);
  mj_kinematics(&model_->mj(), &d);
}

void SceneData::PlaceLegs() noexcept {
  const Eigen::Isometry3d gauze = p_world_gauze();
  const Eigen::Vector3d down(0.0, 0.0, -SprkPlatform::kHomeHeight);
  std::array<double, 6> servo{};
  // The positioning error may move the plate slightly out of reach: the arms are then drawn flat.
  if (!SprkPlatform::Inverse(ToPlatformPose(gauze), servo)) servo.fill(0.0);
  for (int i = 0; i < 6; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const Eigen::Vector3d elbow = down + SprkPlatform::ArmEnd(i, servo[k]);
    PlaceRod(model_->arm_mocap[k], down + SprkPlatform::ServoAxis(i), elbow);
    PlaceRod(model_->leg_mocap[k], elbow, gauze * SprkPlatform::PlateJoint(i));
  }
}

void SceneData::PlaceRod(int mocap, const Eigen::Vector3d& from,
                         const Eigen::Vector3d& to) noexcept {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = 0.5 * (from + to);
  // Uses the smallest rotation from the z-axis to the rod; about the x-axis if the rod points down.
  const Eigen::Vector3d along = (to - from).normalized();
  const double twice_cosine = std::sqrt(2.0 * (1.0 + along.z()));
  const double scale = 1.0 / twice_cosine;
  const Eigen::Quaterniond rotation =
      twice_cosine < 1e-6
          ? Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0)
          : Eigen::Quaterniond(0.5 * twice_cosine, -along.y() * scale, along.x() * scale, 0.0);
  pose.linear() = rotation.toRotationMatrix();
  SetPose(pose, data_->mocap_pos + 3 * mocap, data_->mocap_quat + 4 * mocap);
}

Eigen::Vector3d SceneData::tip_m() const noexcept {
  return Eigen::Map<const Eigen::Vector3d>(data_->site_xpos + 3 * model_->tip_site);
}

Eigen::Isometry3d SceneData::p_world_gauze() const noexcept {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = Eigen::Map<const Eigen::Vector3d>(data_->xpos + 3 * model_->gauze_body);
  pose.linear() = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(
      data_->xmat + 9 * model_->gauze_body);
  return pose;
}

void DrawGauze(const SceneModel& scene, const GauzeLine& line, bool with_line, mjModel& model) {
  const int geom = MujocoId(model, mjOBJ_GEOM, "gauze");
  const double half_x = model.geom_size[3 * geom];
  const double half_y = model.geom_size[3 * geom + 1];
  const int width = model.tex_width[scene.gauze_texture];
  const int height = model.tex_height[scene.gauze_texture];
  const double texel_x = 2.0 * half_x / width;
  const double texel_y = 2.0 * half_y / height;
  constexpr double kHalfWidth = 0.5 * kLineWidth;
  // Returns the covered fraction of a texel at distance `inside` m inside an edge.
  const auto cover = [](double inside, double texel) {
    return std::clamp(0.5 + inside / texel, 0.0, 1.0);
  };
  mjtByte* pixel = model.tex_rgb + model.tex_adr[scene.gauze_texture];
  for (int row = 0; row < height; ++row) {
    const double y = half_y - (row + 0.5) * texel_y;
    const double weave_y = 0.03 * Triangle(y * 1000.0);
    for (int column = 0; column < width; ++column, pixel += 3) {
      const double x = (column + 0.5) * texel_x - half_x;
      // Threads every millimetre, in both directions.
      const double weave = 1.0 + 0.03 * Triangle(x * 1000.0) + weave_y;
      const double slope = line.SlopeAt(x);
      const double away = std::abs(y - line.At(x)) / std::sqrt(1.0 + slope * slope);
      const double red = with_line ? std::min(cover(kHalfWidth - away, texel_y),
                                              cover(kLineHalfLength - std::abs(x), texel_x))
                                   : 0.0;
      const auto blend = [&](double gauze, double ink) {
        return static_cast<mjtByte>(std::lround(255.0 * weave * (gauze + red * (ink - gauze))));
      };
      pixel[0] = blend(0.81, 0.70);
      pixel[1] = blend(0.79, 0.10);
      pixel[2] = blend(0.76, 0.12);
    }
  }
}

}  // namespace dfr::sim::internal
