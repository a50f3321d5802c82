#include <algorithm>
#include <cmath>
#include <iomanip>
#include <iostream>
#include <optional>

#include "apps/usage_error.h"
#include "commands/commands.h"
#include "dfr/core/random.h"
#include "dfr/experiment/progress.h"
#include "dfr/imitation/demonstrations.h"
#include "robot/robot_plant.h"
#include "robot/terminal.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

using core::Row;
using line_task::LineTask;

constexpr double kDemonstratedStep = 1.0;  // mm

core::Trajectory Empty(const RobotPlant& plant, int steps) {
  core::Trajectory trajectory;
  trajectory.controls.resize(steps, plant.control_dim());
  trajectory.states.resize(steps + 1, plant.state_dim());
  trajectory.outcome = core::Outcome::kCompleted;
  return trajectory;
}

// Returns a demonstration of the scripted supervisor, which follows the line from the operator's
// initial tip position. Empty if the task was not completed: the robot then holds, and plant.loop()
// has the reason.
std::optional<core::Trajectory> Drive(RobotPlant& plant, int steps, std::uint64_t seed) {
  core::Trajectory trajectory = Empty(plant, steps);
  trajectory.seed = seed;
  plant.Reset(seed);
  plant.Observe(Row(trajectory.states, 0));
  for (int t = 0; t < steps; ++t) {
    ProportionalPolicy().Control(t, Row(trajectory.states, t), Row(trajectory.controls, t));
    if (plant.Apply(Row(trajectory.controls, t)) != core::PlantStatus::kOk) return std::nullopt;
    plant.Observe(Row(trajectory.states, t + 1));
    if (plant.collided()) return std::nullopt;
  }
  if (!plant.completed()) return std::nullopt;
  return trajectory;
}

// The operator leads the tip. Records a state after each millimetre, and the displacement to the
// next state as its control.
core::Trajectory Follow(RobotPlant& plant, int steps) {
  core::Trajectory trajectory = Empty(plant, steps);
  core::Matrix& x = trajectory.states;
  if (!plant.ObserveIdle(Row(x, 0))) throw std::runtime_error("the line or the tip is not visible");
  const vision::LineObservation first = plant.last_image().seen;
  for (int t = 0; t < steps; ++t) {
    constexpr int kPatience = 300;  // pictures
    for (int n = 0;; ++n) {
      if (Terminal::interrupted()) throw std::runtime_error("interrupted");
      if (n > kPatience) throw std::runtime_error("the tip does not move; lead it along the line");
      if (!plant.ObserveIdle(Row(x, t + 1)))
        throw std::runtime_error("the line or the tip is not visible");
      if (std::abs(x(t + 1, 2)) > 1e3 * LineTask::kCollision)
        throw std::runtime_error("the tip is too far from the line");
      if ((x.row(t + 1) - x.row(t)).head(2).norm() >= kDemonstratedStep) break;
    }
    trajectory.controls.row(t) = (x.row(t + 1) - x.row(t)).head(2) / (1e3 * LineTask::kStep);
    if (!(trajectory.controls.row(t).cwiseAbs().maxCoeff() <= 1.0)) {
      throw std::runtime_error("too fast: at most 2 mm between two pictures");
    }
  }
  if (!(LineTask::Progress(first, plant.last_image().seen) >= LineTask::kCompletion)) {
    throw std::runtime_error("not completed: continue along the line");
  }
  return trajectory;
}

// Returns one demonstration; empty if it was not completed or a state is not finite.
std::optional<core::Trajectory> RecordDemonstration(RobotPlant& plant,
                                                    const DemonstrateOptions& options,
                                                    std::uint64_t seed,
                                                    runtime::AsyncPrinter& printer) {
  std::optional<core::Trajectory> trajectory;
  try {
    trajectory =
        options.teleoperation ? Follow(plant, options.steps) : Drive(plant, options.steps, seed);
    if (!trajectory) printer.Say("  not completed: the demonstration is discarded\n");
  } catch (const std::runtime_error& e) {
    printer.Say("  %s: the demonstration is discarded\n", e.what());
  }
  if (!options.teleoperation) plant.Halt();
  if (trajectory && !trajectory->states.allFinite()) {
    printer.Say("  the line was not visible in every state: the demonstration is discarded\n");
    trajectory.reset();
  }
  return trajectory;
}

