#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

#include "dfr/core/plant.h"

namespace dfr::sim {

/// The arm's pushing tool.
enum class Gripper {
  kBar,      ///< Flat bar of half width 0.025 m: the cylinder can slip off either end.
  kWideBar,  ///< Flat bar of half width 0.05 m.
  kFork,     ///< Bar of half width 0.07 m with prongs of 0.04 m: the cylinder is caged.
};

[[nodiscard]] std::string_view Name(Gripper gripper) noexcept;

/// Physics of arm and cylinder.
enum class PusherPhysics {
  kQuasiStatic,  ///< The arm moves along its path; there is no momentum.
  kDynamic,      ///< Motors move an arm with inertia, damping and friction, by mj_step().
};

[[nodiscard]] std::string_view Name(PusherPhysics physics) noexcept;

/// Options for PusherPlant. Defaults are the experiment's scene. Lengths are in metres.
struct PusherOptions {
  Gripper gripper = Gripper::kBar;
  /// The red regions are at y = +-red_y. In (0.1, 0.3], because the cylinder has to fit between
  /// them. Supervisors are trained with a narrower gate than in the evaluation, which gives their
  /// demonstrations a margin.
  double red_y = 0.15;
  /// The cylinder starts uniformly in [start_x_min, start_x_max] x [-start_y, start_y], in front of
  /// the gripper and before the gate: x in [0.42, 0.54], start_y in [0, 0.2].
  double start_x_min = 0.43;
  double start_x_max = 0.49;
  double start_y = 0.12;
  PusherPhysics physics = PusherPhysics::kQuasiStatic;
  double joint_step = 0.06;  ///< rad per unit of control, in [0.005, 0.1].
};

/// Counts since construction. Speeds are in m/s of simulated time. A substep takes 10 ms, or 2 ms
/// under full dynamics.
struct PusherStatistics {
  std::int64_t controls = 0;   ///< Number of controls that Apply() did not refuse.
  std::int64_t saturated = 0;  ///< Number of controls with an entry beyond +-1.
  /// Number of controls deflected to keep the arm above the table.
  std::int64_t stopped_by_table = 0;
  /// Number of controls undone because they pressed the cylinder down.
  std::int64_t stalled = 0;
  /// Full dynamics: number of controls after which the plant was not at rest within 3 s.
  std::int64_t unsettled = 0;
  /// Number of controls close enough to contact to need MuJoCo steps.
  std::int64_t simulated = 0;
  std::int64_t substeps = 0;            ///< Number of MuJoCo steps, including settling.
  double max_residual_speed = 0.0;      ///< Largest residual_speed() so far.
  double max_penetration_m = 0.0;       ///< Deepest overlap of gripper and cylinder during motion.
  double max_rest_penetration_m = 0.0;  ///< Deepest overlap at rest.
};

/// The Pusher task of Sec. V-A in MuJoCo 2.2: a 7-joint arm pushes a cylinder over the goal.
/// Cylinder, gripper and arm must not touch either of the two red regions.
///
/// State, in metres and radians, world frame (x from the arm to the goal, z up):
///   qpos(7)      joint angles: shoulder pan and lift, upper-arm roll, elbow flex, forearm roll,
///                wrist flex and roll
///   tip(3)       centre of the gripper's bar
///   object(3)    centre of the cylinder
///   goal(3)      centre of the goal, constant
///   red(6)       centres of the two red regions on the table, constant: left (y > 0), then right
///   tip_tilt(3)  0.1 m times the sines of the gripper's turn from its home pose, from its rotation
///                matrix R: yaw R_yx, pitch R_zx, roll R_zy
/// The support of Sec. V-A uses "red,object,tip". The paper's state also has joint velocities.
/// States here omit joint velocities, because they are observed at rest.
///
/// Control (7): change of each joint angle, in units of PusherOptions::joint_step. Entries beyond
/// +-1 are not an error: they saturate, because +-1 is the actuators' limit. The arm stops at its
/// joint limits and slides along the table instead of entering it. It stalls (the control changes
/// nothing) if it would press the cylinder onto the table by more than 0.5 mm. A control of another
/// size or with a non-finite entry is rejected and moves nothing.
///
/// Physics: pushing is quasi-static. The arm moves along the straight line in joint space in
/// substeps that displace the gripper by at most about 2 mm. Each substep starts with the cylinder
/// at rest, which excludes momentum, and MuJoCo's contact solver gives the cylinder's motion. Under
/// Coulomb friction at the contact, this is the motion of a point with isotropic friction on the
/// table. The last substeps repeat with the arm at rest until the cylinder is at rest, too.
/// Controls that provably cannot touch anything need only the arm's kinematics.
///
/// Under full dynamics, motors with a torque limit follow a minimum-jerk reference of at most 0.25
/// rad/s to the new joint angles and hold them, in mj_step() steps of 2 ms. A control ends when
/// every joint is slower than 1e-3 rad/s and the cylinder slower than 1e-3 m/s for 5 consecutive
/// steps, or after 3 s; then velocities are set to zero. Joints have rotor inertia, viscous damping
/// and Coulomb friction. The cylinder slides with Coulomb friction along x and y and keeps sliding
/// after a push. Arm and table do not touch: references stay above the table, too. Simulating full
/// dynamics takes about fifty times as long as quasi-static pushing.
///
/// The collision check runs after every substep for the cylinder, the upper arm, forearm, hand and
/// gripper against both red regions, in 3-D by exact distances of capsules. (The shoulder cannot
/// reach that far.) The regions are posts of radius 0.06 m, 0.1 m high with a rounded top.
///
/// The next state is a function of the current state and the control. There is no other solver
/// state: a clone, or a plant that reached the same state in another way, continues with
/// bit-identical states.
///
/// Each object belongs to one thread; clones share only the immutable model.
class PusherPlant final : public core::SimulatedPlant {
 public:
  static constexpr int kNumJoints = 7;
  static constexpr double kObjectRadius = 0.04;  ///< m
  static constexpr double kGoalRadius = 0.04;    ///< m
  static constexpr double kRedRadius = 0.06;     ///< m

