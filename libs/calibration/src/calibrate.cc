#include "dfr/calibration/calibrate.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <ostream>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/kinematics/psm_chain.h"

namespace dfr::calibration {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

// fx, fy, cx, cy, k1, k2, p1, p2, k3
using CameraBlock = std::array<double, 9>;
// Rotation as angle times axis, then translation.
using PoseBlock = std::array<double, 6>;
// Offsets, then scales.
using ArmBlock = std::array<double, 12>;

// vision::CameraModel::Project() for automatic differentiation.
template <typename T>
bool ProjectPoint(const T* camera, const T* p, T* pixel) {
  if (!(p[2] > T(1e-3))) return false;
  const T x = p[0] / p[2];
  const T y = p[1] / p[2];
  const T r2 = x * x + y * y;
  const T radial = 1.0 + r2 * (camera[4] + r2 * (camera[5] + r2 * camera[8]));
  const T dx = x * radial + 2.0 * camera[6] * x * y + camera[7] * (r2 + 2.0 * x * x);
  const T dy = y * radial + camera[6] * (r2 + 2.0 * y * y) + 2.0 * camera[7] * x * y;
  pixel[0] = camera[0] * dx + camera[2];
  pixel[1] = camera[1] * dy + camera[3];
  return true;
}

template <typename T>
void Transform(const T* pose, const T* p, T* moved) {
  ceres::AngleAxisRotatePoint(pose, p, moved);
  for (int k = 0; k < 3; ++k) moved[k] += pose[3 + k];
}

// Writes the difference between a point's predicted and observed pixel, in standard deviations.
template <typename T>
bool PixelError(const T* camera, const T* in_camera, const Eigen::Vector2d& seen, double sd,
                T* residual) {
  T pixel[2];
  if (!ProjectPoint(camera, in_camera, pixel)) return false;
  for (int k = 0; k < 2; ++k) residual[k] = (pixel[k] - seen[k]) / sd;
  return true;
}

template <typename T>
void TipInCamera(const PsmJoints& joints, const PsmJoints& reference, const T* arm,
                 const T* p_cam_base, T* in_camera) {
  T q[6];
  for (int k = 0; k < 6; ++k) q[k] = joints[k] + arm[k] + arm[6 + k] * (joints[k] - reference[k]);
  T tip[3];
  kinematics::PsmTip(q, Psm::kJawLength, tip);
  Transform(p_cam_base, tip, in_camera);
}

struct MarkError {
  Eigen::Vector2d on_target;
  Eigen::Vector2d seen;
  double sd;

  template <typename T>
  bool operator()(const T* camera, const T* p_cam_target, T* residual) const {
    const T p[3] = {T(on_target.x()), T(on_target.y()), T(0.0)};
    T in_camera[3];
    Transform(p_cam_target, p, in_camera);
    return PixelError(camera, in_camera, seen, sd, residual);
  }
};

struct TipError {
  PsmJoints joints;
  PsmJoints reference;
  Eigen::Vector2d seen;
  double sd;

  template <typename T>
  bool operator()(const T* camera, const T* p_cam_base, const T* arm, T* residual) const {
    T in_camera[3];
    TipInCamera(joints, reference, arm, p_cam_base, in_camera);
    return PixelError(camera, in_camera, seen, sd, residual);
  }
};

struct TouchError {
  PsmJoints joints;
  PsmJoints reference;
  double sd;

