// The Pusher experiment of Sec. V-A: train a supervisor, demonstrate, fit, evaluate, compare, look.
#include <CLI/CLI.hpp>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <iostream>
#include <map>
#include <string>
#include <utility>

#include "apps/command_line.h"
#include "commands.h"
#include "dfr/core/build_info.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/ledger.h"
#include "dfr/safety/method.h"
#include "supervisor.h"
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
  command
      .add_option("--physics", plant.physics,
                  "quasi-static: the arm is moved along its path; dynamic: motors move an arm with "
                  "inertia and friction, slower to simulate")
      ->transform(CLI::CheckedTransformer(std::map<std::string, sim::PusherPhysics>{
          {"quasi-static", sim::PusherPhysics::kQuasiStatic},
          {"dynamic", sim::PusherPhysics::kDynamic}}))
      ->type_name("")
      ->option_text("TEXT=quasi-static");
}

void AddModelOptions(CLI::App& command, ModelOptions& model) {
  command.add_option("--nu", model.nu, "bound on the outliers of each support, in (0, 1]")
      ->capture_default_str();
  command.add_option("--gamma", model.gamma, "width of the Gaussian kernel [1/m^2]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      .add_option("--features", model.support_features,
                  "what the support looks at: blocks of the state, as in red,object,tip[0:2]")
      ->capture_default_str();
  command.add_option("--horizon", model.horizon, "T: controls of the learned policy per episode")
      ->check(kCount)
      ->capture_default_str();
  command
      .add_option("--guided-gamma", model.guided_gamma,
                  "the same of guided recovery's support, whose features are whitened")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command.add_option("--epochs", model.epochs, "passes of Adam over the demonstrations")
      ->check(kCount)
      ->capture_default_str();
}

void AddExperiment(CLI::App& app, ExperimentOptions& options, std::function<void()> run) {
  CLI::App* command = app.add_subcommand(
      "experiment", "the paper's comparison: all methods over the number of demonstrations");
  experiment::AddExperimentOptions(
      *command, options,
      "quick: 2 trials, demonstrations 20, 60, 120; paper: 10 trials of 5 supervisors, 6, 12, ..., "
      "120; authors: as "
      "quick, with the constants of the authors' scripts where those are others, Adam's rate .01, "
      "T = 100, gamma 1, nu .1",
      "the first is the reference; of " + study::MethodHelp(), {"quick", "paper", "authors"});
  command
      ->add_option("--supervisor", options.supervisor,
                   "file of train-supervisor (default: those that are shipped)")
      ->type_name("FILE");
  command
      ->add_option("--supervisors", options.supervisors,
                   "how many of those that are shipped take turns, trial by trial (default: paper "
                   "5, else 1); from 5 on intervals are clustered by supervisor")
      ->check(CLI::Range(1, kShippedSupervisors))
      ->excludes("--supervisor");
  command->add_flag("!--no-convergence", options.convergence,
                    "leave out how fast recoveries climb, which takes seconds");
  command
      ->add_option("--learners", options.learners,
                   "hidden units of the learned policies, with x the epochs, as in 8,64-64,8x100")
      ->delimiter(',');
  command->add_option("--demonstrations", options.demonstrations, "the data points, ascending")
      ->delimiter(',');
  AddModelOptions(*command, options.model);
  AddScene(*command, options.plant);
  command->add_option("--learning-rate", options.model.learner.learning_rate, "of Adam")
      ->capture_default_str();
  command->callback([&options, command, run = std::move(run)] {
    if (options.preset == "authors") {
      // What the user has chosen stays.
      const auto take = [command](const char* option, auto& value, auto authors) {
        if (command->count(option) > 0) return;
        value = authors;
        command->get_option(option)->default_str(experiment::Exactly(authors));  // for run.toml
      };
      take("--learning-rate", options.model.learner.learning_rate, 0.01);
      take("--horizon", options.model.horizon, 100);
      take("--gamma", options.model.gamma, 1.0);
      take("--nu", options.model.nu, 0.1);
    }
    run();
  });
}

void AddDemonstrate(CLI::App& app, DemonstrateOptions& options) {
  CLI::App* command =
      app.add_subcommand("demonstrate", "write demonstrations of the supervisor as robomimic HDF5");
  command->add_option("--out", options.out, "the file")->capture_default_str();
  command->add_option("--count", options.count, "demonstrations, those discarded not counted")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--supervisor", options.supervisor,
                      "file of train-supervisor (default: the shipped one)");
  command->add_option("--horizon", options.horizon, "T: most controls of a demonstration")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--seed", options.seed, "of start states and noise")->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunDemonstrate(options); });
}

void AddFit(CLI::App& app, FitOptions& options) {
  CLI::App* command =
      app.add_subcommand("fit", "learn policy, support and lambda from demonstrations");
  command->add_option("--demonstrations", options.demonstrations, "robomimic HDF5 file")
      ->capture_default_str();
  command->add_option("--use", options.use, "only the first so many demonstrations; 0: all")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  command->add_option("--out", options.out, "folder of the model's files")->capture_default_str();
  command->add_option("--learner", options.learner, "hidden units of the policy, as in 8 or 64-64")
      ->capture_default_str();
  command->add_option("--seed", options.model.seed, "of the network's initial weights and batches")
      ->capture_default_str();
  AddModelOptions(*command, options.model);
  command->callback([&options] { RunFit(options); });
}

