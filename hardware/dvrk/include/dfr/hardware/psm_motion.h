#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>

#include "dfr/hardware/psm_status.h"
#include "dfr/kinematics/psm.h"

namespace dfr::hardware {

/// What a client allows itself. Goals beyond are refused, never clipped.
struct PsmLimits {
  /// Whose joint limits bound `lower` and `upper`. Those of a Classic lie within those of an Si.
  kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic;
  kinematics::PsmJoints lower = kinematics::Psm::lower_limits();
  kinematics::PsmJoints upper = kinematics::Psm::upper_limits();
  /// Per s, > 0: rad, insertion in m. In 5 ms no more than the console's own 90 degrees/s and 0.2
  /// m/s allow in 1 ms, so that every set-point can be reached at once.
  kinematics::PsmJoints max_speed =
      (kinematics::PsmJoints() << 0.31415926535897931, 0.31415926535897931, 0.04,
       0.31415926535897931, 0.31415926535897931, 0.31415926535897931)
          .finished();
  double max_tip_speed = 0.05;  ///< The jaw tips', m/s, > 0.
  /// Where the jaw tips may be, in the arm's base frame, m: a finite box. By default what is below
  /// the cannula and within an arm's length of it.
  Eigen::Vector3d workspace_min_m = Eigen::Vector3d(-0.15, -0.15, -0.25);
  Eigen::Vector3d workspace_max_m = Eigen::Vector3d(0.15, 0.15, 0.0);
  double jaw_lower = -0.3490658503988659;     ///< rad; 420006 closes no farther.
  double jaw_upper = 1.3962634015954636;      ///< rad
  double max_jaw_speed = 1.5707963267948966;  ///< rad/s, > 0.

  /// The joint limits of `generation`, the rest by default.
  [[nodiscard]] static PsmLimits Of(kinematics::PsmGeneration generation);

  /// @throws std::invalid_argument naming the limit that makes no sense.
  void Check() const;
};

/// How a move's set-point runs from start to goal.
enum class PsmProfile {
  kSmooth,  ///< s^2 (3 - 2 s): at rest at both ends, 1.5 times the mean speed in the middle.
  kLinear,  ///< Constant speed.
};

/// The set-point of an arm: on a straight line through joint space, as the console interpolates, so
/// that the tip's way curves a little. Needs neither a network nor a clock.
///
/// After construction nothing here allocates or throws. One object belongs to one thread at a time.
class PsmMotion {
 public:
  /// @throws std::invalid_argument as PsmLimits::Check().
  PsmMotion(const PsmLimits& limits, PsmProfile profile);

  /// At rest at `joints`, whatever the limits say.
  void Rest(const kinematics::PsmJoints& joints) noexcept;
  /// Starts a move from the present set-point. Refused, with nothing changed, unless all of the way
  /// keeps to the limits; the way is looked at every 0.5 mm or closer, and everywhere a pose has to
  /// lead back to its joint values, for servo_cp only says the pose.
  /// @param duration_s  >= 0; zero only where there is nothing to do.
  [[nodiscard]] PsmStatus Start(const kinematics::PsmJoints& goal, double duration_s) noexcept;
  /// The same to a pose of the wrist in the base frame.
  [[nodiscard]] PsmStatus Start(const Eigen::Isometry3d& goal, double duration_s) noexcept;
  /// The shortest duration that Start() takes for `goal` from here, as far as speed is concerned,
  /// s.
  [[nodiscard]] double ShortestDuration(const kinematics::PsmJoints& goal) const noexcept;
  /// Time goes on by `dt_s` >= 0.
  void Advance(double dt_s) noexcept;

  [[nodiscard]] bool moving() const noexcept { return moving_; }
  [[nodiscard]] const kinematics::PsmJoints& setpoint() const noexcept { return setpoint_; }
  /// How fast the set-point moves there, rad/s (insertion: m/s).
  [[nodiscard]] kinematics::PsmJoints velocity() const noexcept;
  [[nodiscard]] const kinematics::PsmJoints& goal() const noexcept { return goal_; }
  [[nodiscard]] const PsmLimits& limits() const noexcept { return limits_; }

 private:
  // Speed at its largest over mean speed.
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

/// The range of the set-points of the last while, joint by joint, which those that a console
/// reports have to be from. Never allocates or throws. One object belongs to one thread.
class PsmRecentSetpoints {
 public:
  /// @param window_s  how long one is remembered at least, > 0.
  explicit PsmRecentSetpoints(double window_s) : window_s_(window_s) {}

  /// Only this one is known.
  void Start(const kinematics::PsmJoints& setpoint, double time_s) noexcept;
  void Add(const kinematics::PsmJoints& setpoint, double time_s) noexcept;
  /// Whether every joint is within `tolerance` of that joint's range.
  [[nodiscard]] bool Contain(const kinematics::PsmJoints& setpoint,
                             const kinematics::PsmJoints& tolerance) const noexcept;

 private:
  struct Part {
    double begin_s = 0.0;
    kinematics::PsmJoints lower = kinematics::PsmJoints::Zero();
    kinematics::PsmJoints upper = kinematics::PsmJoints::Zero();
  };
  static constexpr std::size_t kParts = 9;  // the oldest is complete until the window has passed it

  double window_s_;
  std::array<Part, kParts> parts_;
  std::size_t newest_ = 0;
};

/// When an arm counts as at rest.
struct PsmRestOptions {
  /// How far from the set-point each joint may be, rad (insertion: m), > 0.
  kinematics::PsmJoints max_distance =
      (kinematics::PsmJoints() << 0.01, 0.01, 0.001, 0.02, 0.02, 0.02).finished();
  /// How fast each joint may be, rad/s (insertion: m/s), > 0.
  kinematics::PsmJoints max_speed =
      (kinematics::PsmJoints() << 0.02, 0.02, 0.002, 0.05, 0.05, 0.05).finished();
  double settle_s = 0.1;  ///< For how long all samples have to say so, >= 0.

  /// @throws std::invalid_argument naming the option that is out of range.
  void Check() const;
};

/// Whether an arm is at rest at its set-point, by its measurements. Never allocates or throws after
/// construction. One object belongs to one thread at a time.
class PsmRest {
 public:
  /// @throws std::invalid_argument as PsmRestOptions::Check().
  explicit PsmRest(const PsmRestOptions& options);

  /// A sample that has arrived at `time_s`.
  void Sample(const kinematics::PsmJoints& measured, const kinematics::PsmJoints& velocity,
              const kinematics::PsmJoints& setpoint, double time_s) noexcept;
  /// The arm is on its way: what was seen before does not count.
  void Forget() noexcept { calm_ = false; }
  [[nodiscard]] bool At(double time_s) const noexcept;

 private:
  PsmRestOptions options_;
  bool calm_ = false;
  double since_s_ = 0.0;
};

}  // namespace dfr::hardware
