#include <array>
#include <ctime>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <utility>

#include "commands/commands.h"
#include "dfr/control/rollout.h"
#include "dfr/core/build_info.h"
#include "dfr/core/random.h"
#include "dfr/runtime/periodic_timer.h"
#include "recorded_controller.h"
#include "robot/robot_plant.h"
#include "robot/terminal.h"
#include "rollout_video.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// Plant of a run, with the specific interface of its kind.
struct Robot {
  std::unique_ptr<core::Plant> plant;
  sim::LineTrackingPlant* simulation = nullptr;  // one of these two is set
  RobotPlant* wire = nullptr;

  [[nodiscard]] const vision::LineObservation& seen() const {
    return wire != nullptr ? wire->last_image().seen : simulation->last_observation();
  }
  [[nodiscard]] double progress_m() const {
    return wire != nullptr ? wire->progress_m() : simulation->truth().progress_m;
  }
};

std::string CauseOf(const control::RolloutResult& result, const Robot& robot) {
  if (result.outcome == core::Outcome::kCollided) return control::Name(result.last_mode);
  if (result.outcome != core::Outcome::kHalted) return {};
  if (robot.wire != nullptr && robot.wire->loop().state() == runtime::RunState::kFaulted) {
    return robot.wire->loop().cause();
  }
  if (result.halt_cause == control::HaltCause::kStateInvalid && !robot.seen().seen()) {
    return std::string("not-seen-") + vision::Name(robot.seen().missing);
  }
  return control::Name(result.halt_cause);
}

std::filesystem::path RecordingName(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw std::runtime_error(folder.string() + ": cannot be created: " + error.message());
  }
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  std::array<char, 32> stamp;
  std::strftime(stamp.data(), stamp.size(), "%Y%m%d-%H%M%S", &utc);
  std::filesystem::path path = folder / (std::string(stamp.data()) + ".mcap");
  for (int i = 2; std::filesystem::exists(path); ++i) {
    path = folder / (std::string(stamp.data()) + "-" + std::to_string(i) + ".mcap");
  }
  return path;
}

// Reads the configuration file; the command line takes precedence.
RobotConfig Configuration(const RunOptions& options) {
  RobotConfig config;
  if (!options.config.empty()) {
    config = RobotConfig::Load(options.config);
  } else {
    config.model = "model";
    config.calibration = options.scene.calibration;
    config.recordings = "recordings";
  }
  if (!options.model.empty()) config.model = options.model;
  if (!options.method.empty()) config.method = options.method;
  if (!options.recordings.empty()) config.recordings = options.recordings;
  if (config.recordings == kNoRecordings) config.recordings.clear();
  return config;
}

Robot MakeRobot(const RobotConfig& config, const RunOptions& options,
                const line_task::LineCalibration& known, recording::Recorder* recorder,
                Terminal& terminal) {
  Robot robot;
  if (config.robot == RobotPlace::kProcess) {
    auto plant = std::make_unique<sim::LineTrackingPlant>(options.scene.plant, &known);
    robot.simulation = plant.get();
    robot.plant = std::move(plant);
    return robot;
  }
  auto plant = BringUpRobot(config, known, recorder, terminal);
  robot.wire = plant.get();
  robot.plant = std::move(plant);
  return robot;
}

// Passes the controller's decisions to the robot, and records them with the robot's state.
void Connect(RecordedController& controller, RobotPlant& plant) {
  controller.on_decision = [&plant](const control::Step& step) { plant.loop().Decided(step); };
  controller.describe = [&plant](recording::StepRecord& record) {
    record.machine = runtime::Name(plant.loop().state());
    record.image_sequence = plant.last_image().sequence;
    record.image_time_ns = plant.last_image().stamp_ns;
  };
}

// Runs the episodes and prints each outcome. Returns true if the robot ended the run early.
bool RunEpisodes(const RunOptions& options, const RobotConfig& config, const Robot& robot,
                 RecordedController& controller, Terminal& terminal) {
  runtime::AsyncPrinter& printer = terminal.printer();
  std::array<int, 3> counts{};
  control::RolloutWorkspace workspace;
  printer.Say("episode  outcome    controls  recovery  tracked [mm]  cause\n");
  bool stopped = false;
  for (int i = 0; i < options.episodes && !Terminal::interrupted(); ++i) {
    if (robot.wire != nullptr && !MayBegin(*robot.wire, config.simulator, terminal)) break;
    const auto episode = static_cast<std::uint64_t>(i);
    controller.BeginEpisode(episode);
    const control::RolloutResult result =
        control::Rollout(*robot.plant, controller,
                         {.plant_seed = core::DeriveSeed(options.seed, {0, episode}),
                          .controller_seed = core::DeriveSeed(options.seed, {1, episode})},
                         nullptr, &workspace);
    if (result.halt_cause == control::HaltCause::kStateInvalid) {
      controller.Record(result.last_step, workspace.x, workspace.u);
    }
    const std::string cause = CauseOf(result, robot);
    ++counts[static_cast<std::size_t>(result.outcome)];
    printer.Say("%7d  %-9s  %8d  %8d  %12.1f  %s\n", i, core::Name(result.outcome),
                result.controls(), result.recovery_controls(), 1e3 * robot.progress_m(),
                cause.c_str());
    stopped = robot.wire != nullptr && !robot.wire->loop().ended_regularly();
  }
  printer.Say("%s: %d completed, %d halted, %d collided\n", config.method.c_str(), counts[0],
              counts[1], counts[2]);
  return stopped;
}