void AddEvaluate(CLI::App& app, EvaluateOptions& options) {
  CLI::App* command =
      app.add_subcommand("evaluate", "run a model from fresh start states, by each method");
  command->add_option("--model", options.model, "folder of fit")->capture_default_str();
  command->add_option("--methods", options.methods, "those of experiment")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--episodes", options.episodes, "start states")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--seed", options.seed, "of start states and recoveries")
      ->capture_default_str();
  command->add_option("--threads", options.threads, "0: one per core")->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunEvaluate(options); });
}

void AddGuarded(CLI::App& app, GuardedOptions& options) {
  CLI::App* command = app.add_subcommand(
      "guarded", "a linear policy of your own inside a guard's file: an episode a line");
  command->add_option("--guard", options.guard, "file of the program guard, from demonstrations")
      ->capture_default_str();
  command
      ->add_option("--policy", options.policy,
                   "text: for each of the 7 controls an offset, and a gain per state entry")
      ->capture_default_str();
  command->add_option("--episodes", options.episodes, "start states")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--seed", options.seed, "of the first, counting up")->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunGuarded(options); });
}

void AddDrift(CLI::App& app, DriftOptions& options) {
  CLI::App* command = app.add_subcommand(
      "drift",
      "how methods degrade: noise, turned and scaled controls, other grippers, little data");
  command->add_option("--learner", options.learner, "hidden units of the policy, as in 8 or 64-64")
      ->capture_default_str();
  command->add_option("--methods", options.methods, "those of experiment")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--demonstrations", options.demonstrations, "in each trial")
      ->check(CLI::Range(2, 10'000))
      ->capture_default_str();
  command->add_option("--trials", options.trials, "independent repetitions of everything")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--episodes", options.episodes, "start states per trial")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      ->add_option("--supervisor", options.supervisor,
                   "file of train-supervisor (default: the shipped one)")
      ->type_name("FILE");
  experiment::AddRunOptions(*command, options);
  command->callback([&options] { RunDrift(options); });
}

void AddRender(CLI::App& app, RenderOptions& options) {
  CLI::App* command =
      app.add_subcommand("render", "a video of rollouts from one start state, without a display");
  command->add_option("--model", options.model, "folder of fit")->capture_default_str();
  command->add_option("--methods", options.methods, "side by side, as in baseline,dfr")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option(
      "--episode", options.episode,
      "instead of a model: an episode of an experiment by its id, as episodes prints "
      "it; --methods are shown beside it");
  command->add_option("--run", options.run, "folder of that experiment")->capture_default_str();
  command->add_option("--seed", options.seed, "of the start state")->capture_default_str();
  command
      ->add_option("--out", options.out, "a video (.mp4, .webm) or the last picture (.png, .jpg)")
      ->capture_default_str();
  command->add_option("--width", options.width, "of each picture")
      ->check(CLI::Range(160, 1920))
      ->capture_default_str();
  command->add_option("--height", options.height, "of each picture")
      ->check(CLI::Range(120, 1080))
      ->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options, command] {
    if (options.episode.empty()) return RunRender(options);
    if (command->count("--methods") == 0) options.methods.clear();
    // The experiment as its run.toml has it.
    CLI::App again("", "pusher");
    ExperimentOptions run;
    AddExperiment(again, run, [&] { RenderEpisode(run, options); });
    const std::filesystem::path file = options.run / "run.toml";
    const std::array<const char*, 6> arguments = {"pusher",     "experiment", "--config",
                                                  file.c_str(), "--out",      options.run.c_str()};
    if (const auto code = experiment::Parse(again, 6, arguments.data())) {
      throw CLI::RuntimeError(*code);
    }
  });
}

void AddView(CLI::App& app, ViewOptions& options) {
  CLI::App* command = app.add_subcommand("view", "watch rollouts in a window; needs a display");
  command->add_option("--model", options.model, "folder of fit")->capture_default_str();
  command->add_option("--method", options.method, "who is in control")->capture_default_str();
  command->add_option("--seed", options.seed, "of the first start state")->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunView(options); });
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

  ExperimentOptions compared;
  TrainSupervisorOptions train;
  DemonstrateOptions demonstrate;
  FitOptions fit;
  EvaluateOptions evaluate;
  GuardedOptions guarded;
  DriftOptions drift;
  RenderOptions render;
  ViewOptions view;
  AddExperiment(app, compared, [&compared] { RunExperiment(compared); });
  AddTrainSupervisor(app, train);
  AddDemonstrate(app, demonstrate);
  AddFit(app, fit);
  AddEvaluate(app, evaluate);
  AddGuarded(app, guarded);
  AddDrift(app, drift);
  AddRender(app, render);
  AddView(app, view);

  dfr::apps::CheckNumbers(app);
  return experiment::Parse(app, argc, argv).value_or(EXIT_SUCCESS);
}

}  // namespace
}  // namespace dfr::apps::pusher

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  return dfr::apps::pusher::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "pusher: " << e.what() << '\n';
  return EXIT_FAILURE;
}
