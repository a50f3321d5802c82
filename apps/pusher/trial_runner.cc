#include "trial_runner.h"

#include <algorithm>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/random.h"
#include "dfr/sim/pusher/pusher_view.h"

namespace dfr::apps::pusher {
namespace {

// Streams of the experiment's seed; 0 and 1 are for start states and controllers.
constexpr std::uint64_t kDemonstrationStream = 2;
constexpr std::uint64_t kLearnerStream = 3;
constexpr std::uint64_t kOverlapStream = 4;

constexpr int kOverlapSamples = 4000;

constexpr int kFilmWidth = 480;
constexpr int kFilmHeight = 360;

}  // namespace

double SupportOverlap(const Model& model, const imitation::DemonstrationSet& set,
                      sim::PusherPlant& plant, int samples, std::uint64_t seed) {
  constexpr double kObjectReach = 0.15;  // m
  constexpr double kJointReach = 0.1;    // rad
  const auto& blocks = plant.layout().blocks;
  const auto offset_of = [&](std::string_view name) {
    for (const auto& block : blocks) {
      if (block.name == name) return static_cast<std::size_t>(block.offset);
    }
    throw std::logic_error("the plant's state has no block " + std::string(name));
  };
  const std::size_t qpos = offset_of("qpos");
  const std::size_t object = offset_of("object");
  core::Random random(seed);
  std::vector<double> state(static_cast<std::size_t>(plant.state_dim()));
  int inside = 0;
  int red = 0;
  for (int i = 0; i < samples; ++i) {
    const core::Trajectory& trajectory =
        set.trajectories[random.Below(model.demonstrations().trajectories.size())];
    const auto t =
        static_cast<int>(random.Below(static_cast<std::uint64_t>(trajectory.states.rows())));
    const std::span<const double> demonstrated = core::Row(trajectory.states, t);
    state.assign(demonstrated.begin(), demonstrated.end());
    for (std::size_t k = 0; k < 2; ++k) {
      state[object + k] += random.Uniform(-kObjectReach, kObjectReach);
    }
    for (std::size_t k = 0; k < sim::PusherPlant::kNumJoints; ++k) {
      state[qpos + k] += random.Uniform(-kJointReach, kJointReach);
    }
    try {
      plant.SetState(state);
    } catch (const std::invalid_argument&) {
      continue;  // beyond a joint's limit: invalid state of this plant
    }
    plant.Observe(state);
    if (model.task().support().Decision(t, state) < 0.0) continue;
    ++inside;
    if (plant.collided()) ++red;
  }
  return inside > 0 ? static_cast<double>(red) / inside : std::numeric_limits<double>::quiet_NaN();
}

PusherTrialRunner::PusherTrialRunner(Model model, const std::vector<safety::Method>& methods,
                                     const sim::PusherOptions& plant_options,
                                     std::map<std::string, double> measures)
    : PlaceboRunner(std::make_unique<sim::PusherPlant>(plant_options)),
      model_(std::move(model)),
      methods_(methods),
      measures_(std::move(measures)) {
  std::vector<std::string> names;
  names.reserve(methods.size());
  for (const safety::Method& method : methods) names.push_back(method.name);
  AddAll(
      names,
      [this](const std::string& name) {
        return model_.MakeController(study::ParseMethod(name), &driven());
      },
      model_.fit(), model_.demonstrations().trajectories);
}

bool PusherTrialRunner::Inside(std::span<const double> x) const {
  return model_.task().support().Decision(0, x) >= 0.0;
}

std::map<std::string, double> PusherTrialRunner::Measures() {
  std::map<std::string, double> measures = measures_;
  for (std::size_t i = 0; i < methods_.size(); ++i) {
    std::vector<int> lengths = recovery_lengths()[i];
    if (lengths.empty()) continue;
    measures["controls_per_recovery " + methods_[i].name] = core::Median(lengths);
  }
  return measures;
}

std::vector<RolloutVideo> RecordRollouts(PusherTrialRunner& runner,
                                         const std::vector<std::string>& methods,
                                         std::uint64_t start_seed, std::uint64_t controller_seed,
                                         int width, int height) {
  sim::PusherRenderer renderer(runner.plant(), {.width = width, .height = height});
  std::vector<RolloutVideo> videos;
  for (const std::string& method : methods) {
    const auto found = std::ranges::find(runner.methods(), method, &safety::Method::name);
    RolloutVideoRecorder recorder(
        method, width, height,
        [&](std::span<std::uint8_t> rgb) { renderer.Draw(runner.plant(), rgb); },
        runner.model().task().support());
    runner.RunObserved(static_cast<int>(found - runner.methods().begin()), start_seed,
                       controller_seed, &recorder);
    videos.push_back(recorder.Take());
  }
  return videos;
}

bool PusherTrialRunner::Film(const std::vector<int>& methods, std::uint64_t start_seed,
                             std::uint64_t controller_seed, const std::filesystem::path& path) {
  std::vector<std::string> names;
  names.reserve(methods.size());
  for (const int method : methods) {
    names.push_back(methods_.at(static_cast<std::size_t>(method)).name);
  }
  WriteVideo(path,
             RecordRollouts(*this, names, start_seed, controller_seed, kFilmWidth, kFilmHeight));
  return true;
}

void CheckFilm(const std::filesystem::path& path, const sim::PusherOptions& plant_options) {
  sim::PusherPlant plant(plant_options);
  plant.Reset(0);
  sim::PusherRenderer renderer(plant, {.width = kFilmWidth, .height = kFilmHeight});
  CheckVideo(path, kFilmWidth, kFilmHeight,
             [&](std::span<std::uint8_t> rgb) { renderer.Draw(plant, rgb); });
}

TrialRunnerFactory::TrialRunnerFactory(const std::vector<imitation::GaussianPolicy>& supervisors,
                                       TrialRunnerOptions options, int trials)
    : supervisors_(supervisors), options_(std::move(options)) {
  DFR_THROW_UNLESS(!supervisors.empty(), "give at least one supervisor");
  for (int i = 0; i < trials; ++i) trials_.push_back(std::make_unique<Trial>());
}

std::unique_ptr<PusherTrialRunner> TrialRunnerFactory::Make(
    const experiment::EvaluationUnit& unit) {
  Trial& trial = *trials_.at(static_cast<std::size_t>(unit.trial));
  const auto trial_number = static_cast<std::uint64_t>(unit.trial);
  const imitation::GaussianPolicy& supervisor = supervisors_[trial_number % supervisors_.size()];
  const auto demonstrations = static_cast<std::uint64_t>(unit.demonstrations);
  std::call_once(trial.collected, [&] {
    sim::PusherPlant plant(options_.plant);
    trial.set = Demonstrate(plant, supervisor, options_.most_demonstrations, options_.model.horizon,
                            core::DeriveSeed(options_.seed, {kDemonstrationStream, trial_number}),
                            &trial.counts);
  });
  ModelOptions model_options = options_.model;
  Learner learner = Learner::Parse(unit.learner);
  learner.learning_rate = model_options.learner.learning_rate;
  model_options.learner = std::move(learner);
  model_options.seed =
      core::DeriveSeed(options_.seed, {kLearnerStream, trial_number, demonstrations});
  Model model =
      Model::Fit(trial.set, unit.demonstrations, model_options, &supervisor, options_.plant);

  sim::PusherPlant plant(options_.plant);
  double steps = 0.0;
  for (int i = 0; i < unit.demonstrations; ++i) {
    steps += trial.set.trajectories[static_cast<std::size_t>(i)].num_steps();
  }
  std::map<std::string, double> measures;
  measures["overlap"] = SupportOverlap(
      model, trial.set, plant, kOverlapSamples,
      core::DeriveSeed(options_.seed, {kOverlapStream, trial_number, demonstrations}));
  measures["demonstration_steps"] = steps / unit.demonstrations;
  measures["discarded_demonstrations"] = trial.counts.collided + trial.counts.incomplete;
  return std::make_unique<PusherTrialRunner>(std::move(model), options_.methods, options_.plant,
                                             std::move(measures));
}

}  // namespace dfr::apps::pusher
