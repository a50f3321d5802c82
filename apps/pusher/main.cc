// The Pusher experiment of Sec. V-A: train a supervisor, demonstrate, fit, evaluate, compare, look.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <map>
#include <stdexcept>
#include <string>

#include "apps/experiment_command.h"
#include "commands.h"
#include "dfr/core/build_info.h"
#include "dfr/safety/method.h"
#include "train_supervisor.h"

namespace dfr::apps::pusher {
namespace {

void AddScene(CLI::App& command, sim::PusherOptions& plant) {
  command.add_option("--red-y", plant.red_y, "the red regions are at y = +- this [m]")
      ->capture_default_str();
  command.add_option("--start-y", plant.start_y, "the cylinder starts within y = +- this [m]")
      ->capture_default_str();
  command.add_option("--gripper", plant.gripper, "bar, wide-bar or fork")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, sim::Gripper>{{"bar", sim::Gripper::kBar},
                                              {"wide-bar", sim::Gripper::kWideBar},
                                              {"fork", sim::Gripper::kFork}}))
      ->type_name("")
      ->option_text("TEXT=bar");
}

void AddModelOptions(CLI::App& command, ModelOptions& model) {
  command.add_option("--nu", model.nu, "bound on the outliers of each support, in (0, 1]")
      ->capture_default_str();
  command.add_option("--gamma", model.gamma, "width of the Gaussian kernel [1/m^2]")
      ->capture_default_str();
  command
      .add_option("--features", model.support_features,
                  "what the support looks at: blocks of the state, as in red,object,tip[0:2]")
      ->capture_default_str();
  command.add_option("--horizon", model.horizon, "T: controls of the learned policy per episode")
      ->capture_default_str();
  command
      .add_option("--guided-gamma", model.guided_gamma,
                  "the same of guided recovery's support, whose features are whitened")
      ->capture_default_str();
  command.add_option("--epochs", model.epochs, "passes of Adam over the demonstrations")
      ->capture_default_str();
}

