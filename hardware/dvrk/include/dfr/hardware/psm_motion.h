#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>

#include "dfr/hardware/psm_status.h"
#include "dfr/kinematics/psm.h"

namespace dfr::hardware {

/// Limits of a client. Goals beyond them are refused, never clipped.
struct PsmLimits {
  /// Generation whose joint limits bound `lower` and `upper`. The limits of a Classic arm lie
  /// within the limits of an Si arm.
  kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic;
  kinematics::PsmJoints lower = kinematics::Psm::lower_limits();
  kinematics::PsmJoints upper = kinematics::Psm::upper_limits();
  /// Maximum joint speed, > 0: rad/s, insertion m/s. By default, the motion in 5 ms is at most what
  /// the console's limits of 90 degrees/s and 0.2 m/s allow in 1 ms, so the arm can reach every
  /// set-point at once.
  kinematics::PsmJoints max_speed =
      (kinematics::PsmJoints() << 0.31415926535897931, 0.31415926535897931, 0.04,
       0.31415926535897931, 0.31415926535897931, 0.31415926535897931)
          .finished();
  double max_tip_speed = 0.05;  ///< Speed of the jaw tips, m/s, > 0.
  /// Permitted region of the jaw tips in the arm's base frame, m: a finite box. Default: the region
  /// below the cannula within the arm's length. A tip outside a face may move back, but not farther
  /// out, nor beyond another face.
  Eigen::Vector3d workspace_min_m = Eigen::Vector3d(-0.15, -0.15, -0.25);
  Eigen::Vector3d workspace_max_m = Eigen::Vector3d(0.15, 0.15, 0.0);
  double jaw_lower = -0.3490658503988659;     ///< rad; instrument 420006 does not close farther
  double jaw_upper = 1.3962634015954636;      ///< rad
  double max_jaw_speed = 1.5707963267948966;  ///< rad/s, > 0.

  /// Returns the joint limits of `generation` and the default values of the other limits.
  [[nodiscard]] static PsmLimits Of(kinematics::PsmGeneration generation);

  /// @throws std::invalid_argument naming the invalid limit.
  void Check() const;
};

/// Profile of a move's set-point from start to goal.
enum class PsmProfile {
  kSmooth,  ///< s^2 (3 - 2 s): at rest at both ends; peak speed 1.5 times the mean.
  kLinear,  ///< Constant speed.
};

/// Generates the set-points of an arm on a straight line in joint space, as the console
/// interpolates. The path of the tip is slightly curved. Uses neither a network nor a clock.
///
/// Only the constructor allocates or throws. One object belongs to one thread at a time.
class PsmMotion {
 public:
  /// @throws std::invalid_argument as PsmLimits::Check().
  PsmMotion(const PsmLimits& limits, PsmProfile profile);

  /// Sets the state to rest at `joints`, regardless of the limits.
  void Rest(const kinematics::PsmJoints& joints) noexcept;
  /// Starts a move from the present set-point. Refuses it, without any change, unless the whole
  /// path satisfies the limits. Checks the path at least every 0.5 mm. Every pose on the path must
  /// map back to the same joint values, because servo_cp transmits only the pose.
  /// @param duration_s  >= 0; zero only if `goal` is the present set-point.
  [[nodiscard]] PsmStatus Start(const kinematics::PsmJoints& goal, double duration_s) noexcept;
  /// Returns the shortest duration for which the move from the present set-point to `goal`
  /// satisfies the speed limits, s.
  [[nodiscard]] double ShortestDuration(const kinematics::PsmJoints& goal) const noexcept;
  /// Advances the time by `dt_s` >= 0.
  void Advance(double dt_s) noexcept;

  [[nodiscard]] bool moving() const noexcept { return moving_; }
  [[nodiscard]] const kinematics::PsmJoints& setpoint() const noexcept { return setpoint_; }
  /// Returns the velocity of the set-point, rad/s (insertion: m/s).
  [[nodiscard]] kinematics::PsmJoints velocity() const noexcept;
  [[nodiscard]] const kinematics::PsmJoints& goal() const noexcept { return goal_; }
  [[nodiscard]] const PsmLimits& limits() const noexcept { return limits_; }

 private:
  // Returns the ratio of maximum to mean speed.
  [[nodiscard]] double Peak() const noexcept;

  PsmLimits limits_;
  PsmProfile profile_;
  bool moving_ = false;
  double elapsed_s_ = 0.0;
  double duration_s_ = 0.0;
  kinematics::PsmJoints from_ = kinematics::PsmJoints::Zero();
  kinematics::PsmJoints goal_ = kinematics::PsmJoints::Zero();
  kinematics::PsmJoints setpoint_ = kinematics::PsmJoints::Zero();
};

/// Range of the recent set-points, joint by joint, for comparison with the set-points that a
/// console reports. Never allocates or throws. One object belongs to one thread.
class PsmRecentSetpoints {
 public:
  /// @param window_s  minimum time for which a set-point is kept, > 0.
  explicit PsmRecentSetpoints(double window_s) : window_s_(window_s) {}

  /// Discards all earlier set-points and adds this one.
  void Start(const kinematics::PsmJoints& setpoint, double time_s) noexcept;
  void Add(const kinematics::PsmJoints& setpoint, double time_s) noexcept;
  /// Returns true if every joint is within `tolerance` of its recent range.
  [[nodiscard]] bool Contain(const kinematics::PsmJoints& setpoint,
                             const kinematics::PsmJoints& tolerance) const noexcept;

 private:
  struct Part {
    double begin_s = 0.0;
    kinematics::PsmJoints lower = kinematics::PsmJoints::Zero();
    kinematics::PsmJoints upper = kinematics::PsmJoints::Zero();
  };
  // Eight complete parts span the window; the ninth is being filled.
  static constexpr std::size_t kParts = 9;

  double window_s_;
  std::array<Part, kParts> parts_;
  std::size_t newest_ = 0;
};

/// Criteria for an arm at rest.
struct PsmRestOptions {
  /// Maximum distance of each joint from the set-point, rad (insertion: m), > 0.
  kinematics::PsmJoints max_distance =
      (kinematics::PsmJoints() << 0.01, 0.01, 0.001, 0.02, 0.02, 0.02).finished();
  /// Maximum speed of each joint, rad/s (insertion: m/s), > 0.
  kinematics::PsmJoints max_speed =
      (kinematics::PsmJoints() << 0.02, 0.02, 0.002, 0.05, 0.05, 0.05).finished();
  double settle_s = 0.1;  ///< Time for which all samples must meet the criteria, >= 0.

  /// @throws std::invalid_argument naming the option that is out of range.
  void Check() const;
};

/// Detects from measurements when an arm rests at its set-point. Only the constructor allocates or
/// throws. One object belongs to one thread at a time.
class PsmRest {
 public:
  /// @throws std::invalid_argument as PsmRestOptions::Check().
  explicit PsmRest(const PsmRestOptions& options);

  /// Adds a sample that arrived at `time_s`.
  void Sample(const kinematics::PsmJoints& measured, const kinematics::PsmJoints& velocity,
              const kinematics::PsmJoints& setpoint, double time_s) noexcept;
  /// Discards earlier samples because the arm starts to move.
  void Forget() noexcept { calm_ = false; }
  [[nodiscard]] bool At(double time_s) const noexcept;

 private:
  PsmRestOptions options_;
  bool calm_ = false;
  double since_s_ = 0.0;
};

}  // namespace dfr::hardware
