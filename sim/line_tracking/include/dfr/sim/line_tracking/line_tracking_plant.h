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

/// Source of the state that Observe() returns.
enum class Observation {
  kVision,       ///< Estimate from the endoscope's image.
  kGroundTruth,  ///< Ground truth of the simulation: fast and exact.
};

/// Camera faults, for tests.
enum class CameraFault {
  kNone,
  kFrozen,       ///< Repeats the last image.
  kBlack,        ///< Lamp off.
  kOverexposed,  ///< White image.
  kNoLine,       ///< Line out of view.
  kNoTip,        ///< End-effector out of view.
};

/// Light and optics of the simulated endoscope. Light and glare also vary per episode and image.
struct EndoscopeOptions {
  double light_change = 0.2;  ///< Maximum relative change of the gain, in [0, 0.6].
  double glare = 20.0;        ///< Brightness of the brightest spot, in [0, 255].
  double blur_px = 0.5;       ///< Standard deviation of the focus blur.
  double noise = 3.0;         ///< Standard deviation of the noise; white is 255.
};

/// Options for LineTrackingPlant. Defaults are the experiment's scene without disturbance.
struct LineTrackingOptions {
  Observation observation = Observation::kVision;
  DisturbanceOptions disturbance;
  ArmErrorOptions arm;
  EndoscopeOptions endoscope;
  std::uint64_t platform_seed = 1;  ///< Seed of the platform's positioning error.
  /// Maximum curvature of a line, 1/mm. Half of the lines are straight.
  double max_curvature = 1.0 / 150.0;
  double start_scatter_m = 6e-4;  ///< Standard deviation of the tip's initial distance to the line.
};

/// Ground truth of the simulation.
struct LineTrackingTruth {
  Eigen::Vector3d tip_m = Eigen::Vector3d::Zero();  ///< World frame.
  Eigen::Isometry3d p_world_gauze = Eigen::Isometry3d::Identity();
  double distance_m = 0.0;   ///< Same as LineObservation::distance_m.
  double progress_m = 0.0;   ///< Progress along the line since Reset().
  double heading_rad = 0.0;  ///< Angle of the line next to the tip, in the world's xy-plane.
};

/// The line tracking task of Sec. V-B: a PSM follows a red line on gauze that a Stewart platform
/// moves, observed by an overhead endoscope.
///
/// World frame: origin in the middle of the gauze with the platform at home, z up, the line roughly
/// along x. The arm reaches in from +y, inclined by 40 degrees, and holds its orientation.
///
/// State (4), in millimetres to give its entries similar magnitudes:
///   tip(2)       the tool's tip, x and y in the world frame
///   distance(1)  from the line to the tip in the gauze's plane, positive to the left (+y)
///   heading(1)   direction of the line next to the tip: 10 mm times its angle to the x-axis, rad
/// All entries are NaN if vision does not find the line and the tip in three consecutive pictures;
/// every controller then halts.
///
/// Control (2): displacement of the tool in x and y, in units of kStep = 2 mm. The height above the
/// table stays as commanded. Entries beyond +-1 saturate. The plant rejects a control of another
/// size, with a non-finite entry, or to a point beyond the arm's reach, and does not move.
///
/// The world is a MuJoCo model whose poses are set, never integrated: position control, everything
/// at rest after each control, negligible forces. Encoder readings lag behind commands by 20 ms.
/// The tip's position follows from the true joints, which differ from the readings (ArmError). The
/// platform follows its commanded pose with a 0.2 s lag and a positioning error of 1.22, 1.07 and
/// 0.20 mm RMS in x, y and z. After every control, everything comes to rest before the state is
/// observed. A control takes |u| kStep / kSpeed of the disturbance's time if the disturbance acts
/// during controls, and pause_s more if it acts between them. In real time it takes latency_s and
/// then |u| kStep / kSpeed, and the platform does not come to rest.
///
/// collided(): the true tip was more than kCollision from the line in the gauze's plane at any
/// time, sampled every 20 ms of motion and at rest. completed(): the tip has tracked kCompletion of
/// the line without a collision.
///
/// The endoscope's picture is MuJoCo's rendering of the camera's view (MujocoRenderer, without a
/// display), processed by an Endoscope.
///
/// Apply() allocates nothing with kGroundTruth; with kVision, OpenCV and OpenGL may allocate. Each
/// object belongs to the thread that made it; clones share the immutable scene.
class LineTrackingPlant final : public core::SimulatedPlant {
 public:
  static constexpr double kStep = line_task::LineTask::kStep;            ///< m per unit of control.
  static constexpr double kSpeed = line_task::LineTask::kSpeed;          ///< m/s of the tool.
  static constexpr double kCollision = line_task::LineTask::kCollision;  ///< m
  static constexpr double kCompletion = line_task::LineTask::kCompletion;  ///< m
  static constexpr double kHover = 0.0025;  ///< m, initial height of the tip above the gauze.

  /// @param calibration  used by vision and commands; nullptr: the true camera, in its true pose,
  ///   and an uncorrected arm.
  /// @throws std::invalid_argument naming the value out of range, including a disturbance beyond
  ///   the platform's reach; std::runtime_error with kVision if rendering is not possible on this
  ///   machine.
  explicit LineTrackingPlant(const LineTrackingOptions& options = {},
                             const line_task::LineCalibration* calibration = nullptr);
  ~LineTrackingPlant() override;
  LineTrackingPlant(const LineTrackingPlant&) = delete;
  LineTrackingPlant& operator=(const LineTrackingPlant&) = delete;

