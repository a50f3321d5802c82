#include "dfr/sim/pusher/pusher_plant.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "arm_pose.h"
#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dynamic_motion.h"
#include "pusher_world.h"
#include "quasi_static_step.h"
#include "segments.h"

namespace dfr::sim {
namespace {

using internal::Arm;
using internal::FindLowPoint;
using internal::JointAngles;
using internal::kTableZ;
using internal::LiftOffTable;
using internal::ReadAxes;
using internal::Segment;
using internal::SetArm;

constexpr int kNumJoints = PusherPlant::kNumJoints;
constexpr int kObjectX = kNumJoints;  // index of the cylinder's coordinates in qpos and qvel

// Maximum motion of the gripper per substep (except for the curvature of its path): less than the
// margin for contact detection.
constexpr double kSubstepMotion = 0.002;
// Index of the hand, the first part of the gripper. Earlier parts are upper arm and forearm.
constexpr std::size_t kFirstGripperPart = 2;
constexpr int kMaxSubsteps = 100;
// The cylinder is at rest if it moves by less than 5 um in a substep.
constexpr double kRestSpeed = 5e-4;
constexpr int kMaxSettleSubsteps = 20;
// A larger overlap at rest means that the arm presses the cylinder onto the table.
constexpr double kJammed = 5e-4;
// Maximum distance between any point of the arm and the axis of any of its joints.
constexpr double kArmLength = 0.96;

double Lowest(const Segment& axis) noexcept { return std::min(axis.a[2], axis.b[2]); }

Segment ObjectAxis(const PusherPlant::World& world, const mjData* d) noexcept {
  const mjtNum* center = d->xpos + 3 * world.object_body;
  Segment axis{{center[0], center[1], center[2]}, {center[0], center[1], center[2]}};
  axis.a[2] -= world.object_half_length;
  axis.b[2] += world.object_half_length;
  return axis;
}

double Square(double x) noexcept { return x * x; }

// Horizontal distance, because both axes are vertical and the heights overlap.
double ObjectToRed(const Segment& object, const Segment& red) noexcept {
  return std::hypot(object.a[0] - red.a[0], object.a[1] - red.a[1]);
}

std::string_view FindCollision(const PusherPlant::World& world, const Arm& arm,
                               const Segment& object) noexcept {
  for (const Segment& red : world.reds) {
    if (ObjectToRed(object, red) < PusherPlant::kObjectRadius + PusherPlant::kRedRadius) {
      return "object";
    }
    for (std::size_t i = 0; i < world.parts.size(); ++i) {
      const double apart = world.parts[i].radius + PusherPlant::kRedRadius;
      if (Lowest(arm.axes[i]) > red.b[2] + apart) continue;
      if (SquaredDistance(arm.axes[i], red) < apart * apart) return world.parts[i].name;
    }
  }
  return {};
}

// Returns true if any part of the arm, moving by at most `motion`, could reach the cylinder or a
// region.
bool CouldTouch(const PusherPlant::World& world, const Arm& arm, const Segment& object,
                double motion) noexcept {
  for (std::size_t i = 0; i < world.parts.size(); ++i) {
    const Segment& axis = arm.axes[i];
    const double reach = world.parts[i].radius + motion;
    for (const Segment& red : world.reds) {
      const double apart = PusherPlant::kRedRadius + reach;
      if (Lowest(axis) > red.b[2] + apart) continue;
      if (SquaredDistance(axis, red) < apart * apart) return true;
    }
    const double apart = PusherPlant::kObjectRadius + reach;
    if (Lowest(axis) > object.b[2] + apart) continue;
    if (SquaredDistance(axis, object) < apart * apart) return true;
  }
  return false;
}

// Returns the largest distance between a point on a part's axis in pose `a` and the same point in
// pose `b`. The largest distance is at an end, because the distance is convex along the axis.
// (Turning a capsule about its axis does not move it.)
double MaxMotion(const PusherPlant::World& world, const Arm& a, const Arm& b,
                 std::size_t first_part) noexcept {
  double squared = 0.0;
  for (std::size_t i = first_part; i < world.parts.size(); ++i) {
    double at_a = 0.0;
    double at_b = 0.0;
    for (int k = 0; k < 3; ++k) {
      at_a += Square(a.axes[i].a[k] - b.axes[i].a[k]);
      at_b += Square(a.axes[i].b[k] - b.axes[i].b[k]);
    }
    squared = std::max({squared, at_a, at_b});
  }
  return std::sqrt(squared);
}

}  // namespace

std::string_view Name(Gripper gripper) noexcept {
  switch (gripper) {
    case Gripper::kBar:
      return "bar";
    case Gripper::kWideBar:
      return "wide-bar";
    case Gripper::kFork:
      return "fork";
  }
  return "unknown";
}

std::string_view Name(PusherPhysics physics) noexcept {
  return physics == PusherPhysics::kDynamic ? "dynamic" : "quasi-static";
}

PusherPlant::PusherPlant(const PusherOptions& options)
    : PusherPlant(std::make_shared<const World>(options)) {
  Reset(0);
}

PusherPlant::PusherPlant(std::shared_ptr<const World> world)
    : world_(std::move(world)), data_(std::make_unique<Data>()) {
  data_->mj.reset(mj_makeData(world_->model.get()));
  if (data_->mj == nullptr) throw std::runtime_error("PusherPlant: MuJoCo is out of memory");
  internal::ResetQuasiStatic(world_->model.get(), data_->mj.get());
}

PusherPlant::~PusherPlant() = default;

const core::StateLayout& PusherPlant::layout() const noexcept { return world_->layout; }
const PusherOptions& PusherPlant::options() const noexcept { return world_->options; }

void PusherPlant::Reset(std::uint64_t seed) {
  const PusherOptions& o = world_->options;
  core::Random random(seed);
  mjData* d = data_->mj.get();
  internal::ResetQuasiStatic(world_->model.get(), d);
  d->qpos[kObjectX] = random.Uniform(o.start_x_min, o.start_x_max);
  d->qpos[kObjectX + 1] = random.Uniform(-o.start_y, o.start_y);
  mj_kinematics(world_->model.get(), d);
  data_->collided_part = {};
  data_->faulted = false;
  data_->residual_speed = 0.0;
}

void PusherPlant::SetState(std::span<const double> state) {
  DFR_THROW_UNLESS(
      static_cast<int>(state.size()) == state_dim(),
      "PusherPlant::SetState: expected " << state_dim() << " entries, got " << state.size());
  const mjModel* m = world_->model.get();
  for (std::size_t i = 0; i < state.size(); ++i) {
    DFR_THROW_UNLESS(std::isfinite(state[i]),
                     "PusherPlant::SetState: entry " << i << " is not finite");
  }
  for (int j = 0; j < kNumJoints; ++j) {
    DFR_THROW_UNLESS(
        state[j] >= m->jnt_range[2 * j] && state[j] <= m->jnt_range[2 * j + 1],
        "PusherPlant::SetState: joint " << j << " at " << state[j] << " rad is outside its limits");
  }
  constexpr int kObjectEntry = kNumJoints + 3;  // entries after qpos and tip
  mjData* d = data_->mj.get();
  internal::ResetQuasiStatic(m, d);
  std::copy_n(state.data(), kNumJoints, d->qpos);
  d->qpos[kObjectX] = state[kObjectEntry];
  d->qpos[kObjectX + 1] = state[kObjectEntry + 1];
  mj_kinematics(m, d);
  Arm arm;
  ReadAxes(*world_, d, arm);
  data_->collided_part = FindCollision(*world_, arm, ObjectAxis(*world_, d));
  data_->faulted = false;
  data_->residual_speed = 0.0;
}

core::PlantStatus PusherPlant::Apply(std::span<const double> control) noexcept {
  Data& data = *data_;
  if (data.faulted) return core::PlantStatus::kFault;
  if (control.size() != kNumJoints) return core::PlantStatus::kRefused;
  for (const double u : control) {
    if (!std::isfinite(u)) return core::PlantStatus::kRefused;
  }

  const World& world = *world_;
  const mjModel* m = world.model.get();
  mjData* d = data.mj.get();
  ++data.statistics.controls;
  data.residual_speed = 0.0;

  JointAngles start;
  std::copy_n(d->qpos, kNumJoints, start.begin());
  JointAngles target;
  const double joint_step = options().joint_step;
  bool saturated = false;
  for (int j = 0; j < kNumJoints; ++j) {
    saturated |= std::abs(control[j]) > 1.0;
    target[j] = std::clamp(start[j] + joint_step * std::clamp(control[j], -1.0, 1.0),
                           m->jnt_range[2 * j], m->jnt_range[2 * j + 1]);
  }
  data.statistics.saturated += saturated;

  Arm at_start;
  ReadAxes(world, d, at_start);
  SetArm(target, d);
  mj_kinematics(m, d);
  Arm at_target;
  ReadAxes(world, d, at_target);
  if (FindLowPoint(world, at_target).z < kTableZ) {
    ++data.statistics.stopped_by_table;
    if (!LiftOffTable(world, d, target, at_target)) target = start;
    SetArm(target, d);
    mj_kinematics(m, d);
    ReadAxes(world, d, at_target);
  }

  if (world.options.physics == PusherPhysics::kDynamic) {
    SetArm(start, d);
    return MoveDynamically(target);
  }

  double turn = 0.0;
  for (int j = 0; j < kNumJoints; ++j) turn += std::abs(target[j] - start[j]);
  const double chord = MaxMotion(world, at_start, at_target, 0);
  // A path with second derivative <= kArmLength turn^2 deviates from its chord by at most
  // kArmLength turn^2 / 8.
  const double motion = chord + kArmLength * turn * turn / 8.0;
  const Segment object = ObjectAxis(world, d);
  if (!CouldTouch(world, at_start, object, motion)) return core::PlantStatus::kOk;

  ++data.statistics.simulated;
  mju_zero(d->qacc_warmstart, m->nv);
  const double h = m->opt.timestep;
  const double gripper_motion = MaxMotion(world, at_start, at_target, kFirstGripperPart);
  const int substeps =
      std::clamp(static_cast<int>(std::ceil(gripper_motion / kSubstepMotion)), 1, kMaxSubsteps);
  JointAngles velocity;
  for (int j = 0; j < kNumJoints; ++j) velocity[j] = (target[j] - start[j]) / (substeps * h);
  const double object_start[2] = {d->qpos[kObjectX], d->qpos[kObjectX + 1]};
  Arm arm;
  double penetration = 0.0;
  double deepest = 0.0;
  double speed = 0.0;
  int step = 0;
  do {
    const bool moving = step < substeps;
    const double done = static_cast<double>(step) / substeps;
    for (int j = 0; j < kNumJoints; ++j) {
      d->qpos[j] = moving ? start[j] + done * (target[j] - start[j]) : target[j];
      d->qvel[j] = moving ? velocity[j] : 0.0;
    }
    d->qvel[kObjectX] = d->qvel[kObjectX + 1] = 0.0;
    if (!internal::QuasiStaticStep(m, d)) {
      data.faulted = true;
      return core::PlantStatus::kFault;
    }
    ++step;
    penetration = 0.0;
    for (int c = 0; c < d->ncon; ++c) penetration = std::max(penetration, -d->contact[c].dist);
    deepest = std::max(deepest, penetration);
    speed = std::hypot(d->qvel[kObjectX], d->qvel[kObjectX + 1]);
    // The kinematics belong to the start of the substep. The last state is checked below.
    if (data.collided_part.empty()) {
      ReadAxes(world, d, arm);
      data.collided_part = FindCollision(world, arm, ObjectAxis(world, d));
    }
  } while (step <= substeps || (speed > kRestSpeed && step < substeps + kMaxSettleSubsteps));

  PusherStatistics& statistics = data.statistics;
  statistics.substeps += step;
  if (penetration > kJammed) {
    ++statistics.stalled;
    target = start;
    d->qpos[kObjectX] = object_start[0];
    d->qpos[kObjectX + 1] = object_start[1];
    at_target = at_start;
  } else {
    data.residual_speed = speed;
    statistics.max_residual_speed = std::max(statistics.max_residual_speed, speed);
    statistics.max_penetration_m = std::max(statistics.max_penetration_m, deepest);
    statistics.max_rest_penetration_m = std::max(statistics.max_rest_penetration_m, penetration);
  }

  SetArm(target, d);
  mju_zero(d->qvel, m->nv);
  mj_kinematics(m, d);
  if (data.collided_part.empty()) {
    data.collided_part = FindCollision(world, at_target, ObjectAxis(world, d));
  }
  return core::PlantStatus::kOk;
}

core::PlantStatus PusherPlant::MoveDynamically(const std::array<double, kNumJoints>& target) {
  const World& world = *world_;
  mjData* d = data_->mj.get();
  PusherStatistics& statistics = data_->statistics;
  ++statistics.simulated;
  internal::DynamicMotion motion(world.model.get(), d, target);
  Arm arm;
  double penetration = 0.0;
  while (!motion.Done()) {
    if (!motion.Step()) {
      data_->faulted = true;
      return core::PlantStatus::kFault;
    }
    penetration = 0.0;
    for (int c = 0; c < d->ncon; ++c) penetration = std::max(penetration, -d->contact[c].dist);
    statistics.max_penetration_m = std::max(statistics.max_penetration_m, penetration);
    // The kinematics belong to the start of the step; the final state is checked below.
    if (data_->collided_part.empty()) {
      ReadAxes(world, d, arm);
      data_->collided_part = FindCollision(world, arm, ObjectAxis(world, d));
    }
  }
  statistics.substeps += motion.steps();
  statistics.unsettled += motion.AtRest() ? 0 : 1;
  data_->residual_speed = std::hypot(d->qvel[kObjectX], d->qvel[kObjectX + 1]);
  statistics.max_residual_speed = std::max(statistics.max_residual_speed, data_->residual_speed);
  statistics.max_rest_penetration_m = std::max(statistics.max_rest_penetration_m, penetration);
  mju_zero(d->qvel, world.model->nv);
  mj_kinematics(world.model.get(), d);
  if (data_->collided_part.empty()) {
    ReadAxes(world, d, arm);
    data_->collided_part = FindCollision(world, arm, ObjectAxis(world, d));
  }
  return core::PlantStatus::kOk;
}

void PusherPlant::Observe(std::span<double> state) const noexcept {
  assert(static_cast<int>(state.size()) == state_dim());
  const mjData* d = data_->mj.get();
  double* out = std::copy_n(d->qpos, kNumJoints, state.data());
  out = std::copy_n(d->site_xpos + 3 * world_->tip_site, 3, out);
  out = std::copy_n(d->xpos + 3 * world_->object_body, 3, out);
  out = std::copy_n(world_->goal.data(), 3, out);
  for (const Segment& red : world_->reds) out = std::copy_n(red.a.data(), 3, out);
  const mjtNum* r = d->site_xmat + 9 * world_->tip_site;
  *out++ = 0.1 * r[3];
  *out++ = 0.1 * r[6];
  *out++ = 0.1 * r[7];
}

bool PusherPlant::completed() const noexcept {
  const mjtNum* object = data_->mj->xpos + 3 * world_->object_body;
  return !collided() &&
         std::hypot(object[0] - world_->goal[0], object[1] - world_->goal[1]) < kGoalRadius;
}

bool PusherPlant::collided() const noexcept { return !data_->collided_part.empty(); }
std::string_view PusherPlant::collided_part() const noexcept { return data_->collided_part; }

std::unique_ptr<core::SimulatedPlant> PusherPlant::Clone() const {
  std::unique_ptr<PusherPlant> clone(new PusherPlant(world_));
  clone->data_->statistics = data_->statistics;
  clone->CopyStateFrom(*this);
  return clone;
}

void PusherPlant::CopyStateFrom(const core::SimulatedPlant& other) noexcept {
  assert(dynamic_cast<const PusherPlant*>(&other) != nullptr);
  const Data& from = *static_cast<const PusherPlant&>(other).data_;
  mjData* d = data_->mj.get();
  if (data_->faulted) internal::ResetQuasiStatic(world_->model.get(), d);
  std::copy_n(from.mj->qpos, world_->model->nq, d->qpos);
  mj_kinematics(world_->model.get(), d);
  data_->collided_part = from.collided_part;
  data_->faulted = from.faulted;
  data_->residual_speed = from.residual_speed;
}

double PusherPlant::residual_speed() const noexcept { return data_->residual_speed; }
const PusherStatistics& PusherPlant::statistics() const noexcept { return data_->statistics; }

std::array<double, 3> PusherPlant::object_m() const noexcept {
  const mjtNum* p = data_->mj->xpos + 3 * world_->object_body;
  return {p[0], p[1], p[2]};
}

std::array<double, 3> PusherPlant::tip_m() const noexcept {
  const mjtNum* p = data_->mj->site_xpos + 3 * world_->tip_site;
  return {p[0], p[1], p[2]};
}

std::array<double, 3> PusherPlant::goal_m() const noexcept { return world_->goal; }

}  // namespace dfr::sim
