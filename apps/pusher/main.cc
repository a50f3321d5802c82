// Program pusher: the Pusher experiment of Sec. V-A.
#include <CLI/CLI.hpp>
#include <cstdlib>
#include <string>
#include <utility>

#include "apps/command_line.h"
#include "commands.h"
#include "dfr/core/features/features.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/ledger.h"
#include "dfr/safety/method.h"
#include "dfr/study/placebo.h"
#include "supervisor/supervisor.h"
#include "supervisor/train_supervisor.h"

namespace dfr::apps::pusher {
namespace {

void AddScene(CLI::App& command, sim::PusherOptions& plant) {
  command.add_option("--red-y", plant.red_y, "the red regions are at y = +- this value [m]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      .add_option("--start-y", plant.start_y, "the cylinder starts within y = +- this value [m]")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  command.add_option("--joint-step", plant.joint_step, "largest change of a joint angle [rad]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  AddGripper(command, plant.gripper);
  command
      .add_option("--physics", plant.physics,
                  "quasi-static: the arm follows its path exactly; dynamic: motors move an arm "
                  "with inertia and friction, which is slower to simulate")
      ->transform(
          apps::OneOf<sim::PusherPhysics>({{"quasi-static", sim::PusherPhysics::kQuasiStatic},
                                           {"dynamic", sim::PusherPhysics::kDynamic}}))
      ->default_str("quasi-static");
}

// Returns the check of a method for a model loaded from a file.
CLI::Validator LoadedMethod() {
  return dfr::apps::ReadBy(
      [](const std::string& name) { return study::ParseMethod(name, study::kLoadedMethods); });
}

void AddModelOptions(CLI::App& command, ModelOptions& model) {
  command
      .add_option("--nu", model.nu,
                  "upper bound on the share of outliers of each support, in (0, 1]")
      ->check(dfr::apps::ShareIn("(0, 1]"))
      ->capture_default_str();
  command.add_option("--gamma", model.gamma, "parameter gamma of the Gaussian kernel [1/m^2]")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      .add_option("--features", model.support_features,
                  "features of the support: blocks of the state, as in red,object,tip[0:2]")
      ->check(dfr::apps::ReadBy([](const std::string& features) {
        return core::FeatureSelection(sim::PusherPlant().layout(), features);
      }))
      ->capture_default_str();
  command
      .add_option("--horizon", model.horizon,
                  "T: number of the learned policy's controls per episode")
      ->check(kCount)
      ->capture_default_str();
  command
      .add_option("--whitened-gamma", model.whitened_gamma,
                  "gamma of the whitened support, which guard and controller use")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command.add_option("--epochs", model.epochs, "passes of Adam over the demonstrations")
      ->check(kCount)
      ->capture_default_str();
}

void AddExperiment(CLI::App& app, ExperimentOptions& options) {
  CLI::App* command = app.add_subcommand(
      "experiment", "Run the paper's comparison: all methods over the number of demonstrations");
  experiment::AddExperimentOptions(
      *command, options,
      "quick: 2 trials, demonstrations 20, 60, 120; paper: 10 trials of 5 supervisors, 6, 12, ..., "
      "120; authors: as "
      "quick, with the constants of the authors' scripts where these differ, Adam's rate .01, "
      "T = 100, gamma 1, nu .1; fig5: 6 trials of 3 supervisors, demonstrations 60, 120, controls "
      "of .03 rad and T = 100, and the recoveries of every model",
      "methods; the first is the reference. Valid: " + study::MethodHelp(),
      {"quick", "paper", "authors", "fig5"});
  command->get_option("--methods")->check(dfr::apps::ReadBy([](const std::string& name) {
    return study::ParseCompared(name);
  }));
  command
      ->add_option("--supervisor", options.supervisor,
                   "file of train-supervisor (default: the shipped ones)")
      ->type_name("FILE");
  command
      ->add_option("--supervisors", options.supervisors,
                   "number of shipped supervisors that take turns, trial by trial (default: 5 for "
                   "paper, 3 for fig5, otherwise 1); with 5, intervals are clustered by supervisor")
      ->check(CLI::Range(1, kShippedSupervisors))
      ->excludes("--supervisor");
  command->add_flag("!--no-convergence", options.convergence,
                    "skip the study of the speed of recoveries, which takes seconds");
  command
      ->add_option(
          "--learners", options.learners,
          "hidden units of the learned policies, and epochs after an x, as in 8,64-64,8x100")
      ->delimiter(',')
      ->check(dfr::apps::ReadBy(Learner::Parse));
  command
      ->add_option("--demonstrations", options.demonstrations,
                   "numbers of demonstrations, ascending")
      ->delimiter(',')
      ->check(dfr::apps::kModelDemonstrations);
  AddModelOptions(*command, options.model);
  AddScene(*command, options.plant);
  command
      ->add_option("--learning-rate", options.model.learner.learning_rate, "learning rate of Adam")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->callback([&options, command] {
    // Options given by the user take precedence.
    const auto take = [command](const char* option, auto& value, auto preset) {
      if (command->count(option) > 0) return;
      value = preset;
      // run.toml records the default text.
      command->get_option(option)->default_str(experiment::Exactly(preset));
    };
    if (options.preset == "fig5") {
      take("--joint-step", options.plant.joint_step, 0.03);
      take("--horizon", options.model.horizon, 100);
    }
    if (options.preset == "authors") {
      take("--learning-rate", options.model.learner.learning_rate, 0.01);
      take("--horizon", options.model.horizon, 100);
      take("--gamma", options.model.gamma, 1.0);
      take("--nu", options.model.nu, 0.1);
    }
    RunExperiment(options);
  });
}

void AddDemonstrate(CLI::App& app, DemonstrateOptions& options) {
  CLI::App* command =
      app.add_subcommand("demonstrate", "Write demonstrations of the supervisor as robomimic HDF5");
  core::WritesFile(command->add_option("--out", options.out, "file of the demonstrations, .hdf5"),
                   {".hdf5", ".h5"})
      ->capture_default_str();
  command->add_option("--count", options.count, "number of demonstrations, without discarded ones")
      ->check(dfr::apps::kDemonstrations)
      ->capture_default_str();
  command->add_option("--supervisor", options.supervisor,
                      "file of train-supervisor (default: the shipped one)");
  command
      ->add_option("--horizon", options.horizon, "T: largest number of controls in a demonstration")
      ->check(kCount)
      ->capture_default_str();
  command->add_option("--seed", options.seed, "random seed of start states and noise")
      ->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunDemonstrate(options); });
}

void AddFit(CLI::App& app, FitOptions& options) {
  CLI::App* command =
      app.add_subcommand("fit", "Learn policy, support and lambda from demonstrations");
  command->add_option("--demonstrations", options.demonstrations, "robomimic HDF5 file")
      ->capture_default_str();
  command
      ->add_option("--use", options.use, "number of demonstrations to use, from the first; 0: all")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  core::WritesFolder(command->add_option("--out", options.out, "folder for the model's files"))
      ->capture_default_str();
  command->add_option("--learner", options.learner, "hidden units of the policy, as in 8 or 64-64")
      ->check(dfr::apps::ReadBy(Learner::Parse))
      ->capture_default_str();
  command
      ->add_option("--seed", options.model.seed,
                   "random seed of the network's initial weights and batches")
      ->capture_default_str();
  AddModelOptions(*command, options.model);
  command->callback([&options] { RunFit(options); });
}

void AddEvaluate(CLI::App& app, EvaluateOptions& options) {
  CLI::App* command =
      app.add_subcommand("evaluate", "Run a model from new start states, with each method");
  command->add_option("--model", options.model, "folder written by fit")->capture_default_str();
  command->add_option("--methods", options.methods, study::MethodHelp(study::kLoadedMethods))
      ->delimiter(',')
      ->check(LoadedMethod())
      ->capture_default_str();
  command->add_option("--episodes", options.episodes, "number of start states")
      ->check(kCount)
      ->capture_default_str();
  command->add_option("--seed", options.seed, "random seed of start states and recoveries")
      ->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunEvaluate(options); });
}

