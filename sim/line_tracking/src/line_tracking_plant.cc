#include "dfr/sim/line_tracking/line_tracking_plant.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "platform_error.h"
#include "scene/gauze_line.h"
#include "scene/line_tracking_scene.h"
#include "scene/line_tracking_simulation.h"
#include "scene/line_tracking_views.h"

namespace dfr::sim {
namespace {

using internal::GauzeLine;
using internal::PlatformError;
using kinematics::PlatformPose;
using kinematics::PsmJoints;
using kinematics::SprkPlatform;

constexpr double kMillimetre = 1e3;
constexpr double kSampleTime = 0.02;     // s, sampling period of the tip's distance
constexpr double kArmLag = 0.02;         // s, lag of the encoder readings behind their commands
constexpr double kStartX = -0.023;       // m, mean of the start position
constexpr double kStartSpread = 0.0035;  // m, maximum deviation from kStartX
constexpr int kMaxLooks = 3;

// Random streams derived from an episode's seed.
enum Purpose : std::uint64_t { kLineStream, kDisturbanceStream, kLightStream, kNoiseStream };

line_task::LineCalibration TrueCalibration() {
  line_task::LineCalibration truth;
  truth.camera = LineTrackingPlant::true_camera();
  truth.p_base_cam = LineTrackingPlant::p_world_base().inverse() * LineTrackingPlant::p_world_cam();
  return truth;
}

PlatformPose Plus(const PlatformPose& a, const PlatformPose& b) noexcept {
  return {a.translation_m + b.translation_m, a.angles_rad + b.angles_rad};
}

// Checks the options before the scene is created.
const LineTrackingOptions& Checked(const LineTrackingOptions& options) {
  const EndoscopeOptions& e = options.endoscope;
  DFR_THROW_UNLESS(e.light_change >= 0 && e.light_change <= 0.6,
                   "endoscope: light_change must lie in [0, 0.6], not " << e.light_change);
  DFR_THROW_UNLESS(e.glare >= 0 && e.glare <= 255,
                   "endoscope: glare must lie in [0, 255], not " << e.glare);
  DFR_THROW_UNLESS(e.blur_px >= 0 && e.blur_px <= 10,
                   "endoscope: blur_px must lie in [0, 10], not " << e.blur_px);
  DFR_THROW_UNLESS(e.noise >= 0 && e.noise <= 60,
                   "endoscope: noise must lie in [0, 60], not " << e.noise);
  DFR_THROW_UNLESS(
      options.max_curvature >= 0 && options.max_curvature <= 1.0 / 80.0,
      "line tracking: max_curvature must lie in [0, 1/80] per mm, not " << options.max_curvature);
  DFR_THROW_UNLESS(
      options.start_scatter_m >= 0 && options.start_scatter_m <= 1e-3,
      "line tracking: start_scatter_m must lie in [0, 0.001], not " << options.start_scatter_m);
  DFR_THROW_UNLESS(
      options.disturbance.pause_s >= 0 && options.disturbance.pause_s <= 10,
      "line tracking: pause_s must lie in [0, 10], not " << options.disturbance.pause_s);
  static_cast<void>(Disturbance(options.disturbance, 0));  // validates its options
  return options;
}

}  // namespace

struct LineTrackingPlant::World {
  LineTrackingOptions options;
  line_task::LineTask task;
  ArmError arm_error;
  PlatformError platform_error;
  Endoscope endoscope;
  internal::SceneModel scene;

