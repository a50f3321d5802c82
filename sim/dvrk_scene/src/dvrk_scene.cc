#include "dfr/sim/dvrk_scene/dvrk_scene.h"

#include "dfr/core/contract.h"

namespace dfr::sim {
namespace {

DvrkSceneOptions Checked(DvrkSceneOptions options) {
  DFR_THROW_UNLESS(options.linger_s >= 0.0 && options.linger_s <= 10.0,
                   "linger_s must lie in [0, 10]");
  // With vision, the plant would take and evaluate its own pictures.
  options.world.observation = Observation::kGroundTruth;
  return options;
}

}  // namespace

DvrkScene::DvrkScene(const DvrkSceneOptions& options, const line_task::LineCalibration* calibration)
    : options_(Checked(options)),
      console_(options_.arm),
      plant_(options_.world, calibration),
      seed_(options_.seed),
      last_setpoint_(console_.setpoint_joints()),
      still_s_(options_.linger_s) {
  plant_.Reset(seed_);
}

void DvrkScene::Reset(std::uint64_t seed) {
  plant_.Reset(seed);
  plant_.SetCameraFault(camera_fault_);
  seed_ = seed;
  console_.Place(plant_.reported_joints());
  last_setpoint_ = console_.setpoint_joints();
  still_s_ = options_.linger_s;
}

void DvrkScene::Step(double dt_s) {
  console_.Step(dt_s);
  Follow(dt_s);
}

void DvrkScene::Follow(double dt_s) noexcept {
  const bool changed = console_.setpoint_joints() != last_setpoint_;
  last_setpoint_ = console_.setpoint_joints();
  still_s_ = changed ? 0.0 : still_s_ + dt_s;
  const bool arm_moves = changed || still_s_ < options_.linger_s;
  const DisturbanceOptions& disturbance = options_.world.disturbance;
  const bool platform_moves =
      arm_moves ? disturbance.during : disturbance.between && options_.linger_s > 0.0;
  plant_.Drive(console_.homed() ? console_.measured_joints() : plant_.reported_joints(), dt_s,
               platform_moves);
}

void DvrkScene::SetCameraFault(CameraFault fault) noexcept {
  camera_fault_ = fault;
  plant_.SetCameraFault(fault);
}

void DvrkScene::Rest() {
  console_.Settle();
  last_setpoint_ = console_.setpoint_joints();
  plant_.Rest(console_.homed() ? console_.measured_joints() : plant_.reported_joints());
}

}  // namespace dfr::sim