  template <typename T>
  bool operator()(const T* p_cam_target, const T* p_cam_base, const T* arm, T* residual) const {
    T in_camera[3];
    TipInCamera(joints, reference, arm, p_cam_base, in_camera);
    const T up[3] = {T(0.0), T(0.0), T(1.0)};
    T normal[3];
    ceres::AngleAxisRotatePoint(p_cam_target, up, normal);
    residual[0] = T(0.0);
    for (int k = 0; k < 3; ++k)
      residual[0] += normal[k] * (in_camera[k] - p_cam_target[3 + k]) / sd;
    return true;
  }
};

struct ArmPrior {
  ArmBlock sd;
  template <typename T>
  bool operator()(const T* arm, T* residual) const {
    for (std::size_t k = 0; k < 12; ++k) residual[k] = arm[k] / sd[k];
    return true;
  }
};

PoseBlock ToBlock(const Eigen::Isometry3d& pose) {
  PoseBlock block{};
  const Eigen::Matrix3d r = pose.linear();
  ceres::RotationMatrixToAngleAxis(r.data(), block.data());
  for (int k = 0; k < 3; ++k) block[static_cast<std::size_t>(k) + 3] = pose.translation()[k];
  return block;
}

Eigen::Isometry3d ToPose(const PoseBlock& block) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Eigen::Matrix3d r;
  ceres::AngleAxisToRotationMatrix(block.data(), r.data());
  pose.linear() = r;
  pose.translation() = Eigen::Vector3d(block[3], block[4], block[5]);
  return pose;
}

int SeenMarks(const vision::CalibrationFrame& frame) {
  return static_cast<int>(
      std::count_if(frame.marks_px.begin(), frame.marks_px.end(),
                    [](const Eigen::Vector2d& mark) { return mark.allFinite(); }));
}

template <std::size_t kSize>
bool StandardDeviations(const ceres::Covariance& covariance, const double* block,
                        std::array<double, kSize>& sd) {
  std::array<double, kSize * kSize> entries{};
  if (!covariance.GetCovarianceBlock(block, block, entries.data())) return false;
  for (std::size_t k = 0; k < kSize; ++k)
    sd[k] = std::sqrt(std::max(0.0, entries[k * (kSize + 1)]));
  return true;
}

}  // namespace

