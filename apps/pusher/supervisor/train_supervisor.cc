#include "supervisor/train_supervisor.h"

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/progress.h"
#include "dfr/imitation/trpo.h"
#include "dfr/sim/pusher/pusher_reward.h"

namespace dfr::apps::pusher {
namespace {

constexpr int kJudgeEvery = 10;  // iterations
constexpr int kJudgeEpisodes = 1000;

// Random streams that Trpo does not use.
enum Stream : std::uint64_t { kJudge = 1'000'001, kFinal = 1'000'002 };

// Trpo's environment: the Pusher at the training gate.
class PusherEnvironment final : public imitation::Environment {
 public:
  explicit PusherEnvironment(const sim::PusherOptions& options)
      : plant_(options), reward_(plant_) {}

  [[nodiscard]] const core::Plant& plant() const noexcept override { return plant_; }

  void Reset(std::uint64_t seed) override {
    plant_.Reset(seed);
    reward_.Reset();
  }

  StepResult Step(std::span<const double> control) override {
    if (plant_.Apply(control) != core::PlantStatus::kOk) {
      throw std::runtime_error("the simulation of the Pusher failed");
    }
    const double reward = reward_.Step(control);
    return {reward, plant_.completed() || plant_.collided()};
  }

 private:
  sim::PusherPlant plant_;
  sim::PusherReward reward_;
};

struct Score {
  double completed = 0.0;
  double collided = 0.0;
  double mean_length = 0.0;  // over completed episodes
};

// Runs the mean action, or sampled actions, from kJudgeEpisodes start states.
Score Judge(const imitation::GaussianPolicy& policy, sim::PusherPlant& plant, int horizon,
            bool sample, std::uint64_t seed) {
  std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
  std::vector<double> u(static_cast<std::size_t>(plant.control_dim()));
  int completed = 0;
  int collided = 0;
  int controls = 0;
  for (std::uint64_t episode = 0; episode < kJudgeEpisodes; ++episode) {
    core::Random noise(core::DeriveSeed(seed, {episode, 1}));
    plant.Reset(core::DeriveSeed(seed, {episode, 0}));
    int t = 0;
    for (; t < horizon && !plant.completed() && !plant.collided(); ++t) {
      plant.Observe(x);
      if (sample) {
        policy.Sample(x, noise, u);
      } else {
        policy.mean().Control(t, x, u);
      }
      if (plant.Apply(u) != core::PlantStatus::kOk) {
        throw std::runtime_error("the simulation of the Pusher failed");
      }
    }
    if (plant.completed()) {
      ++completed;
      controls += t;
    }
    collided += plant.collided();
  }
  return {static_cast<double>(completed) / kJudgeEpisodes,
          static_cast<double>(collided) / kJudgeEpisodes,
          completed > 0 ? static_cast<double>(controls) / completed : 0.0};
}

std::string Share(double fraction) { return core::Format("%.1f %%", 100.0 * fraction); }

std::string Describe(const Score& score) {
  return Share(score.completed) + " completed, " + Share(score.collided) + " collided";
}

imitation::Trpo Start(imitation::Environment& environment, const TrainSupervisorOptions& options,
                      const std::filesystem::path& checkpoint) {
  const std::string scene =
      core::Format("training red_y %.17g, joint step %.17g, gripper %s", options.training_red_y,
                   options.scene.joint_step, std::string(sim::Name(options.scene.gripper)).c_str());
  if (options.resume) {
    imitation::Trpo resumed = imitation::Trpo::Resume(environment, checkpoint);
    DFR_THROW_UNLESS(resumed.options().environment == scene,
                     checkpoint.string() << ": was trained with " << resumed.options().environment
                                         << ", not with " << scene << "; omit --resume");
    const auto check = [&](const char* what, const auto& given, const auto& trained) {
      DFR_THROW_UNLESS(!given || *given == trained, checkpoint.string()
                                                        << ": was trained with " << what << ' '
                                                        << trained << ", not with " << *given
                                                        << "; omit " << what << " or --resume");
    };
    check("--seed", options.seed, resumed.options().seed);
    check("--horizon", options.horizon, resumed.options().horizon);
    return resumed;
  }
  imitation::TrpoOptions trpo;
  trpo.environment = scene;
  trpo.seed = options.seed.value_or(1);
  trpo.horizon = options.horizon.value_or(trpo.horizon);
  return imitation::Trpo(environment, trpo);
}

}  // namespace

int TrainSupervisor(const TrainSupervisorOptions& options) {
  DFR_THROW_UNLESS(options.min_steps <= options.max_steps,
                   "train-supervisor: --min-steps " << options.min_steps << " exceeds --max-steps "
                                                    << options.max_steps);
  std::filesystem::path checkpoint = options.checkpoint;
  if (checkpoint.empty()) checkpoint = options.out.string() + ".checkpoint";
  sim::PusherOptions training_scene = options.scene;
  training_scene.red_y = options.training_red_y;
  PusherEnvironment environment(training_scene);
  sim::PusherPlant plant(options.scene);
  imitation::Trpo trpo = Start(environment, options, checkpoint);
  const int horizon = trpo.options().horizon;
  const std::uint64_t seed = trpo.options().seed;

  const auto start = std::chrono::steady_clock::now();
  const std::int64_t steps_before = trpo.steps();
  experiment::ProgressBar bar("train-supervisor");
  bool good = false;
  while (!good && trpo.steps() < options.max_steps) {
    const imitation::TrpoProgress progress = trpo.Iterate();
    std::string label =
        "with noise, at the tight gate: " + Describe({progress.completed, progress.collided});
    if (progress.iteration % kJudgeEvery == 0) {
      trpo.Save(checkpoint);
      if (trpo.steps() >= options.min_steps) {
        const imitation::GaussianPolicy policy = trpo.policy();
        const std::uint64_t stream = core::DeriveSeed(seed, {kJudge});
        const Score mean = Judge(policy, plant, horizon, false, stream);
        good = mean.completed >= 0.995 && mean.collided <= 0.002 &&
               Judge(policy, plant, horizon, true, stream).completed >= 0.95;
        label = "judged: " + Describe(mean);
      }
    }
    const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
    const std::int64_t total = good                               ? trpo.steps()
                               : trpo.steps() < options.min_steps ? options.min_steps
                                                                  : options.max_steps;
    bar.Show({.done = trpo.steps(),
              .total = total,
              .elapsed_s = elapsed.count(),
              .remaining_s = elapsed.count() * static_cast<double>(total - trpo.steps()) /
                             static_cast<double>(trpo.steps() - steps_before),
              .label = label});
  }

  trpo.Save(checkpoint);
  const imitation::GaussianPolicy policy = trpo.policy();
  policy.Save(options.out);
  const std::uint64_t stream = core::DeriveSeed(seed, {kFinal});
  const Score mean = Judge(policy, plant, horizon, false, stream);
  const Score sampled = Judge(policy, plant, horizon, true, stream);
  std::cout << options.out.string() << ": " << trpo.steps() << " controls, seed " << seed << "\n"
            << "over " << kJudgeEpisodes << " fresh start states, mean action: " << Describe(mean)
            << ", " << mean.mean_length << " controls\n"
            << "sampling, standard deviation " << policy.log_std().array().exp().mean()
            << " of the control's range: " << Describe(sampled) << ", " << sampled.mean_length
            << " controls\n";
  if (good) return EXIT_SUCCESS;
  std::cerr << "the supervisor is not good enough after " << trpo.steps()
            << " controls: try another --seed, or resume "
            << "with --resume and a larger --max-steps\n";
  return EXIT_FAILURE;
}

void AddGripper(CLI::App& command, sim::Gripper& gripper) {
  command.add_option("--gripper", gripper, "shape of the gripper")
      ->transform(apps::OneOf<sim::Gripper>({{"bar", sim::Gripper::kBar},
                                             {"wide-bar", sim::Gripper::kWideBar},
                                             {"fork", sim::Gripper::kFork}}))
      ->default_str("bar");
}

void AddTrainSupervisor(CLI::App& app, TrainSupervisorOptions& options) {
  CLI::App* command = app.add_subcommand(
      "train-supervisor", "Train a supervisor by TRPO from scratch, in less than a minute");
  core::WritesFile(command->add_option("--out", options.out, "file of the policy"))
      ->capture_default_str();
  core::WritesFile(
      command->add_option("--checkpoint", options.checkpoint,
                          "file to resume from (default: the policy's name and .checkpoint)"));
  command->add_flag("--resume", options.resume, "resume from the checkpoint");
  command->add_option("--seed", options.seed, "random seed of start states, noise and weights")
      ->default_str("1");
  command->add_option("--red-y", options.scene.red_y, "red_y of the gate for the evaluation [m]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      ->add_option("--training-red-y", options.training_red_y,
                   "red_y of the gate for the training [m]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      ->add_option("--joint-step", options.scene.joint_step,
                   "largest change of a joint angle [rad]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--horizon", options.horizon, "T: largest number of controls in an episode")
      ->check(kCount)
      ->default_str("60");
  AddGripper(*command, options.scene.gripper);
  command
      ->add_option("--min-steps", options.min_steps,
                   "number of controls before the first evaluation")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--max-steps", options.max_steps, "largest number of controls")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->callback([&options] {
    const int code = TrainSupervisor(options);
    if (code != EXIT_SUCCESS) throw CLI::RuntimeError(code);
  });
}

}  // namespace dfr::apps::pusher
