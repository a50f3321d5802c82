#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "dfr/core/matrix.h"
#include "dfr/core/plant.h"
#include "dfr/kinematics/psm.h"
#include "dfr/kinematics/sprk_platform.h"
#include "dfr/line_task/line_task.h"
#include "dfr/sim/line_tracking/arm_error.h"
#include "dfr/sim/line_tracking/disturbance.h"
#include "dfr/sim/line_tracking/endoscope.h"
#include "dfr/vision/line_vision.h"

namespace dfr::sim {

namespace internal {
struct GauzeLine;
}  // namespace internal

/// What Observe() reports.
enum class Observation {
  kVision,       ///< What the endoscope's image shows.
  kGroundTruth,  ///< The simulation's own numbers: fast, and free of error.
};

/// Camera faults, for tests.
enum class CameraFault {
  kNone,
  kFrozen,       ///< The last image again and again.
  kBlack,        ///< The lamp is off.
  kOverexposed,  ///< White.
  kNoLine,       ///< The line is not in the picture.
  kNoTip,        ///< The end-effector is not in the picture.
};

/// Light and optics of the simulated endoscope. Per episode and image light and glare vary by
/// themselves.
struct EndoscopeOptions {
  double light_change = 0.2;  ///< Share by which the gain changes, at most; in [0, 0.6].
  double glare = 20.0;        ///< Brightest spot, of 255.
  double blur_px = 0.5;       ///< Standard deviation of the focus' blur.
  double noise = 3.0;         ///< Standard deviation, of 255.
};

/// Options for LineTrackingPlant. Defaults are the scene of the experiment, without disturbance.
struct LineTrackingOptions {
  Observation observation = Observation::kVision;
  DisturbanceOptions disturbance;
  ArmErrorOptions arm;
  EndoscopeOptions endoscope;
  std::uint64_t platform_seed = 1;     ///< Identifies the platform: its positioning error.
  double max_curvature = 1.0 / 150.0;  ///< 1/mm, of half of the lines; the others are straight.
  double start_scatter_m = 6e-4;  ///< Standard deviation of the tip's first distance to the line.
};

/// The simulation's own numbers.
struct LineTrackingTruth {
  Eigen::Vector3d tip_m = Eigen::Vector3d::Zero();  ///< World frame.
  Eigen::Isometry3d p_world_gauze = Eigen::Isometry3d::Identity();
  double distance_m = 0.0;   ///< As LineObservation::distance_m.
  double progress_m = 0.0;   ///< Along the line since Reset().
  double heading_rad = 0.0;  ///< The line's tangent next to the tip, in the world's xy-plane.
};

/// The line tracking task of Sec. V-B: a PSM follows a red line on gauze that a Stewart platform
/// moves, seen by an overhead endoscope.
///
/// World frame: origin in the gauze's middle when the platform is at home, z up, the line roughly
/// along x. The arm reaches in from +y, inclined by 40 degrees, and holds its orientation.
///
/// State (4), in millimetres so that its entries are of one magnitude:
///   tip(2)       the tool's tip, x and y in the world frame
///   distance(1)  of the tip to the line in the gauze's plane, positive to the left (+y)
///   heading(1)   direction of the line next to the tip: 10 mm times its angle to the x-axis, rad
/// All entries are NaN when the image does not show line and tip ("not seen" in three pictures
/// running), which every controller turns into a halt.
///
/// Control (2): displacement of the tool in x and y, in units of kStep = 2 mm; the height above the
/// table stays as commanded. Entries beyond +-1 saturate. A control of another size, with a
/// non-finite entry, or to where the arm cannot reach is refused and moves nothing.
///
/// The world is a MuJoCo model that is placed, never integrated: position control, everything at
/// rest after each control, no force that matters. Joints follow their readings with a lag of 20 ms
/// and the tip goes where the true joints put it, which are not where the arm believes (ArmError).
/// The platform follows its commanded pose with a 0.2 s lag and a positioning error of 1.22, 1.07
/// and 0.20 mm RMS in x, y and z. After every control everything comes to rest before the state is
/// observed. A control takes |u| kStep / kSpeed of the disturbance's time if the disturbance acts
/// during controls, and pause_s more if it acts between them. In real time it takes latency_s and
/// then |u| kStep / kSpeed, and the platform does not come to rest.
///
/// collided(): at any moment, sampled every 20 ms of motion and at rest, the true tip was more than
/// kCollision from the line in the gauze's plane. completed(): kCompletion tracked, not collided.
///
/// The endoscope's picture is MuJoCo's of what its camera sees (MujocoRenderer, without a display),
/// put through an Endoscope.
///
/// Apply() allocates nothing with kGroundTruth; with kVision OpenCV and OpenGL may. One object
/// belongs to the thread that made it; clones share the immutable scene.
class LineTrackingPlant final : public core::SimulatedPlant {
 public:
  static constexpr double kStep = line_task::LineTask::kStep;            ///< m per unit of control.
  static constexpr double kSpeed = line_task::LineTask::kSpeed;          ///< m/s of the tool.
  static constexpr double kCollision = line_task::LineTask::kCollision;  ///< m
  static constexpr double kCompletion = line_task::LineTask::kCompletion;  ///< m