void AddRender(CLI::App& app, RenderOptions& options) {
  CLI::App* command = app.add_subcommand(
      "render", "Write a video of rollouts from one start state, without a display");
  command->add_option("--model", options.model, "folder written by fit")->capture_default_str();
  command->add_option("--methods", options.methods, "methods to show side by side, as for evaluate")
      ->delimiter(',')
      ->check(LoadedMethod())
      ->capture_default_str();
  command->add_option("--seed", options.seed, "random seed of the start state")
      ->capture_default_str();
  core::WritesFile(
      command->add_option("--out", options.out,
                          "file of the video (.mp4, .webm) or of the last picture (.png, .jpg)"),
      {".mp4", ".webm", ".png", ".jpg"})
      ->capture_default_str();
  command->add_option("--width", options.width, "width of each picture [px]")
      ->check(CLI::Range(160, 1920))
      ->capture_default_str();
  command->add_option("--height", options.height, "height of each picture [px]")
      ->check(CLI::Range(120, 1080))
      ->capture_default_str();
  AddScene(*command, options.plant);
  command->callback([&options] { RunRender(options); });
}

int Main(int argc, char** argv) {
  CLI::App app(
      "The Pusher experiment: a 7-joint arm pushes a cylinder over a goal, past two red regions\n"
      "that neither arm nor cylinder may touch. Controls are changes of the joint angles in units\n"
      "of --joint-step, within [-1, 1]; lengths are metres. By default, each of the\n"
      "commands demonstrate, fit, evaluate and render reads the files of the previous ones.",
      "pusher");
  apps::AddVersion(app);
  app.require_subcommand(1);

  ExperimentOptions compared;
  TrainSupervisorOptions train;
  DemonstrateOptions demonstrate;
  FitOptions fit;
  EvaluateOptions evaluate;
  RenderOptions render;
  AddExperiment(app, compared);
  AddTrainSupervisor(app, train);
  AddDemonstrate(app, demonstrate);
  AddFit(app, fit);
  AddEvaluate(app, evaluate);
  AddRender(app, render);
  core::AddExamples(
      app, {{"experiment",
             {"--out out/pusher",
              "--preset paper --methods baseline,dfr,controller --shard 1/8 --out out/pusher/1"}},
            {"train-supervisor", {"--seed 2 --out supervisor.dfr"}},
            {"demonstrate", {"--count 60 --out demonstrations.hdf5"}},
            {"fit", {"--demonstrations demonstrations.hdf5 --use 40 --out model"}},
            {"evaluate", {"--model model --methods baseline,dfr,controller --episodes 100"}},
            {"render", {"--model model --methods baseline,dfr --out rollout.mp4"}}});

  return experiment::Parse(app, argc, argv, {".mp4", ".webm"}).value_or(EXIT_SUCCESS);
}

}  // namespace
}  // namespace dfr::apps::pusher

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("pusher", argc, argv, dfr::apps::pusher::Main);
}