  /// @throws std::invalid_argument naming the option out of range; std::runtime_error if MuJoCo's
  ///   version at run time differs from the build's.
  explicit PusherPlant(const PusherOptions& options = {});
  ~PusherPlant() override;
  PusherPlant(const PusherPlant&) = delete;
  PusherPlant& operator=(const PusherPlant&) = delete;

  [[nodiscard]] const core::StateLayout& layout() const noexcept override;
  [[nodiscard]] int control_dim() const noexcept override { return kNumJoints; }
  [[nodiscard]] const PusherOptions& options() const noexcept;

  /// Moves the arm home, tip at (0.35, 0, -0.285), and the cylinder to a start position sampled
  /// with core::Random(seed).
  void Reset(std::uint64_t seed) override;

  /// Sets the arm and the cylinder to an observed `state` (its qpos and object entries), at rest.
  /// collided() then refers to that state alone. For replays and tests.
  /// @throws std::invalid_argument if the size is wrong, an entry is not finite, or a joint is
  ///   outside its limits.
  void SetState(std::span<const double> state);

  /// Returns kFault after MuJoCo reports an error or a diverging state, until Reset() or
  /// SetState().
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;

  /// Returns true if the cylinder's centre is over the goal and collided() is false.
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override;
  /// Returns the first part that touched a red region: "object", "upper_arm", "forearm", "hand",
  /// "bar", "prong_left" or "prong_right"; empty if there is none.
  [[nodiscard]] std::string_view collided_part() const noexcept;
  /// Does nothing: every state is at rest.
  void Halt() noexcept override {}

  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  /// @pre other is a PusherPlant with the same options.
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

  /// Speed of the cylinder, in m/s, in the last substep of the last control, before it was set to
  /// zero. Zero without contact.
  [[nodiscard]] double residual_speed() const noexcept;
  [[nodiscard]] const PusherStatistics& statistics() const noexcept;

  /// Centres of the cylinder, the bar and the goal.
  [[nodiscard]] std::array<double, 3> object_m() const noexcept;
  [[nodiscard]] std::array<double, 3> tip_m() const noexcept;
  [[nodiscard]] std::array<double, 3> goal_m() const noexcept;

  /// MuJoCo's data, for the renderer in sim/pusher/view.
  struct World;
  struct Data;
  [[nodiscard]] const World& world() const noexcept { return *world_; }
  [[nodiscard]] const Data& data() const noexcept { return *data_; }

 private:
  explicit PusherPlant(std::shared_ptr<const World> world);
  // Implements Apply() under full dynamics. `target` keeps the arm above the table.
  core::PlantStatus MoveDynamically(const std::array<double, kNumJoints>& target);

  std::shared_ptr<const World> world_;
  std::unique_ptr<Data> data_;
};

}  // namespace dfr::sim
