#include <array>
#include <cmath>
#include <stdexcept>

#include "dfr/core/files/archive.h"
#include "dfr/line_task/line_task.h"

namespace dfr::line_task {
namespace {

constexpr int kVersion = 2;

template <typename Vector>
void Append(core::ArchiveWriter& archive, const Vector& v) {
  archive.Numbers({v.data(), static_cast<std::size_t>(v.size())});
}

template <typename Vector>
void Read(core::ArchiveReader& archive, Vector& v) {
  const std::vector<double> numbers = archive.Numbers();
  if (numbers.size() != static_cast<std::size_t>(v.size())) {
    archive.Fail("holds " + std::to_string(numbers.size()) + " numbers where " +
                 std::to_string(v.size()) + " are needed");
  }
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    if (!std::isfinite(numbers[i])) archive.Fail("holds a number that is not finite");
    v.data()[i] = numbers[i];
  }
}

}  // namespace

Eigen::Vector3d LineCalibration::TipInCamera(const kinematics::PsmJoints& joints) const noexcept {
  return p_base_cam.inverse() * kinematics::Psm::Tip(arm.Apply(joints));
}

void LineCalibration::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter archive("calibration", kVersion);
  archive.Integer(camera.width);
  archive.Integer(camera.height);
  Append(archive, std::array{camera.fx, camera.fy, camera.cx, camera.cy});
  Append(archive, camera.distortion);
  const Eigen::Matrix4d pose = p_base_cam.matrix();
  Append(archive, pose);
  Append(archive, arm.offset);
  Append(archive, arm.scale);
  Append(archive, arm.reference);
  archive.Text(core::ToText(provenance));
  archive.Save(path);
}

LineCalibration LineCalibration::Load(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, "calibration", kVersion);
  LineCalibration loaded;
  loaded.camera.width = archive.IntegerIn(1, 1 << 16);
  loaded.camera.height = archive.IntegerIn(1, 1 << 16);
  std::array<double, 4> pinhole{};
  Read(archive, pinhole);
  loaded.camera.fx = pinhole[0];
  loaded.camera.fy = pinhole[1];
  loaded.camera.cx = pinhole[2];
  loaded.camera.cy = pinhole[3];
  Read(archive, loaded.camera.distortion);
  Eigen::Matrix4d pose;
  Read(archive, pose);
  Read(archive, loaded.arm.offset);
  Read(archive, loaded.arm.scale);
  Read(archive, loaded.arm.reference);
  const std::string made = archive.Text();
  archive.End();
  loaded.p_base_cam.matrix() = pose;
  const Eigen::Matrix3d r = loaded.p_base_cam.linear();
  if (!(r * r.transpose()).isIdentity(1e-9))
    archive.Fail("the camera's rotation is not a rotation matrix");
  try {
    loaded.camera.Check();
    loaded.provenance = core::ParseProvenance(made);
  } catch (const std::invalid_argument& error) {
    archive.Fail(error.what());
  }
  return loaded;
}

}  // namespace dfr::line_task
