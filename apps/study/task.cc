#include "apps/study/task.h"

#include <algorithm>
#include <numbers>
#include <utility>

#include "apps/line_tracking/model.h"
#include "apps/line_tracking/rollout_video.h"
#include "apps/line_tracking/trial_runner.h"
#include "apps/pusher/model.h"
#include "apps/pusher/supervisor/supervisor.h"
#include "apps/study/imitator.h"
#include "apps/study/planar/methods.h"
#include "apps/study/planar/picture.h"
#include "apps/study/planar/task.h"
#include "dfr/core/random.h"
#include "dfr/core/text/suggest.h"
#include "dfr/imitation/fit_mlp.h"
#include "dfr/sim/gallery/gallery.h"
#include "dfr/sim/line_tracking/arm_error.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "dfr/sim/pusher/pusher_view.h"

namespace dfr::study {
namespace {

constexpr std::uint64_t kDemonstrationStream = 1;
constexpr std::uint64_t kLearnerStream = 2;

// Trains the policy with the settings of the Pusher's weak learner.
LearnedModel Learn(const std::string& name, const core::SimulatedPlant& plant,
                   std::vector<core::Trajectory> demonstrations, FittedTask task,
                   std::uint64_t seed, const Expert& supervisor) {
  imitation::DemonstrationSet set{.layout = plant.layout(),
                                  .control_dim = plant.control_dim(),
                                  .environment = name,
                                  .trajectories = std::move(demonstrations),
                                  .note = {}};
  const imitation::FitMlpOptions fit{.hidden = {8}, .epochs = 10, .seed = seed};
  imitation::MlpPolicy policy = imitation::FitMlp(set, fit);
  Expert teaching = TeachMlp(set, fit);
  teaching.plant = supervisor.plant;
  teaching.supervise = supervisor.supervise;
  return {std::move(policy), std::move(task), std::move(set), std::move(teaching)};
}

Task Pusher() {
  const auto plant = [](const sim::PusherOptions& options) {
    return [options] { return std::make_unique<sim::PusherPlant>(options); };
  };
  Task task{.name = "pusher",
            .variants = {{"", plant({})},
                         {"wider starts", plant({.start_y = 0.17})},
                         {"gripper: wide bar", plant({.gripper = sim::Gripper::kWideBar})},
                         {"gripper: fork", plant({.gripper = sim::Gripper::kFork})}},
            .length = 0.1};  // m: the cylinder
  task.learn = [](int demonstrations, std::uint64_t seed) -> LearnedModel {
    apps::pusher::ModelOptions options;
    options.seed = core::DeriveSeed(seed, {kLearnerStream});
    sim::PusherPlant world;
    const auto supervisor = imitation::GaussianPolicy::Load(apps::pusher::ShippedSupervisor());
    return apps::pusher::Model::Fit(
        apps::pusher::Demonstrate(world, supervisor, demonstrations, options.horizon,
                                  core::DeriveSeed(seed, {kDemonstrationStream})),
        demonstrations, options, &supervisor);
  };
  task.draw = [](const core::SimulatedPlant& world) -> Drawing {
    const auto& scene = static_cast<const sim::PusherPlant&>(world);
    const sim::PusherRendererOptions size{.width = 480, .height = 360};
    const auto renderer = std::make_shared<sim::PusherRenderer>(scene, size);
    return {size.width, size.height,
            [renderer, &scene](std::span<std::uint8_t> rgb) { renderer->Draw(scene, rgb); }};
  };
  return task;
}

Task Planar(const std::string& name) {
  const planar::Task planar = planar::MakeTask(name.substr(std::string_view("planar-").size()));
  Task task{.name = name,
            .variants = {{"", [planar] { return planar.plant->Clone(); }}},
            .length = planar.name == "corridor" ? 1.0 : 0.1,
            .plane = planar};
  task.learn = [planar](int demonstrations, std::uint64_t seed) {
    std::vector<core::Trajectory> set =
        planar::Demonstrate(planar, demonstrations, core::DeriveSeed(seed, {kDemonstrationStream}));
    FittedTask fit =
        safety::TaskModel(planar.plant->layout(), set, planar::TaskOptionsOf(planar, {}));
    return Learn(planar.name, *planar.plant, std::move(set), std::move(fit),
                 core::DeriveSeed(seed, {kLearnerStream}), planar::SupervisorOf(planar));
  };
  task.draw = [planar](const core::SimulatedPlant& world) -> Drawing {
    const planar::PlanePicture picture(planar);
    return {picture.width(), picture.height(), [picture, &world](std::span<std::uint8_t> rgb) {
              std::vector<double> x(static_cast<std::size_t>(world.state_dim()));
              world.Observe(x);
              picture.Draw(x, rgb);
            }};
  };
  return task;
}

Task Gallery(const std::string& name) {
  const sim::GalleryTask& small = sim::FindGalleryTask(name);
  Task task{
      .name = name, .variants = {{"", [&small] { return small.plant->Clone(); }}}, .small = &small};
  task.learn = [&small](int demonstrations, std::uint64_t seed) {
    std::vector<core::Trajectory> set =
        sim::Demonstrate(small, demonstrations, core::DeriveSeed(seed, {kDemonstrationStream}));
    FittedTask fit = FittedTask::Fit(small.plant->layout(), set, small.features);
    return Learn(small.name, *small.plant, std::move(set), std::move(fit),
                 core::DeriveSeed(seed, {kLearnerStream}), SupervisorOf(small));
  };
  if (small.settle_steps > 0) {
    task.settle = [&small](core::SimulatedPlant& world) {
      const std::vector<double> zero(static_cast<std::size_t>(world.control_dim()));
      for (int i = 0; i < small.settle_steps && !world.collided(); ++i) {
        if (world.Apply(zero) != core::PlantStatus::kOk) return;
      }
    };
  }
  return task;
}

Task LineTracking() {
  sim::LineTrackingOptions options;
  options.disturbance.wave = sim::Wave::kRandom;
  options.observation = sim::Observation::kGroundTruth;
  // A perfect calibration, which removes all systematic errors.
  line_task::LineCalibration known;
  known.camera = sim::LineTrackingPlant::true_camera();
  known.p_base_cam =
      sim::LineTrackingPlant::p_world_base().inverse() * sim::LineTrackingPlant::p_world_cam();
  known.arm = sim::ArmError(options.arm).systematic();
  const auto plant = [options, known](const std::string& world) {
    return [options = apps::line_tracking::InWorld(options, world), known] {
      return std::make_unique<sim::LineTrackingPlant>(options, &known);
    };
  };
  Task task{.name = "line-tracking",
            .variants = {{"", plant("30ms")},
                         {"latency 0 ms", plant("0ms")},
                         {"latency 100 ms", plant("100ms")},
                         {"the world stops", plant("frozen")}},
            .length = 10.0,  // mm
            .controllers = apps::line_tracking::Controllers()};
  task.learn = [options, known](int demonstrations, std::uint64_t seed) -> LearnedModel {
    apps::line_tracking::LineModelOptions model;
    model.seed = core::DeriveSeed(seed, {kLearnerStream});
    constexpr int kSteps = 50;
    return apps::line_tracking::LineModel::Fit(
        apps::line_tracking::Demonstrate(options, known, demonstrations, kSteps,
                                         core::DeriveSeed(seed, {kDemonstrationStream})),
        model);
  };
  task.settle = [](core::SimulatedPlant& world) {
    auto& line = static_cast<sim::LineTrackingPlant&>(world);
    if (line.options().disturbance.real_time) line.Hold(apps::line_tracking::kSettleTimeS);
  };
  task.draw = [](const core::SimulatedPlant& world) -> Drawing {
    const auto& line = static_cast<const sim::LineTrackingPlant&>(world);
    return {
        apps::line_tracking::kPictureWidth, apps::line_tracking::kPictureHeight,
        [&line](std::span<std::uint8_t> rgb) { apps::line_tracking::DrawBothViews(line, rgb); }};
  };
  return task;
}

}  // namespace

std::vector<std::string> TaskNames() {
  std::vector<std::string> names = {"pusher", "planar-corridor", "planar-push"};
  for (const sim::GalleryTask& task : sim::GalleryTasks()) names.push_back(task.name);
  names.emplace_back("line-tracking");
  return names;
}

Task MakeTask(const std::string& name) {
  if (name == "pusher") return Pusher();
  if (name.starts_with("planar-")) return Planar(name);
  if (name == "line-tracking") return LineTracking();
  const std::vector<std::string> names = TaskNames();
  if (std::ranges::count(names, name) == 0) throw core::UnknownName("task", name, Join(names));
  return Gallery(name);
}

std::vector<std::string> SelectTasks(const std::vector<std::string>& words) {
  std::vector<std::string> tasks;
  const auto add = [&](const std::string& name) {
    if (std::ranges::count(tasks, name) == 0) tasks.push_back(name);
  };
  for (const std::string& word : words) {
    if (word == "all") {
      for (const std::string& name : TaskNames()) add(name);
    } else if (word == "gallery" || word == "design" || word == "held-out") {
      for (const sim::GalleryTask& task : sim::GalleryTasks()) {
        if (word == "gallery" || task.held_out == (word == "held-out")) add(task.name);
      }
    } else {
      add(MakeTask(word).name);
    }
  }
  return tasks;
}

const std::vector<Condition>& Conditions() {
  constexpr double kDegree = std::numbers::pi / 180.0;
  static const std::vector<Condition> conditions = {
      {.name = "as demonstrated"},
      {.name = "turned 20 deg", .disturbance = {.rotation_sd = 20.0 * kDegree}},
      {.name = "turned 40 deg", .disturbance = {.rotation_sd = 40.0 * kDegree}},
      {.name = "scaled 0.4", .disturbance = {.scale_sd = 0.4}},
      {.name = "biased 0.1", .disturbance = {.bias = 0.1}},
      {.name = "biased 0.2", .disturbance = {.bias = 0.2}},
      {.name = "control noise 0.2", .disturbance = {.actuator_noise = 0.2}},
      {.name = "1 control late", .disturbance = {.control_delay = 1}},
      {.name = "2 controls late", .disturbance = {.control_delay = 2}},
      {.name = "3 controls late", .disturbance = {.control_delay = 3}},
      {.name = "20 % controls lost", .disturbance = {.dropped = 0.2}},
      {.name = "states noisy 0.5 %", .noise = 0.005},
      {.name = "states noisy 2 %", .noise = 0.02},
      {.name = "states 1 late", .disturbance = {.observation_delay = 1}},
      {.name = "states 2 late", .disturbance = {.observation_delay = 2}},
      {.name = "20 % states lost", .disturbance = {.missing = 0.2}},
      {.name = "wider starts", .variant = "wider starts"},
      {.name = "gripper: wide bar", .variant = "gripper: wide bar"},
      {.name = "gripper: fork", .variant = "gripper: fork"},
      {.name = "latency 0 ms", .variant = "latency 0 ms"},
      {.name = "latency 100 ms", .variant = "latency 100 ms"},
      {.name = "the world stops", .variant = "the world stops"},
      {.name = "turned 10 deg", .disturbance = {.rotation_sd = 10.0 * kDegree}, .on_request = true},
      {.name = "scaled 0.2", .disturbance = {.scale_sd = 0.2}, .on_request = true},
      {.name = "picture light 20 %", .nuisances = {.light = 0.2}, .on_request = true},
      {.name = "picture noise 3 %", .nuisances = {.noise = 0.03}, .on_request = true},
      {.name = "picture distractor", .nuisances = {.distractor = true}, .on_request = true},
      {.name = "picture disturbed",
       .nuisances = {.light = 0.2, .noise = 0.03, .distractor = true},
       .on_request = true},
      {.name = "picture shifted", .nuisances = {.shift = 1}, .on_request = true},
      {.name = "picture occluded", .nuisances = {.occlusion = true}, .on_request = true},
      {.name = "10 demonstrations", .demonstrations = 10, .on_request = true},
      {.name = "20 demonstrations", .demonstrations = 20, .on_request = true},
      {.name = "40 demonstrations", .demonstrations = 40, .on_request = true},
  };
  return conditions;
}

}  // namespace dfr::study