  World(const LineTrackingOptions& o, const line_task::LineCalibration* known)
      : options(Checked(o)),
        task(known != nullptr ? *known : TrueCalibration(), p_world_base()),
        arm_error(o.arm),
        platform_error(o.platform_seed),
        endoscope(true_camera()),
        scene({p_world_base(), p_world_cam(), endoscope.pinhole_fovy_rad(), target().marks_m}) {}
};

// All variable data, as plain values: copying it copies the plant.
struct LineTrackingPlant::State {
  std::uint64_t seed = 0;
  GauzeLine line;
  Disturbance disturbance;
  double time_s = 0.0;      // time of the disturbance
  double arm_time_s = 0.0;  // time of the arm's creep
  double drift_phase = 0.0;
  PlatformPose offset;                                  // MovePlatform()
  PlatformPose platform;                                // pose after the lag
  Eigen::Vector3d command_m = Eigen::Vector3d::Zero();  // tip, world
  PsmJoints reading = PsmJoints::Zero();
  double start_x = 0.0;
  bool collided = false;
  bool halted = false;
  std::uint64_t pictures = 0;
  double light_phase = 0.0;
  Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
  Eigen::Vector2d glare_at = Eigen::Vector2d::Zero();
  CameraFault fault = CameraFault::kNone;
  std::array<double, 4> observed{};
  vision::LineObservation seen;