void PrintTimes(runtime::AsyncPrinter& printer, const runtime::PeriodicTimer& timer,
                double period_s) {
  printer.Say(
      "loop: %lld periods of %.1f ms, off by %.3f ms (median), %.3f ms (99.9 %%), %.3f ms "
      "(worst); %lld skipped\n",
      static_cast<long long>(timer.periods()), 1e3 * period_s, 1e3 * timer.Jitter(0.5),
      1e3 * timer.Jitter(0.999), 1e3 * timer.worst(), static_cast<long long>(timer.missed()));
}

}  // namespace

recording::RecordingMetadata RunMetadata(const RobotConfig& config, std::uint64_t seed) {
  recording::RecordingMetadata metadata;
  metadata.program = std::string("line_tracking ") + core::BuildVersion();
  metadata.commit = core::BuildCommit();
  metadata.model = config.model.string();
  metadata.model_checksum = recording::Checksum(config.model);
  metadata.method = config.method;
  metadata.seed = seed;
  metadata.configuration = config.text;
  if (config.robot == RobotPlace::kDds) {
    metadata.more["emergency stop"] = config.emergency_stop ? "required" : "none";
  }
  return metadata;
}

void RunRun(const RunOptions& options) {
  if (options.episodes < 1) throw std::invalid_argument("--episodes must be positive");
  const RobotConfig config = Configuration(options);
  const LineModel model = LineModel::Load(config.model);
  CheckProvenance(config, config.model, model.demonstrations().provenance,
                  "Demonstrate with this robot and fit again");
  const line_task::LineCalibration known = LoadCalibration(config);
  std::optional<recording::Recorder> recorder;
  std::filesystem::path log;
  if (!config.recordings.empty()) {
    log = RecordingName(config.recordings);
    const auto pixels = static_cast<std::size_t>(known.camera.width) *
                        static_cast<std::size_t>(known.camera.height);
    recorder.emplace(log, RunMetadata(config, options.seed),
                     recording::RecorderOptions{.picture_bytes = 3 * pixels});
  }
  Terminal terminal;
  runtime::AsyncPrinter& printer = terminal.printer();
  Robot robot = MakeRobot(config, options, known, recorder ? &*recorder : nullptr, terminal);
  const std::unique_ptr<control::Controller> decides = model.MakeController(config.method);
  RecordedController controller(*decides, recorder ? &*recorder : nullptr);
  if (robot.wire != nullptr) Connect(controller, *robot.wire);
  const bool stopped = RunEpisodes(options, config, robot, controller, terminal);
  if (robot.wire != nullptr && robot.wire->timer() != nullptr) {
    PrintTimes(printer, *robot.wire->timer(), config.period_s);
  }
  const std::string why = stopped ? robot.wire->loop().cause() : std::string();
  robot = {};  // its threads stop recording
  if (recorder) {
    recorder->Finish();
    printer.Say("%s written: line_tracking replay repeats its decisions\n", log.c_str());
  }
  if (stopped) throw std::runtime_error("the robot holds: " + why);
}

void RunReplay(const ReplayOptions& options) {
  if (!ReplayRecording(options.recording, options.model)) {
    throw std::runtime_error(
        options.recording.string() +
        ": some repeated decisions differ from the recorded decisions, as printed above");
  }
}

void RunRender(const RenderOptions& options) {
  LineModel model = LineModel::Load(options.model);
  LineTrialRunner runner(std::move(model), {options.method}, options.scene.plant,
                         LoadCalibration(options.scene));
  const control::RolloutResult result =
      RecordEpisode(runner, 0, options.method, options.seed, options.seed, options.out);
  std::cout << options.out.string() << ": " << core::Name(result.outcome) << " after "
            << result.controls() << " controls\n";
}

}  // namespace dfr::apps::line_tracking