line_task::LineCalibration Calibrate(std::span<const vision::CalibrationFrame> frames,
                                     std::span<const Eigen::Vector2d> marks_m,
                                     const line_task::LineCalibration& guess,
                                     const Eigen::Isometry3d& p_cam_target,
                                     const CalibrateOptions& options, CalibrationSummary* summary) {
  guess.camera.Check();
  DFR_THROW_UNLESS(options.mark_sd_px > 0 && options.tip_sd_px > 0 && options.touch_sd_m > 0 &&
                       options.offset_sd_rad > 0 && options.offset_sd_m > 0 && options.scale_sd > 0,
                   "calibration: every standard deviation must be positive");
  DFR_THROW_UNLESS(options.max_iterations > 0,
                   "calibration: max_iterations must be positive, not " << options.max_iterations);
  std::vector<const vision::CalibrationFrame*> usable;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    DFR_THROW_UNLESS(frames[i].marks_px.size() == marks_m.size(),
                     "calibration: frame " << i << " has " << frames[i].marks_px.size()
                                           << " marks, but the target has " << marks_m.size());
    for (double joint : frames[i].joints) {
      DFR_THROW_UNLESS(std::isfinite(joint), "calibration: frame " << i
                                                                   << " has a joint that is not "
                                                                      "finite");
    }
    if (frames[i].tip_px.allFinite() && SeenMarks(frames[i]) >= 4) usable.push_back(&frames[i]);
  }
  DFR_THROW_UNLESS(usable.size() >= 10,
                   "calibration: at least 10 frames must show the tip and 4 marks, but only "
                       << usable.size() << " of " << frames.size()
                       << " do; keep target and tip in the picture");

  CameraBlock camera = {guess.camera.fx, guess.camera.fy, guess.camera.cx, guess.camera.cy};
  std::copy(guess.camera.distortion.begin(), guess.camera.distortion.end(), camera.begin() + 4);
  PoseBlock cam_base = ToBlock(guess.p_base_cam.inverse());
  ArmBlock arm{};
  for (int k = 0; k < 6; ++k) {
    arm[static_cast<std::size_t>(k)] = guess.arm.offset[k];
    arm[static_cast<std::size_t>(k) + 6] = guess.arm.scale[k];
  }
  std::vector<PoseBlock> targets(usable.size(), ToBlock(p_cam_target));

  ceres::Problem problem;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  int marks = 0;
  for (std::size_t i = 0; i < usable.size(); ++i) {
    for (std::size_t m = 0; m < marks_m.size(); ++m) {
      if (!usable[i]->marks_px[m].allFinite()) continue;
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<MarkError, 2, 9, 6>(new MarkError{
                                   marks_m[m], usable[i]->marks_px[m], options.mark_sd_px}),
                               new ceres::CauchyLoss(3.0), camera.data(), targets[i].data());
      ++marks;
    }
    PsmJoints joints;
    std::copy(usable[i]->joints.begin(), usable[i]->joints.end(), joints.data());
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<TipError, 2, 9, 6, 12>(
            new TipError{joints, guess.arm.reference, usable[i]->tip_px, options.tip_sd_px}),
        new ceres::CauchyLoss(3.0), camera.data(), cam_base.data(), arm.data());
    if (usable[i]->touching) {
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<TouchError, 1, 6, 6, 12>(
                                   new TouchError{joints, guess.arm.reference, options.touch_sd_m}),
                               new ceres::CauchyLoss(3.0), targets[i].data(), cam_base.data(),
                               arm.data());
    }
    ordering->AddElementToGroup(targets[i].data(), 0);
  }
  ArmPrior prior{};
  for (std::size_t k = 0; k < 6; ++k) {
    prior.sd[k] = k == 2 ? options.offset_sd_m : options.offset_sd_rad;
    prior.sd[6 + k] = options.scale_sd;
  }
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<ArmPrior, 12, 12>(new ArmPrior(prior)),
                           nullptr, arm.data());
  if (options.known_camera) problem.SetParameterBlockConstant(camera.data());
  for (double* block : {camera.data(), cam_base.data(), arm.data()}) {
    ordering->AddElementToGroup(block, 1);
  }

  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::SPARSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = 1e-10;
  solver.num_threads = 1;  // identical results for any number of cores
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary report;
  ceres::Solve(solver, &problem, &report);

  line_task::LineCalibration found;
  found.camera = guess.camera;
  found.camera.fx = camera[0];
  found.camera.fy = camera[1];
  found.camera.cx = camera[2];
  found.camera.cy = camera[3];
  std::copy(camera.begin() + 4, camera.end(), found.camera.distortion.begin());
  found.p_base_cam = ToPose(cam_base).inverse();
  found.arm.reference = guess.arm.reference;
  for (int k = 0; k < 6; ++k) {
    found.arm.offset[k] = arm[static_cast<std::size_t>(k)];
    found.arm.scale[k] = arm[static_cast<std::size_t>(k) + 6];
  }
  if (summary == nullptr) return found;

  *summary = {};
  summary->converged = report.termination_type == ceres::CONVERGENCE;
  summary->iterations = static_cast<int>(report.iterations.size());
  summary->message = report.message;
  summary->marks = marks;
  summary->tips = static_cast<int>(usable.size());
  double mark_squares = 0.0;
  double tip_squares = 0.0;
  for (std::size_t i = 0; i < usable.size(); ++i) {
    const Eigen::Isometry3d pose = ToPose(targets[i]);
    for (std::size_t m = 0; m < marks_m.size(); ++m) {
      if (!usable[i]->marks_px[m].allFinite()) continue;
      const Eigen::Vector3d p(marks_m[m].x(), marks_m[m].y(), 0.0);
      mark_squares += (found.camera.Project(pose * p) - usable[i]->marks_px[m]).squaredNorm();
    }
    PsmJoints joints;
    std::copy(usable[i]->joints.begin(), usable[i]->joints.end(), joints.data());
    tip_squares +=
        (found.camera.Project(found.TipInCamera(joints)) - usable[i]->tip_px).squaredNorm();
  }
  summary->mark_rms_px = std::sqrt(mark_squares / marks);
  summary->tip_rms_px = std::sqrt(tip_squares / summary->tips);

  ceres::Covariance::Options covariance_options;
  covariance_options.num_threads = 1;
  ceres::Covariance covariance(covariance_options);
  std::vector<std::pair<const double*, const double*>> blocks = {{cam_base.data(), cam_base.data()},
                                                                 {arm.data(), arm.data()}};
  if (!options.known_camera) blocks.emplace_back(camera.data(), camera.data());
  std::array<double, 12> arm_sd{};
  summary->has_covariance =
      covariance.Compute(blocks, &problem) &&
      (options.known_camera || StandardDeviations(covariance, camera.data(), summary->camera_sd)) &&
      StandardDeviations(covariance, cam_base.data(), summary->pose_sd) &&
      StandardDeviations(covariance, arm.data(), arm_sd);
  std::copy_n(arm_sd.begin(), 6, summary->offset_sd.begin());
  std::copy_n(arm_sd.begin() + 6, 6, summary->scale_sd.begin());
  return found;
}

