// Program line_tracking: the experiment of Sec. V-B in simulation, and its run on a robot.
#include <CLI/CLI.hpp>
#include <cstdlib>
#include <opencv2/core/utility.hpp>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "apps/command_line.h"
#include "apps/platform_options.h"
#include "commands/commands.h"
#include "dfr/experiment/command_line.h"
#include "dfr/study/controller_factory.h"
#include "dfr/study/placebo.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// Returns the check of a method that study::ParseMethod() parses with `others`.
CLI::Validator MethodOf(std::span<const std::string_view> others) {
  return ReadBy([others](const std::string& name) { return study::ParseMethod(name, others); });
}

void AddImages(CLI::App& command, sim::LineTrackingOptions& plant) {
  command
      .add_option("--observation", plant.observation,
                  "images, or truth: the simulation's exact numbers")
      ->transform(OneOf<sim::Observation>(
          {{"images", sim::Observation::kVision}, {"truth", sim::Observation::kGroundTruth}}))
      ->type_name("TEXT")
      ->default_str("images");
  command
      .add_option("--blur", plant.endoscope.blur_px,
                  "standard deviation of the blur in the image [px]")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  command
      .add_option("--noise", plant.endoscope.noise,
                  "standard deviation of the image noise, in levels of 255")
      ->check(CLI::Range(0.0, 255.0))
      ->capture_default_str();
}

void AddWorld(CLI::App& command, sim::LineTrackingOptions& plant, bool disturbed) {
  command.add_option("--arm", plant.arm.seed, "random seed of the individual arm's cable errors")
      ->capture_default_str();
  command
      .add_option("--start-scatter", plant.start_scatter_m,
                  "standard deviation of the tip's initial distance to the line [m]")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  if (!disturbed) return;
  sim::DisturbanceOptions& d = plant.disturbance;
  AddWave(command, d);
  command.add_flag("--during,!--not-during", d.during,
                   "the platform moves during controls (default: yes)");
  command.add_flag("--between", d.between,
                   "the platform also moves for --pause after every control");
  command.add_option("--pause", d.pause_s, "duration of the motion after a control [s]")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
}

void AddPlant(CLI::App& command, sim::LineTrackingOptions& plant, bool disturbed) {
  AddImages(command, plant);
  AddWorld(command, plant, disturbed);
}

void AddCalibration(CLI::App& command, SceneOptions& scene) {
  command
      .add_option("--calibration", scene.calibration,
                  "file written by calibrate; none: the true camera and an uncorrected arm")
      ->capture_default_str();
}

void AddScene(CLI::App& command, SceneOptions& scene, bool disturbed) {
  AddPlant(command, scene.plant, disturbed);
  AddCalibration(command, scene);
}

void AddModelOptions(CLI::App& command, LineModelOptions& model) {
  command
      .add_option("--nu", model.nu,
                  "upper bound on the share of outliers of each support, in (0, 1]")
      ->check(dfr::apps::ShareIn("(0, 1]"))
      ->capture_default_str();
  command
      .add_option("--gammas", model.gammas,
                  "values of gamma to choose from by held-out demonstrations [1/mm^2]")
      ->check(dfr::apps::kPositive)
      ->delimiter(',')
      ->capture_default_str();
  command
      .add_option("--acceptance", model.acceptance, "share of held-out states that must be inside")
      ->check(dfr::apps::ShareIn("(0, 1]"))
      ->capture_default_str();
  command
      .add_option("--features", model.support_features,
                  "features of the support: blocks of the state tip, distance, heading")
      ->check(ReadBy(LayoutWith))
      ->capture_default_str();
  command
      .add_option("--whitened-gamma", model.whitened_gamma,
                  "gamma of the whitened support, which guard and controller use")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      .add_option("--horizon", model.horizon,
                  "T: number of the learned policy's controls per episode")
      ->check(kCount)
      ->capture_default_str();
}

void AddExperiment(CLI::App& app, ExperimentOptions& options) {
  options.plant.disturbance.wave = sim::Wave::kRandom;
  CLI::App& command =
      *app.add_subcommand("experiment", "Run the paper's comparison of all methods");
  experiment::AddExperimentOptions(
      command, options, "quick: 2 trials of 15 episodes; paper: 5 trials of 50",
      "the first is the reference; of " + study::MethodHelp(kOtherLineMethods));
  command.get_option("--methods")->check(ReadBy([](const std::string& name) {
    return study::ParseCompared(name, kOtherLineMethods);
  }));
  command
      .add_option(
          "--worlds", options.worlds,
          "worlds, one table each. A latency such as 30ms: real time, in which the platform "
          "never stops and may move the line until 5 s after a halt. frozen: the platform "
          "stops while the robot looks, computes or has halted")
      ->delimiter(',')
      ->check(ReadBy([](const std::string& world) { return InWorld({}, world); }))
      ->capture_default_str();
  AddModelOptions(command, options.model);
  AddPlant(command, options.plant, true);
  command.callback([&options] { RunExperiment(options); });
}

