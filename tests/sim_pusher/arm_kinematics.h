#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <string>
#include <vector>

#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::test {

// First entries of the state's blocks.
constexpr int kTip = 7;
constexpr int kObject = 10;
constexpr int kTilt = 22;

inline std::vector<double> Observe(const sim::PusherPlant& plant) {
  std::vector<double> state(plant.state_dim());
  plant.Observe(state);
  return state;
}

/// The arm's chain computed from the documented dimensions, without MuJoCo. It is the peer of
/// MuJoCo's kinematics and of the collision check.
struct ArmPose {
  struct Part {
    std::string name;
    Eigen::Vector3d a, b;
    double radius;
  };
  std::vector<Part> parts;
  Eigen::Vector3d tip;
  Eigen::Matrix3d tip_frame;
};

inline ArmPose Forward(std::span<const double> q, double bar_half_width) {
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  const Vector3d x = Vector3d::UnitX();
  const Vector3d y = Vector3d::UnitY();
  const Eigen::Matrix3d shoulder = AngleAxisd(q[0], Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Matrix3d upper = shoulder * AngleAxisd(q[1], y) * AngleAxisd(q[2], x);
  const Eigen::Matrix3d fore = upper * AngleAxisd(q[3], y) * AngleAxisd(q[4], x);
  const Eigen::Matrix3d hand = fore * AngleAxisd(q[5], y) * AngleAxisd(q[6], x);
  const Vector3d lift = shoulder * (0.1 * x);
  const Vector3d elbow = lift + upper * (0.4 * x);
  const Vector3d wrist = elbow + fore * (0.321 * x);
  ArmPose pose;
  pose.tip = wrist + hand * (0.112 * x);
  // At home the hand points 75 degrees down, and the tip frame equals the world frame.
  pose.tip_frame = hand * AngleAxisd(-75.0 * M_PI / 180.0, y);
  const Vector3d side = bar_half_width * hand.col(1);
  pose.parts = {{"upper_arm", lift, elbow, 0.045},
                {"forearm", elbow, wrist, 0.034},
                {"hand", wrist, wrist + hand * (0.085 * x), 0.012},
                {"bar", pose.tip - side, pose.tip + side, 0.012}};
  return pose;
}

/// Returns the joint-space control that moves the tip by `step_m` in the world, upright at the home
/// height: the least-squares inverse of the chain's differences.
inline std::array<double, 7> MoveTip(const sim::PusherPlant& plant, const Eigen::Vector2d& step_m,
                                     double yaw = 0.0) {
  const std::vector<double> state = Observe(plant);
  const auto pose_of = [](std::span<const double> q) {
    const ArmPose pose = Forward(q, 0.025);
    Eigen::Matrix<double, 6, 1> p;
    p << pose.tip, pose.tip_frame(1, 0), pose.tip_frame(2, 0), pose.tip_frame(2, 1);
    return p;
  };
  const Eigen::Matrix<double, 6, 1> now = pose_of(state);
  Eigen::Matrix<double, 6, 7> jacobian;
  for (int j = 0; j < 7; ++j) {
    std::vector<double> q(state.begin(), state.begin() + 7);
    q[j] += 1e-6;
    jacobian.col(j) = (pose_of(q) - now) / 1e-6;
  }
  Eigen::Matrix<double, 6, 1> error;
  error << step_m, -0.285 - now[2], yaw - now[3], -now[4], -now[5];
  const Eigen::MatrixXd regular =
      jacobian * jacobian.transpose() + 1e-6 * Eigen::MatrixXd::Identity(6, 6);
  const Eigen::VectorXd dq = jacobian.transpose() * core::SolveSymmetric(regular, error);
  std::array<double, 7> control;
  for (int j = 0; j < 7; ++j) control[j] = dq[j] / plant.options().joint_step;
  return control;
}

/// Returns the state with the same arm and the cylinder at (x, y).
inline std::vector<double> WithObjectAt(std::vector<double> state, double x, double y) {
  state[kObject] = x;
  state[kObject + 1] = y;
  return state;
}

}  // namespace dfr::test