void Print(std::ostream& out, const line_task::LineCalibration& calibration,
           const CalibrationSummary& summary) {
  const auto line = [&out](const std::string& name, double value, double sd, const char* unit) {
    out << "  " << std::left << std::setw(22) << name << std::right << std::setw(12) << value
        << " +- " << std::setw(10) << sd << ' ' << unit << '\n';
  };
  const std::ios::fmtflags flags = out.flags();
  const std::streamsize precision = out.precision(4);
  out << (summary.converged ? "converged" : "did NOT converge") << " after " << summary.iterations
      << " iterations; " << summary.marks << " marks with " << summary.mark_rms_px << " px RMS, "
      << summary.tips << " tips with " << summary.tip_rms_px << " px RMS\n";
  if (!summary.has_covariance) out << "no covariance: the motion does not excite all parameters\n";
  const vision::CameraModel& camera = calibration.camera;
  constexpr std::array<const char*, 9> kCamera = {"fx", "fy", "cx", "cy", "k1",
                                                  "k2", "p1", "p2", "k3"};
  const CameraBlock values = {camera.fx,
                              camera.fy,
                              camera.cx,
                              camera.cy,
                              camera.distortion[0],
                              camera.distortion[1],
                              camera.distortion[2],
                              camera.distortion[3],
                              camera.distortion[4]};
  for (std::size_t k = 0; k < 9; ++k)
    line(kCamera[k], values[k], summary.camera_sd[k], k < 4 ? "px" : "");
  const PoseBlock pose = ToBlock(calibration.p_base_cam.inverse());
  for (std::size_t k = 0; k < 6; ++k) {
    line((k < 3 ? "base in camera, turn " : "base in camera, at ") + std::string(1, "xyz"[k % 3]),
         k < 3 ? pose[k] : 1e3 * pose[k], k < 3 ? summary.pose_sd[k] : 1e3 * summary.pose_sd[k],
         k < 3 ? "rad" : "mm");
  }
  constexpr std::array<const char*, 6> kJoint = {"yaw",  "pitch",       "insertion",
                                                 "roll", "wrist pitch", "wrist yaw"};
  for (int k = 0; k < 6; ++k) {
    const auto i = static_cast<std::size_t>(k);
    const double unit = k == 2 ? 1e3 : 1.0;
    line(std::string(kJoint[i]) + " offset", unit * calibration.arm.offset[k],
         unit * summary.offset_sd[i], k == 2 ? "mm" : "rad");
  }
  for (int k = 0; k < 6; ++k) {
    const auto i = static_cast<std::size_t>(k);
    line(std::string(kJoint[i]) + " scale", calibration.arm.scale[k], summary.scale_sd[i], "");
  }
  out.flags(flags);
  out.precision(precision);
}

}  // namespace dfr::calibration