void AddCalibrate(CLI::App& app, CalibrateOptions& options) {
  CLI::App& command = *app.add_subcommand(
      "calibrate", "Calibrate lens, camera pose and the arm's joint errors from a motion");
  command.add_option(
      "--config", options.config,
      "configuration of the robot, as for run: its operator moves it and triggers pictures; "
      "default: a motion in the simulation of this process, which the other options describe");
  core::WritesFile(command.add_option(
      "--out", options.out,
      "file of the calibration (default: calibration.dfr, or the configuration's)"));
  command.add_option("--frames", options.frames, "number of pictures of the motion")
      ->check(kCount)
      ->capture_default_str();
  command.add_option("--held-out", options.held_out, "number of poses for the evaluation")
      ->check(kCount)
      ->capture_default_str();
  command.add_option("--seed", options.seed, "random seed of the motion")->capture_default_str();
  AddPlant(command, options.scene.plant, false);
  command.callback([&options] { RunCalibrate(options); });
}

void AddDemonstrate(CLI::App& app, DemonstrateOptions& options) {
  CLI::App& command = *app.add_subcommand(
      "demonstrate", "Write demonstrations without disturbance as robomimic HDF5");
  command.add_option("--config", options.config,
                     "configuration of the robot, as for run; default: open-loop demonstrations in "
                     "the simulation of this process");
  command.add_flag("--teleoperation", options.teleoperation,
                   "with --config: records the tip while the operator leads it; by default the "
                   "robot follows the line by itself after the operator's confirmation");
  core::WritesFile(command.add_option("--out", options.out, "file of the demonstrations, .hdf5"),
                   {".hdf5", ".h5"})
      ->capture_default_str();
  command.add_option("--count", options.count, "number of demonstrations")
      ->check(dfr::apps::kDemonstrations)
      ->capture_default_str();
  command.add_option("--steps", options.steps, "number of controls of 1 mm each")
      ->check(CLI::Range(41, 54))
      ->capture_default_str();
  command.add_option("--seed", options.seed, "random seed of lines and start states")
      ->capture_default_str();
  AddScene(command, options.scene, false);
  command.callback([&options] { RunDemonstrate(options); });
}

void AddFit(CLI::App& app, FitOptions& options) {
  CLI::App& command =
      *app.add_subcommand("fit", "Learn policy, supports and lambda from demonstrations");
  command.add_option("--demonstrations", options.demonstrations, "robomimic HDF5 file")
      ->capture_default_str();
  core::WritesFolder(command.add_option("--out", options.out, "folder for the model's files"))
      ->capture_default_str();
  command.add_option("--seed", options.model.seed, "random seed of the network's initial weights")
      ->capture_default_str();
  AddModelOptions(command, options.model);
  command.callback([&options] { RunFit(options); });
}

void AddRun(CLI::App& app, RunOptions& options) {
  options.scene.plant.disturbance.wave = sim::Wave::kRandom;
  CLI::App& command = *app.add_subcommand("run", "Run a model on a moving platform, or on a robot");
  command.add_option("--config", options.config,
                     "configuration of the robot and its network (docs/robot.md). Options given "
                     "here\ntake precedence. Default: the simulation in this process.\n"
                     "`line_tracking --config FILE` is short for this");
  command.add_option("--model", options.model, "folder written by fit (default: model)");
  command
      .add_option("--method", options.method,
                  study::MethodHelp(kRobotLineMethods) + " (default: controller)")
      ->check(MethodOf(kRobotLineMethods));
  core::Writes(
      command.add_option("--recordings", options.recordings,
                         "folder for the logs of runs (default: recordings); none: no log"),
      [](const std::filesystem::path& path) {
        return path == "none" ? "" : core::UnwritableFolder(path);
      });
  command.add_option("--episodes", options.episodes, "number of start states")
      ->check(kCount)
      ->capture_default_str();
  command
      .add_option("--seed", options.seed, "random seed of start states, platform and recoveries")
      ->capture_default_str();
  AddScene(command, options.scene, true);
  command.callback([&options] { RunRun(options); });
}

void AddReplay(CLI::App& app, ReplayOptions& options) {
  CLI::App& command =
      *app.add_subcommand("replay", "Repeat the decisions of a log, and print the differences");
  command.add_option("LOG", options.recording, "log of a run: .mcap")->required();
  command.add_option("--model", options.model,
                     "folder written by fit (default: the folder named by the log)");
  command.callback([&options] { RunReplay(options); });
}

