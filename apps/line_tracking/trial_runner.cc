#include "trial_runner.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/text/numbers.h"
#include "dfr/core/text/suggest.h"
#include "dfr/sim/line_tracking/calibration_motion.h"
#include "rollout_video.h"

namespace dfr::apps::line_tracking {
namespace {

core::Provenance Simulated(const sim::LineTrackingOptions& options) {
  core::Provenance provenance;
  provenance.origin = core::Origin::kSimulated;
  provenance.serial = std::to_string(options.arm.seed);
  return provenance;
}

}  // namespace

imitation::DemonstrationSet Demonstrate(const sim::LineTrackingOptions& options,
                                        const line_task::LineCalibration& known, int count,
                                        int steps, std::uint64_t seed,
                                        experiment::ProgressCallback progress) {
  DFR_THROW_UNLESS(count > 0, "the number of demonstrations must be positive, not " << count);
  constexpr double kDemonstratedStep = 1e-3;  // m
  sim::LineTrackingOptions calm = options;
  calm.disturbance.wave = sim::Wave::kNone;
  sim::LineTrackingPlant plant(calm, &known);
  imitation::DemonstrationSet set;
  set.layout = plant.layout();
  set.control_dim = plant.control_dim();
  set.environment = "line-tracking";
  set.provenance = Simulated(options);
  experiment::ProgressMeter meter(count, std::move(progress));
  for (std::uint64_t i = 0; set.trajectories.size() < static_cast<std::size_t>(count); ++i) {
    if (set.discarded > count) {
      throw std::runtime_error(std::to_string(set.discarded) + " of " + std::to_string(i) +
                               " demonstrations were unusable: reduce the arm's error");
    }
    core::Trajectory trajectory;
    trajectory.seed = core::DeriveSeed(seed, {i});
    plant.Reset(trajectory.seed);
    trajectory.controls = plant.OpenLoopControls(steps, kDemonstratedStep);
    trajectory.states.resize(steps + 1, plant.state_dim());
    plant.Observe(core::Row(trajectory.states, 0));
    bool usable = true;
    for (int t = 0; t < steps && usable; ++t) {
      usable = plant.Apply(core::Row(trajectory.controls, t)) == core::PlantStatus::kOk;
      plant.Observe(core::Row(trajectory.states, t + 1));
    }
    if (!usable || !plant.completed() || !trajectory.states.allFinite()) {
      ++set.discarded;
      continue;
    }
    trajectory.outcome = core::Outcome::kCompleted;
    set.trajectories.push_back(std::move(trajectory));
    meter.Advance();
  }
  return set;
}

line_task::LineCalibration CalibratePlant(const sim::LineTrackingOptions& options, int frames,
                                          std::uint64_t seed,
                                          calibration::CalibrationSummary* summary) {
  sim::LineTrackingOptions still = options;
  still.disturbance.wave = sim::Wave::kNone;
  still.observation = sim::Observation::kGroundTruth;  // the motion renders the pictures itself
  sim::LineTrackingPlant plant(still);
  const line_task::LineCalibration nominal = sim::NominalCalibration();
  line_task::LineCalibration found = calibration::Calibrate(
      sim::RecordCalibrationMotion(plant, frames, seed), sim::LineTrackingPlant::target().marks_m,
      nominal, (sim::LineTrackingPlant::p_world_base() * nominal.p_base_cam).inverse(), {},
      summary);
  found.provenance = Simulated(options);
  return found;
}

sim::LineTrackingOptions InWorld(sim::LineTrackingOptions plant, const std::string& world) {
  if (world == "frozen") return plant;
  constexpr std::string_view kUnit = "ms";
  std::optional<double> latency_ms;
  if (world.ends_with(kUnit)) {
    latency_ms = core::ParseNumber(std::string_view(world).substr(0, world.size() - kUnit.size()));
  }
  if (!latency_ms || !(*latency_ms >= 0.0)) {
    throw core::UnknownName("world", world, "frozen, or a latency in real time such as 30ms");
  }
  plant.disturbance.real_time = true;
  plant.disturbance.latency_s = 1e-3 * *latency_ms;
  return plant;
}

LineTrialRunner::LineTrialRunner(LineModel model, const std::vector<std::string>& methods,
                                 const sim::LineTrackingOptions& plant,
                                 const line_task::LineCalibration& known)
    : PlaceboRunner(std::make_unique<sim::LineTrackingPlant>(plant, &known)),
      model_(std::move(model)) {
  AddAll(
      methods,
      [this](const std::string& method) { return model_.MakeController(method, &driven()); },
      model_.fit(), model_.demonstrations().trajectories);
}

bool LineTrialRunner::Inside(std::span<const double> x) const {
  return model_.task().support().Decision(0, x) >= 0.0;
}

bool LineTrialRunner::CollidesAfterHalt() {
  if (!plant().options().disturbance.real_time) return false;
  static_cast<sim::LineTrackingPlant&>(world()).Hold(kSettleTimeS);
  return world().collided();
}

std::string LineTrialRunner::CauseOf(const control::RolloutResult& result) const {
  // A state is invalid if its picture lacks features; reports the missing features.
  if (result.halt_cause == control::HaltCause::kStateInvalid &&
      plant().options().observation == sim::Observation::kVision) {
    return std::string("not-seen-") + vision::Name(plant().last_observation().missing);
  }
  return PlaceboRunner::CauseOf(result);
}

std::map<std::string, double> LineTrialRunner::Measures() {
  return {{"gamma", model_.task().published()->at(0).gamma()}};
}

bool LineTrialRunner::Film(const std::vector<int>& methods, std::uint64_t start_seed,
                           std::uint64_t controller_seed, const std::filesystem::path& path) {
  std::vector<RolloutVideo> videos;
  videos.reserve(methods.size());
  for (const int method : methods) {
    videos.push_back(Record(*this, method, MethodName(method), start_seed, controller_seed));
  }
  WriteVideo(path, videos);
  return true;
}

void RecoveryCurves::OnControl(const control::RolloutEvent& event) {
  const control::Step& step = event.step;
  if (step.mode == control::Mode::kPolicy) {
    Finish(true);
  } else if (step.mode == control::Mode::kProbe && std::isfinite(step.threshold)) {
    current_.push_back(std::clamp(step.g / step.threshold, 0.0, 1.0));
  }
}

void RecoveryCurves::OnEnd(const control::RolloutResult& /*result*/) { Finish(false); }

void RecoveryCurves::Finish(bool reached) {
  if (current_.empty()) return;
  if (reached) current_.push_back(1.0);
  if (!complete()) curves_.push_back(current_);
  current_.clear();
}

}  // namespace dfr::apps::line_tracking