int Main(int argc, char** argv) {
  CLI::App app(
      "The Pusher experiment: a 7-joint arm pushes a cylinder over a goal, past two red regions\n"
      "that neither arm nor cylinder may touch. Controls are changes of the joint angles in units\n"
      "of 0.06 rad, within [-1, 1]; lengths are metres. Without arguments of their own, the\n"
      "commands follow one another: demonstrate, fit, evaluate, render.",
      "pusher");
  app.set_version_flag("--version",
                       std::string(core::BuildVersion()) + " (" + core::BuildCommit() + ")");
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);

  ExperimentOptions experiment;
  CLI::App* command = app.add_subcommand(
      "experiment", "the paper's comparison: all methods over the number of demonstrations");
  AddExperimentOptions(
      *command, experiment,
      "quick: 2 trials, demonstrations 20, 60, 120; paper: 10 trials, 6, 12, ..., 120; authors: as "
      "quick, with the constants of the authors' scripts where those are others, Adam's rate .01, "
      "T = 100, gamma 1, nu .1",
      "the first is the reference; of " + MethodHelp(), {"quick", "paper", "authors"});
  command->add_option("--supervisor", experiment.supervisor,
                      "file of train-supervisor (default: the shipped one)");
  command->add_flag("!--no-convergence", experiment.convergence,
                    "leave out how fast recoveries climb, which takes seconds");
  command
      ->add_option("--learners", experiment.learners,
                   "hidden units of the learned policies, with x the epochs, as in 8,64-64,8x100")
      ->delimiter(',');
  command->add_option("--demonstrations", experiment.demonstrations, "the data points, ascending")
      ->delimiter(',');
  AddModelOptions(*command, experiment.model);
  AddScene(*command, experiment.plant);
  command->add_option("--learning-rate", experiment.model.learner.learning_rate, "of Adam")
      ->capture_default_str();
  command->callback([&, command] {
    if (experiment.preset == "authors") {
      // What the user has chosen stays.
      const auto take = [&](const char* option, auto& value, auto authors) {
        if (command->count(option) == 0) value = authors;
      };
      take("--learning-rate", experiment.model.learner.learning_rate, 0.01);
      take("--horizon", experiment.model.horizon, 100);
      take("--gamma", experiment.model.gamma, 1.0);
      take("--nu", experiment.model.nu, 0.1);
    }
    RunExperiment(experiment);
  });

  TrainSupervisorOptions train;
  AddTrainSupervisor(app, train);

  DemonstrateOptions demonstrate;
  command =
      app.add_subcommand("demonstrate", "write demonstrations of the supervisor as robomimic HDF5");
  command->add_option("--out", demonstrate.out, "the file")->capture_default_str();
  command->add_option("--count", demonstrate.count, "demonstrations, those discarded not counted")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--supervisor", demonstrate.supervisor,
                      "file of train-supervisor (default: the shipped one)");
  command->add_option("--horizon", demonstrate.horizon, "T: most controls of a demonstration")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--seed", demonstrate.seed, "of start states and noise")
      ->capture_default_str();
  AddScene(*command, demonstrate.plant);
  command->callback([&] { RunDemonstrate(demonstrate); });

  FitOptions fit;
  command = app.add_subcommand("fit", "learn policy, support and lambda from demonstrations");
  command->add_option("--demonstrations", fit.demonstrations, "robomimic HDF5 file")
      ->capture_default_str();
  command->add_option("--use", fit.use, "only the first so many demonstrations; 0: all")
      ->capture_default_str();
  command->add_option("--out", fit.out, "folder of the model's files")->capture_default_str();
  command->add_option("--learner", fit.learner, "hidden units of the policy, as in 8 or 64-64")
      ->capture_default_str();
  command->add_option("--seed", fit.model.seed, "of the network's initial weights and batches")
      ->capture_default_str();
  AddModelOptions(*command, fit.model);
  command->callback([&] { RunFit(fit); });

  EvaluateOptions evaluate;
  command = app.add_subcommand("evaluate", "run a model from fresh start states, by each method");
  command->add_option("--model", evaluate.model, "folder of fit")->capture_default_str();
  command->add_option("--methods", evaluate.methods, "those of experiment")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--episodes", evaluate.episodes, "start states")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--seed", evaluate.seed, "of start states and recoveries")
      ->capture_default_str();
  command->add_option("--threads", evaluate.threads, "0: one per core")->capture_default_str();
  AddScene(*command, evaluate.plant);
  command->callback([&] { RunEvaluate(evaluate); });

  GuardedOptions guarded;
  command = app.add_subcommand(
      "guarded", "a linear policy of your own inside a guard's file: an episode a line");
  command->add_option("--guard", guarded.guard, "file of the program guard, from demonstrations")
      ->capture_default_str();
  command
      ->add_option("--policy", guarded.policy,
                   "text: for each of the 7 controls an offset, and a gain per state entry")
      ->capture_default_str();
  command->add_option("--episodes", guarded.episodes, "start states")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--seed", guarded.seed, "of the first, counting up")->capture_default_str();
  AddScene(*command, guarded.plant);
  command->callback([&] { RunGuarded(guarded); });

  DriftOptions drift;
  command = app.add_subcommand(
      "drift",
      "how methods degrade: noise, turned and scaled controls, other grippers, little data");
  command->add_option("--learner", drift.learner, "hidden units of the policy, as in 8 or 64-64")
      ->capture_default_str();
  command->add_option("--methods", drift.methods, "those of experiment")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--demonstrations", drift.demonstrations, "in each trial")
      ->check(CLI::Range(2, 10'000))
      ->capture_default_str();
  command->add_option("--trials", drift.trials, "independent repetitions of everything")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--episodes", drift.episodes, "start states per trial")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--supervisor", drift.supervisor,
                      "file of train-supervisor (default: the shipped one)");
  command->add_option("--seed", drift.seed, "of all that is random")->capture_default_str();
  command->add_option("--threads", drift.threads, "0: one per core")->capture_default_str();
  command->callback([&] { RunDrift(drift); });

  RenderOptions render;
  command =
      app.add_subcommand("render", "a video of rollouts from one start state, without a display");
  command->add_option("--model", render.model, "folder of fit")->capture_default_str();
  command->add_option("--methods", render.methods, "side by side, as in baseline,dfr")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--seed", render.seed, "of the start state")->capture_default_str();
  command->add_option("--out", render.out, "a video (.mp4, .webm) or the last picture (.png, .jpg)")
      ->capture_default_str();
  command->add_option("--width", render.width, "of each picture")
      ->check(CLI::Range(160, 1920))
      ->capture_default_str();
  command->add_option("--height", render.height, "of each picture")
      ->check(CLI::Range(120, 1080))
      ->capture_default_str();
  AddScene(*command, render.plant);
  command->callback([&] { RunRender(render); });

  ViewOptions view;
  command = app.add_subcommand("view", "watch rollouts in a window; needs a display");
  command->add_option("--model", view.model, "folder of fit")->capture_default_str();
  command->add_option("--method", view.method, "who is in control")->capture_default_str();
  command->add_option("--seed", view.seed, "of the first start state")->capture_default_str();
  AddScene(*command, view.plant);
  command->callback([&] { RunView(view); });

  const auto commands = app.get_subcommands([](const CLI::App*) { return true; });
  if (argc > 1 && argv[1][0] != '-' &&
      std::none_of(commands.begin(), commands.end(),
                   [&](const CLI::App* known) { return known->get_name() == argv[1]; })) {
    throw std::invalid_argument("there is no command '" + std::string(argv[1]) +
                                "'; pusher --help lists them");
  }
  CLI11_PARSE(app, argc, argv);
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace dfr::apps::pusher

int main(int argc, char** argv) try {
  return dfr::apps::pusher::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "pusher: " << e.what() << '\n';
  return EXIT_FAILURE;
}