void DemonstrateOnRobot(const DemonstrateOptions& options) {
  const RobotConfig config = LoadRobot(options.config);
  const line_task::LineCalibration known = LoadCalibration(config);
  if (std::filesystem::exists(options.out)) {
    throw std::runtime_error(options.out.string() +
                             ": exists already, and an operator's demonstrations are not replaced. "
                             "Move it away, or give another file with --out");
  }
  const core::Provenance provenance = ProvenanceOf(config);
  Terminal terminal;
  runtime::AsyncPrinter& printer = terminal.printer();
  const std::unique_ptr<RobotPlant> plant = BringUpRobot(config, known, nullptr, terminal);
  imitation::RobomimicWriter writer(options.out, plant->layout(), plant->control_dim(),
                                    "line-tracking");
  writer.SetProvenance(provenance);
  printer.Say(
      "%d demonstrations, the platform at rest; begin at a different place each time, up to 1 mm "
      "off the line\n%s\n",
      options.count,
      options.teleoperation
          ? "Enter once the tip is over the beginning, then lead it along by teleoperation"
          : "the arm follows the line by itself after Enter");
  for (std::uint64_t i = 0;
       writer.num_episodes() < options.count && MayBegin(*plant, /*simulated=*/false, terminal);
       ++i) {
    const std::uint64_t seed = core::DeriveSeed(options.seed, {i});
    if (const auto trajectory = RecordDemonstration(*plant, options, seed, printer)) {
      writer.Append(*trajectory);
      printer.Say("%d of %d\n", writer.num_episodes(), options.count);
    } else {
      writer.CountDiscarded();
    }
  }
  printer.Say("%s: %d demonstrations\n", options.out.c_str(), writer.num_episodes());
}

}  // namespace

RobotConfig LoadRobot(const std::filesystem::path& file) {
  RobotConfig config = RobotConfig::Load(file);
  if (config.robot == RobotPlace::kProcess) {
    throw std::runtime_error(file.string() +
                             ": robot is 'process', the simulation of this process: leave --config "
                             "out, or set robot = \"dds\"");
  }
  if (config.lock_step) {
    throw std::runtime_error(
        file.string() +
        ": simulator.lock_step is true, but an operator needs real time: set it to false");
  }
  config.platform.wave.reset();  // only `run` starts the wave
  return config;
}

void RunDemonstrate(const DemonstrateOptions& options) {
  if (!options.config.empty()) return DemonstrateOnRobot(options);
  if (options.teleoperation) {
    throw UsageError("--teleoperation needs --config: the simulation has no operator");
  }
  experiment::ProgressBar bar("demonstrations");
  imitation::DemonstrationSet set = Demonstrate(
      options.scene.plant, LoadCalibration(options.scene), options.count, options.steps,
      options.seed, [&bar](const experiment::Progress& progress) { bar.Show(progress); });
  set.provenance.date = core::Today();
  imitation::SaveRobomimic(set, options.out);
  double farthest = 0.0;
  for (const core::Trajectory& trajectory : set.trajectories) {
    farthest = std::max(farthest, trajectory.states.col(2).cwiseAbs().maxCoeff());
  }
  std::cout << std::fixed << std::setprecision(2) << options.out.string() << ": "
            << set.trajectories.size() << " open-loop demonstrations of " << options.steps
            << " controls, " << set.discarded << " discarded; at most " << farthest
            << " mm from the line\n";
}

}  // namespace dfr::apps::line_tracking