  [[nodiscard]] const core::StateLayout& layout() const noexcept override;
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  [[nodiscard]] const LineTrackingOptions& options() const noexcept;
  [[nodiscard]] const line_task::LineCalibration& calibration() const noexcept;

  /// Samples the line, the disturbance and the light, and places the tip over the start of the
  /// line, with the platform at home.
  void Reset(std::uint64_t seed) override;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override;
  [[nodiscard]] bool collided() const noexcept override;
  /// Stops the platform and the disturbance until Reset().
  void Halt() noexcept override;
  /// Holds the arm still for this time while the platform keeps moving, even after Halt(). Never
  /// allocates.
  void Hold(double duration_s) noexcept;

  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  /// @pre one plant is a clone of the other, or both are clones of a third plant.
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

  /// Sets the platform's rest pose, to which the disturbance is added; for calibration and tests.
  /// @throws std::invalid_argument if it is beyond the platform's reach.
  void MovePlatform(const kinematics::PlatformPose& pose);
  /// Sets the tool's commanded tip, world frame; for calibration and tests. Returns false and moves
  /// nothing if it is out of reach.
  [[nodiscard]] bool MoveTip(const Eigen::Vector3d& tip_m) noexcept;
  void SetCameraFault(CameraFault fault) noexcept;
  /// Takes the next picture and evaluates it, as Apply() does.
  void Look() noexcept;

  /// Advances the world by `dt_s` for an external arm and clock (a console's); `reading` is the new
  /// encoder reading. The platform follows its commanded pose. The disturbance advances if
  /// `platform_moves` and Halt() was not called. Samples the tip's distance once. Calls with the
  /// readings and times of Apply() give bit-identical results. Never allocates.
  /// @pre dt_s >= 0, `reading` finite
  void Drive(const kinematics::PsmJoints& reading, double dt_s, bool platform_moves) noexcept;
  /// Brings everything to rest, as after a control: the encoders read `reading`, and the platform
  /// reaches its commanded pose. If the disturbance acts between controls, it advances by its
  /// pause.
  void Rest(const kinematics::PsmJoints& reading) noexcept;
  /// Commanded pose of the platform, and its pose after the lag, which a driver can report.
  /// Excludes the platform's positioning error, which is not measurable.
  [[nodiscard]] kinematics::PlatformPose platform_setpoint() const noexcept;
  [[nodiscard]] kinematics::PlatformPose platform_pose() const noexcept;

  [[nodiscard]] LineTrackingTruth truth() const noexcept;
  /// Returns the state that Observe() gives with kGroundTruth.
  [[nodiscard]] std::array<double, 4> TrueState() const noexcept;
  /// Returns the last result of vision. With kGroundTruth, it is empty.
  [[nodiscard]] const vision::LineObservation& last_observation() const noexcept;
  /// Renders the current scene as the endoscope's picture, rows from the top. `bgr` has
  /// endoscope().image_size() bytes. May throw as the constructor does with kVision.
  void RenderEndoscope(std::span<std::uint8_t> bgr) const;
  /// Renders picture `number` since Reset(), for callers that count pictures themselves. The number
  /// determines light and noise; the first picture of Look() is 1.
  void RenderPicture(std::uint64_t number, std::span<std::uint8_t> bgr) const;
  /// Renders the arm and the platform from outside, 640 x 480 RGB, rows from the top. May throw as
  /// RenderPicture().
  void RenderOutside(std::span<std::uint8_t> rgb) const;
  [[nodiscard]] const Endoscope& endoscope() const noexcept;

  /// Encoder readings and true joint positions.
  [[nodiscard]] kinematics::PsmJoints reported_joints() const noexcept;
  [[nodiscard]] kinematics::PsmJoints true_joints() const noexcept;

  /// True poses and camera. The arm's base is known by construction.
  [[nodiscard]] static Eigen::Isometry3d p_world_base() noexcept;
  [[nodiscard]] static Eigen::Isometry3d p_world_cam() noexcept;
  [[nodiscard]] static vision::CameraModel true_camera() noexcept;
  /// Returns the marks and sizes for vision.
  [[nodiscard]] static vision::LineTarget target();

  /// Returns the controls of an open-loop demonstration from the current state, one per row: steps
  /// of `step_m` along the line as drawn, planned once, without later observations.
  [[nodiscard]] core::Matrix OpenLoopControls(int steps, double step_m) const;

 private:
  struct World;
  struct State;
  struct Simulation;
  explicit LineTrackingPlant(std::shared_ptr<const World> world);
  void Place() noexcept;
  void Travel(const kinematics::PsmJoints& from, const kinematics::PsmJoints& to,
              double duration_s) noexcept;

  std::shared_ptr<const World> world_;
  std::unique_ptr<State> state_;
  std::unique_ptr<Simulation> simulation_;
  std::unique_ptr<vision::LineVision> vision_;
  std::unique_ptr<std::uint8_t[]> image_;
};

}  // namespace dfr::sim