  /// @param calibration  what vision and commands take for true; nullptr: the true camera, at its
  ///   true place, and an uncorrected arm.
  /// @throws std::invalid_argument naming what is out of range, a disturbance beyond the platform's
  ///   reach included; std::runtime_error with kVision if nothing can be drawn here.
  explicit LineTrackingPlant(const LineTrackingOptions& options = {},
                             const line_task::LineCalibration* calibration = nullptr);
  ~LineTrackingPlant() override;
  LineTrackingPlant(const LineTrackingPlant&) = delete;
  LineTrackingPlant& operator=(const LineTrackingPlant&) = delete;

  [[nodiscard]] const core::StateLayout& layout() const noexcept override;
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  [[nodiscard]] const LineTrackingOptions& options() const noexcept;
  [[nodiscard]] const line_task::LineCalibration& calibration() const noexcept;

  /// Draws line, disturbance and light, and puts the tip over the line's beginning, platform at
  /// home.
  void Reset(std::uint64_t seed) override;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override;
  /// The platform stops where it is, and the disturbance with it, until Reset().
  void Halt() noexcept override;
  /// The arm holds still for so long while the platform moves on, halted or not. Never allocates.
  void Hold(double duration_s) noexcept;

  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  /// @pre other is a LineTrackingPlant made by Clone() from this one or from the same one.
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

  /// Puts the platform's rest pose there, on top of the disturbance; for calibration and tests.
  /// @throws std::invalid_argument if it is beyond the platform's reach.
  void MovePlatform(const kinematics::PlatformPose& pose);
  /// Puts the tool's commanded tip there, world frame; for calibration and tests. False, and
  /// nothing moves, if the arm cannot reach it.
  [[nodiscard]] bool MoveTip(const Eigen::Vector3d& tip_m) noexcept;
  void SetCameraFault(CameraFault fault) noexcept;
  /// Takes the next picture and looks at it again, as Apply() does.
  void Look() noexcept;

  /// Advances the world by `dt_s` when an external arm and clock (a console's) drive it; the
  /// encoders then read `reading`. The platform follows its commanded pose, which the disturbance
  /// moves on if `platform_moves` and Halt() was not called. The tip's distance is sampled once.
  /// Where the readings are those of Apply(), so is everything else, to the bit. Never allocates.
  /// @pre dt_s >= 0, `reading` finite
  void Drive(const kinematics::PsmJoints& reading, double dt_s, bool platform_moves) noexcept;
  /// Everything comes to rest, as after a control: the encoders say `reading`, the platform is
  /// where it is commanded, and moves on by the disturbance's pause if it acts between controls.
  void Rest(const kinematics::PsmJoints& reading) noexcept;
  /// Where the platform is commanded to be, and where its lag has it: what a driver can report.
  /// The platform's own error is not in it, because nothing measures that.
  [[nodiscard]] kinematics::PlatformPose platform_setpoint() const noexcept;
  [[nodiscard]] kinematics::PlatformPose platform_pose() const noexcept;

  [[nodiscard]] LineTrackingTruth truth() const noexcept;
  /// The state that Observe() would report with kGroundTruth.
  [[nodiscard]] std::array<double, 4> TrueState() const noexcept;
  /// What vision saw last. With kGroundTruth: nothing yet.
  [[nodiscard]] const vision::LineObservation& last_observation() const noexcept;
  /// Renders the present scene as the endoscope shows it now, rows from the top; `bgr` has
  /// endoscope().image_size() bytes. May throw as the constructor does with kVision.
  void RenderEndoscope(std::span<std::uint8_t> bgr) const;
  /// The same as picture `number` since Reset(), on which light and noise depend: the first that
  /// Look() takes is 1. For those who count their pictures themselves.
  void RenderPicture(std::uint64_t number, std::span<std::uint8_t> bgr) const;
  /// Renders arm and platform from outside, 640 x 480 RGB, rows from the top. May throw as
  /// RenderPicture().
  void RenderOutside(std::span<std::uint8_t> rgb) const;
  [[nodiscard]] const Endoscope& endoscope() const noexcept;

  /// What the encoders say, and where the joints really are.
  [[nodiscard]] kinematics::PsmJoints reported_joints() const noexcept;
  [[nodiscard]] kinematics::PsmJoints true_joints() const noexcept;
  /// The tip according to encoders and calibration, world frame, m.
  [[nodiscard]] Eigen::Vector3d reported_tip_m() const noexcept;

  /// Where things really are. The arm's base is known by construction.
  [[nodiscard]] static Eigen::Isometry3d p_world_base() noexcept;
  [[nodiscard]] static Eigen::Isometry3d p_world_cam() noexcept;
  [[nodiscard]] static vision::CameraModel true_camera() noexcept;
  /// The marks and sizes that vision looks for.
  [[nodiscard]] static vision::LineTarget target();

  /// The controls of an open-loop demonstration from the present state, one per row: steps of
  /// `step_m` along the line as drawn, planned now and not looked at again.
  [[nodiscard]] core::Matrix OpenLoopControls(int steps, double step_m) const;

 private:
  friend class LineTrackingWindow;
  struct World;
  struct State;
  struct Simulation;
  explicit LineTrackingPlant(std::shared_ptr<const World> world);
  void Place() noexcept;
  [[nodiscard]] const internal::GauzeLine& line() const noexcept;
  void Travel(const kinematics::PsmJoints& from, const kinematics::PsmJoints& to,
              double duration_s) noexcept;

  std::shared_ptr<const World> world_;
  std::unique_ptr<State> state_;
  std::unique_ptr<Simulation> simulation_;
  std::unique_ptr<vision::LineVision> vision_;
  std::unique_ptr<std::uint8_t[]> image_;
};

}  // namespace dfr::sim