  [[nodiscard]] double drift() const noexcept {
    return drift_phase + 2.0 * std::numbers::pi * arm_time_s / 120.0;
  }
};

LineTrackingPlant::LineTrackingPlant(const LineTrackingOptions& options,
                                     const line_task::LineCalibration* calibration)
    : LineTrackingPlant(std::make_shared<const World>(options, calibration)) {
  Reset(0);
}

LineTrackingPlant::LineTrackingPlant(std::shared_ptr<const World> world)
    : world_(std::move(world)),
      state_(std::make_unique<State>()),
      simulation_(new Simulation{internal::SceneData(world_->scene), {}, {}}),
      image_(std::make_unique<std::uint8_t[]>(world_->endoscope.image_size())) {
  vision_ = std::make_unique<vision::LineVision>(world_->task.calibration().camera,
                                                 world_->task.vision());
  if (world_->options.observation == Observation::kVision) {
    simulation_->endoscope.emplace(world_->scene, false);
  }
}

LineTrackingPlant::~LineTrackingPlant() = default;

const core::StateLayout& LineTrackingPlant::layout() const noexcept {
  return world_->task.layout();
}
const LineTrackingOptions& LineTrackingPlant::options() const noexcept { return world_->options; }
const line_task::LineCalibration& LineTrackingPlant::calibration() const noexcept {
  return world_->task.calibration();
}
const Endoscope& LineTrackingPlant::endoscope() const noexcept { return world_->endoscope; }
const vision::LineObservation& LineTrackingPlant::last_observation() const noexcept {
  return state_->seen;
}

void LineTrackingPlant::Reset(std::uint64_t seed) {
  State& s = *state_;
  const World& w = *world_;
  s = State{};
  s.seed = seed;
  core::Random random(core::DeriveSeed(seed, {kLineStream}));
  s.line.c[0] = random.Uniform(-0.003, 0.003);
  s.line.c[1] = random.Uniform(-0.1, 0.1);
  const bool curved = random.Uniform() < 0.5;
  const double curvature = random.Uniform(-1.0, 1.0) * w.options.max_curvature * kMillimetre;
  s.line.c[2] = curved ? 0.5 * curvature : 0.0;
  const double start_x = kStartX + random.Uniform(-kStartSpread, kStartSpread);
  const double start_distance = w.options.start_scatter_m * random.Normal();
  s.drift_phase = random.Uniform(0.0, 2.0 * std::numbers::pi);

  core::Random light(core::DeriveSeed(seed, {kLightStream}));
  s.light_phase = light.Uniform(0.0, 2.0 * std::numbers::pi);
  s.gradient = {light.Uniform(-0.3, 0.3), light.Uniform(-0.3, 0.3)};
  s.glare_at = {light.Uniform(-0.4, 0.4), light.Uniform(-0.3, 0.3)};
  s.disturbance = Disturbance(w.options.disturbance, core::DeriveSeed(seed, {kDisturbanceStream}));

  Place();

  // The operator corrects the tip repeatedly, until the true tip is at the start.
  const Eigen::Isometry3d gauze = truth().p_world_gauze;
  const double slope = s.line.SlopeAt(start_x);
  const Eigen::Vector3d beside(-slope, 1.0, 0.0);
  const Eigen::Vector3d start =
      gauze * Eigen::Vector3d(Eigen::Vector3d(start_x, s.line.At(start_x), 0.0) +
                              start_distance * beside.normalized()) +
      Eigen::Vector3d(0.0, 0.0, kHover);
  Eigen::Vector3d command = start;
  for (int i = 0; i < 8; ++i) {
    if (!MoveTip(command)) {
      throw std::runtime_error("line tracking: the arm cannot reach the start of the line");
    }
    command += start - truth().tip_m;
  }
  const GauzeLine::Nearest nearest = s.line.NearestTo((gauze.inverse() * truth().tip_m).head<2>());
  s.start_x = nearest.x;
  s.collided = std::abs(nearest.distance) > kCollision;
  vision_->ForgetLastImage();
  Look();
}

bool LineTrackingPlant::MoveTip(const Eigen::Vector3d& tip_m) noexcept {
  PsmJoints reading;
  if (!tip_m.allFinite() || !world_->task.Reading(tip_m, reading)) return false;
  state_->command_m = tip_m;
  state_->reading = reading;
  Place();
  return true;
}

void LineTrackingPlant::MovePlatform(const PlatformPose& pose) {
  DFR_THROW_UNLESS(SprkPlatform::Reachable(pose),
                   "platform: out of reach: x "
                       << pose.translation_m.x() << ", y " << pose.translation_m.y() << ", z "
                       << pose.translation_m.z() << " m, roll " << pose.angles_rad.x() << ", pitch "
                       << pose.angles_rad.y() << ", yaw " << pose.angles_rad.z() << " rad");
  State& s = *state_;
  s.platform.translation_m += pose.translation_m - s.offset.translation_m;
  s.platform.angles_rad += pose.angles_rad - s.offset.angles_rad;
  s.offset = pose;
  Place();
}

void LineTrackingPlant::SetCameraFault(CameraFault fault) noexcept { state_->fault = fault; }

PsmJoints LineTrackingPlant::reported_joints() const noexcept { return state_->reading; }

PsmJoints LineTrackingPlant::true_joints() const noexcept {
  return world_->arm_error.Truth(state_->reading, state_->drift());
}

// Moves the joints and the platform to the values in the state. Call it after every change of the
// state.
void LineTrackingPlant::Place() noexcept {
  const PlatformPose& platform = state_->platform;
  Eigen::Isometry3d gauze = platform.Transform();
  gauze.translation() += world_->platform_error.At(platform);
  simulation_->data.Place(true_joints(), gauze);
}

LineTrackingTruth LineTrackingPlant::truth() const noexcept {
  const State& s = *state_;
  LineTrackingTruth truth;
  truth.tip_m = simulation_->data.tip_m();
  truth.p_world_gauze = simulation_->data.p_world_gauze();
  const Eigen::Vector3d on_gauze = truth.p_world_gauze.inverse() * truth.tip_m;
  const GauzeLine::Nearest nearest = s.line.NearestTo(on_gauze.head<2>());
  truth.distance_m = nearest.distance;
  truth.progress_m = s.line.Length(s.start_x, nearest.x);
  const Eigen::Vector3d tangent =
      truth.p_world_gauze.linear() * Eigen::Vector3d(1.0, s.line.SlopeAt(nearest.x), 0.0);
  truth.heading_rad = std::atan2(tangent.y(), tangent.x());
  return truth;
}

std::array<double, 4> LineTrackingPlant::TrueState() const noexcept {
  const LineTrackingTruth t = truth();
  std::array<double, 4> state;
  line_task::LineTask::State(t.tip_m, t.distance_m, t.heading_rad, state);
  return state;
}

// Moves the arm from one reading to another while the platform follows the disturbance.
void LineTrackingPlant::Travel(const PsmJoints& from, const PsmJoints& to,
                               double duration_s) noexcept {
  const State& s = *state_;
  const int samples = std::max(1, static_cast<int>(std::ceil(duration_s / kSampleTime)));
  const double dt = duration_s / samples;
  const double arm_follow = 1.0 - std::exp(-dt / kArmLag);
  for (int i = 1; i <= samples; ++i) {
    const PsmJoints target = from + (to - from) * (static_cast<double>(i) / samples);
    const DisturbanceOptions& disturbance = world_->options.disturbance;
    Drive(s.reading + arm_follow * (target - s.reading), dt,
          disturbance.during || disturbance.real_time);
  }
}

void LineTrackingPlant::Hold(double duration_s) noexcept {
  State& s = *state_;
  const bool halted = std::exchange(s.halted, false);
  const int samples = static_cast<int>(std::ceil(duration_s / kSampleTime));
  for (int i = 0; i < samples; ++i) Drive(s.reading, duration_s / samples, true);
  s.halted = halted;
}

void LineTrackingPlant::Drive(const PsmJoints& reading, double dt_s, bool platform_moves) noexcept {
  State& s = *state_;
  s.reading = reading;
  s.arm_time_s += dt_s;
  if (!s.halted) {
    if (platform_moves) s.time_s += dt_s;
    const double follow = 1.0 - std::exp(-dt_s / SprkPlatform::kTimeConstant);
    const PlatformPose command = platform_setpoint();
    s.platform.translation_m += follow * (command.translation_m - s.platform.translation_m);
    s.platform.angles_rad += follow * (command.angles_rad - s.platform.angles_rad);
  }
  Place();
  if (std::abs(truth().distance_m) > kCollision) s.collided = true;
}

void LineTrackingPlant::Rest(const PsmJoints& reading) noexcept {
  // The lags of the arm and the platform decay while the disturbance is constant.
  State& s = *state_;
  s.reading = reading;
  const DisturbanceOptions& disturbance = world_->options.disturbance;
  if (!s.halted && !disturbance.real_time) s.platform = platform_setpoint();
  Place();
  if (std::abs(truth().distance_m) > kCollision) s.collided = true;
  if (s.halted || disturbance.real_time || !disturbance.between) return;
  s.time_s += disturbance.pause_s;
  s.platform = platform_setpoint();
  Place();
  if (std::abs(truth().distance_m) > kCollision) s.collided = true;
}

PlatformPose LineTrackingPlant::platform_setpoint() const noexcept {
  return Plus(state_->disturbance.At(state_->time_s), state_->offset);
}

PlatformPose LineTrackingPlant::platform_pose() const noexcept { return state_->platform; }

core::PlantStatus LineTrackingPlant::Apply(std::span<const double> control) noexcept {
  if (control.size() != 2) return core::PlantStatus::kRefused;
  if (!std::isfinite(control[0]) || !std::isfinite(control[1])) return core::PlantStatus::kRefused;
  State& s = *state_;
  const Eigen::Vector3d step = line_task::LineTask::Displacement(control);
  const Eigen::Vector3d goal = s.command_m + step;
  PsmJoints reading;
  if (!world_->task.Reading(goal, reading)) return core::PlantStatus::kRefused;
  const PsmJoints from = s.reading;
  const DisturbanceOptions& disturbance = world_->options.disturbance;
  if (disturbance.real_time) Hold(disturbance.latency_s);
  s.command_m = goal;
  Travel(from, reading, step.norm() / kSpeed);
  Rest(reading);
  Look();
  return core::PlantStatus::kOk;
}

void LineTrackingPlant::Look() noexcept {
  State& s = *state_;
  const World& w = *world_;
  if (w.options.observation == Observation::kGroundTruth) {
    s.observed = TrueState();
    return;
  }
  const Eigen::Hyperplane<double, 3> tip_plane = w.task.TipPlane(s.reading);
  for (int look = 0; look < kMaxLooks; ++look) {
    if (s.fault != CameraFault::kFrozen) {
      ++s.pictures;
      RenderEndoscope({image_.get(), w.endoscope.image_size()});
    }
    s.seen = vision_->Observe(w.endoscope.View(image_.get()), tip_plane);
    if (s.seen.seen()) break;
  }
  w.task.State(s.seen, s.observed);
}

void LineTrackingPlant::RenderEndoscope(std::span<std::uint8_t> bgr) const {
  RenderPicture(state_->pictures, bgr);
}

void LineTrackingPlant::RenderPicture(std::uint64_t number, std::span<std::uint8_t> bgr) const {
  const State& s = *state_;
  const World& w = *world_;
  const EndoscopeOptions& o = w.options.endoscope;
  std::optional<internal::SceneView>& view = simulation_->endoscope;
  if (!view) view.emplace(w.scene, false);
  const std::span<const std::uint8_t> pinhole = view->Draw(
      simulation_->data, {s.line, s.fault != CameraFault::kNoLine, s.fault != CameraFault::kNoTip});
  EndoscopeLight light;
  // The light flickers slightly and varies slowly over an episode.
  const double t = 0.05 * static_cast<double>(number) + s.light_phase;
  light.gain = 0.95 * (1.0 + 0.8 * o.light_change * std::sin(0.7 * t) +
                       0.2 * o.light_change * std::sin(13.0 * t));
  light.gradient = s.gradient;
  light.glare = o.glare;
  light.glare_at = s.glare_at + Eigen::Vector2d(0.1 * std::sin(0.3 * t), 0.1 * std::cos(0.4 * t));
  light.blur_px = o.blur_px;
  light.noise = o.noise;
  if (s.fault == CameraFault::kBlack) {
    light.gain = 0.0;
    light.glare = 0.0;
  } else if (s.fault == CameraFault::kOverexposed) {
    light.gain = 6.0;
  }
  w.endoscope.Develop(pinhole, light, core::DeriveSeed(s.seed, {kNoiseStream, number}), bgr);
}

void LineTrackingPlant::RenderOutside(std::span<std::uint8_t> rgb) const {
  std::optional<internal::SceneView>& view = simulation_->outside;
  if (!view) view.emplace(world_->scene, true);
  simulation_->data.PlaceLegs();
  const std::span<const std::uint8_t> picture =
      view->Draw(simulation_->data, {state_->line, true, true});
  constexpr std::size_t kRow = std::size_t{3} * internal::SceneView::kWidth;
  for (std::size_t i = 0; i < internal::SceneView::kHeight; ++i) {
    const auto from = picture.subspan((internal::SceneView::kHeight - 1 - i) * kRow, kRow);
    std::copy(from.begin(), from.end(), rgb.begin() + static_cast<std::ptrdiff_t>(i * kRow));
  }
}

void LineTrackingPlant::Observe(std::span<double> state) const noexcept {
  std::copy(state_->observed.begin(), state_->observed.end(), state.begin());
}

bool LineTrackingPlant::completed() const noexcept {
  return !state_->collided && truth().progress_m >= kCompletion;
}

bool LineTrackingPlant::collided() const noexcept { return state_->collided; }

void LineTrackingPlant::Halt() noexcept { state_->halted = true; }

std::unique_ptr<core::SimulatedPlant> LineTrackingPlant::Clone() const {
  std::unique_ptr<LineTrackingPlant> copy(new LineTrackingPlant(world_));
  copy->CopyStateFrom(*this);
  return copy;
}

void LineTrackingPlant::CopyStateFrom(const core::SimulatedPlant& other) noexcept {
  const auto& source = static_cast<const LineTrackingPlant&>(other);
  *state_ = *source.state_;
  Place();
  std::copy_n(source.image_.get(), world_->endoscope.image_size(), image_.get());
  vision_->ForgetLastImage();
}

core::Matrix LineTrackingPlant::OpenLoopControls(int steps, double step_m) const {
  DFR_THROW_UNLESS(steps > 0 && step_m > 0 && step_m <= kStep,
                   "line tracking: a demonstration has at least one step of at most "
                       << 1e3 * kStep << " mm, not " << steps << " of " << 1e3 * step_m << " mm");
  const Eigen::Isometry3d gauze = truth().p_world_gauze;
  const GauzeLine& line = state_->line;
  const auto at = [&](double x) {
    return Eigen::Vector3d(gauze * Eigen::Vector3d(x, line.At(x), 0.0));
  };
  core::Matrix controls(steps, 2);
  double x = line.NearestTo((gauze.inverse() * truth().tip_m).head<2>()).x;
  for (int i = 0; i < steps; ++i) {
    const double next = line.Along(x, step_m);
    controls.row(i) = (at(next) - at(x)).head<2>().transpose() / kStep;
    x = next;
  }
  return controls;
}

}  // namespace dfr::sim