void AddLaunch(CLI::App& app, LaunchOptions& options) {
  CLI::App& command = *app.add_subcommand(
      "launch", "Start a simulated console, an emergency stop and a run, all over the network");
  command.add_option("--config", options.config, "configuration, as for run, with a simulator")
      ->required();
  core::WritesFolder(command.add_option("--out", options.folder,
                                        "folder for calibration, demonstrations and model"))
      ->capture_default_str();
  command.add_option("--episodes", options.episodes, "number of start states")
      ->check(kCount)
      ->capture_default_str();
  command
      .add_option("--seed", options.seed, "random seed of start states, platform and recoveries")
      ->capture_default_str();
  command.callback([&options] { RunLaunch(options); });
}

void AddRender(CLI::App& app, RenderOptions& options) {
  options.scene.plant.disturbance.wave = sim::Wave::kRandom;
  CLI::App& command =
      *app.add_subcommand("render", "Write a video of one episode, without a display");
  command.add_option("--model", options.model, "folder written by fit")->capture_default_str();
  command.add_option("--method", options.method, study::MethodHelp(kLoadedLineMethods))
      ->check(MethodOf(kLoadedLineMethods))
      ->capture_default_str();
  command.add_option("--seed", options.seed, "random seed of the episode")->capture_default_str();
  core::WritesFile(command.add_option("--out", options.out, "a video: .mp4 or .webm"),
                   {".mp4", ".webm"})
      ->capture_default_str();
  AddScene(command, options.scene, true);
  command.callback([&options] { RunRender(options); });
}

void AddVision(CLI::App& app, VisionOptions& options) {
  options.scene.plant.disturbance.wave = sim::Wave::kRandom;
  CLI::App& command = *app.add_subcommand(
      "vision", "Print a table of vision's errors over poses, blur, light and noise");
  command.add_option("--episodes", options.episodes, "number of episodes per row")
      ->check(kCount)
      ->capture_default_str();
  command.add_option("--seed", options.seed, "random seed of the poses")->capture_default_str();
  // Each row has separate blur, light and noise of the images.
  AddWorld(command, options.scene.plant, true);
  AddCalibration(command, options.scene);
  command.callback([&options] { RunVision(options); });
}

int Main(int argc, char** argv) {
  CLI::App app(
      "Line tracking: a da Vinci arm follows a red line on gauze, which a Stewart platform moves\n"
      "under an endoscope. States are in mm (tip x, y; distance to the line, positive to its "
      "left;\n"
      "10 mm times the line's angle in rad); controls are displacements of the tool in x and y in\n"
      "units of 2 mm, within [-1, 1]. By default each command uses the files of the earlier ones:\n"
      "calibrate, demonstrate, fit, run, render. experiment needs none of them.",
      "line_tracking");
  apps::AddVersion(app);
  app.require_subcommand(1);

  ExperimentOptions compared;
  CalibrateOptions calibrate;
  DemonstrateOptions demonstrate;
  FitOptions fit;
  RunOptions run;
  ReplayOptions replay;
  LaunchOptions launch;
  RenderOptions render;
  VisionOptions vision;
  AddExperiment(app, compared);
  AddCalibrate(app, calibrate);
  AddDemonstrate(app, demonstrate);
  AddFit(app, fit);
  AddRun(app, run);
  AddReplay(app, replay);
  AddLaunch(app, launch);
  AddRender(app, render);
  AddVision(app, vision);
  core::AddExamples(
      app, {{"experiment",
             {"--out out/line_tracking", "--worlds frozen,30ms --methods baseline,controller"}},
            {"calibrate", {"--out calibration.dfr"}},
            {"demonstrate", {"--calibration none --count 60 --out demonstrations.hdf5"}},
            {"fit", {"--demonstrations demonstrations.hdf5 --out model"}},
            {"run", {"--model model --method controller --episodes 10", "--config robot.toml"}},
            {"replay", {"recordings/20260102-030405.mcap --model model"}},
            {"launch", {"--config simulator.toml --episodes 3"}},
            {"render", {"--model model --out episode.mp4"}},
            {"vision", {"--calibration none --episodes 5"}}});

  // One thread per trial is enough; OpenCV's threads would only wait for each other.
  cv::setNumThreads(1);
  // `line_tracking --config FILE` is short for `line_tracking run --config FILE`.
  std::vector<const char*> arguments(argv, argv + argc);
  if (argc > 1 && std::string_view(argv[1]).rfind("--config", 0) == 0) {
    arguments.insert(arguments.begin() + 1, "run");
  }
  return experiment::Parse(app, static_cast<int>(arguments.size()), arguments.data(),
                           {".mp4", ".webm"})
      .value_or(EXIT_SUCCESS);
}

}  // namespace
}  // namespace dfr::apps::line_tracking

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("line_tracking", argc, argv, dfr::apps::line_tracking::Main);
}
