#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/experiment/experiment.h"
#include "dfr/recording/records.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "model.h"
#include "robot/robot_config.h"

namespace dfr::apps::line_tracking {

// One struct and one function per command. main.cc fills the struct and calls the function. All
// functions throw std::exception with a message for the user.

inline constexpr const char* kNoCalibration = "none";

/// Options of the simulated world, for all commands.
struct SceneOptions {
  sim::LineTrackingOptions plant;
  /// A file that `calibrate` wrote, or kNoCalibration: the true camera and mounting, and an
  /// uncorrected arm.
  std::filesystem::path calibration = "calibration.dfr";
};

struct DemonstrateOptions {
  SceneOptions scene;
  /// A robot's configuration; empty: the simulation in this process.
  std::filesystem::path config;
  bool teleoperation = false;  ///< On a robot: records the tip while the operator leads it.
  std::filesystem::path out = "demonstrations.hdf5";
  int count = 50;
  int steps = 50;
  std::uint64_t seed = 1;
};
void RunDemonstrate(const DemonstrateOptions& options);

struct CalibrateOptions {
  SceneOptions scene;
  /// A robot's configuration; empty: the simulation in this process.
  std::filesystem::path config;
  std::filesystem::path out;  ///< Empty: the configured file, or calibration.dfr.
  int frames = 300;
  int held_out = 200;
  std::uint64_t seed = 1;
};
void RunCalibrate(const CalibrateOptions& options);

struct FitOptions {
  std::filesystem::path demonstrations = "demonstrations.hdf5";
  std::filesystem::path out = "model";
  LineModelOptions model;
};
void RunFit(const FitOptions& options);
/// Returns the layout of states. @throws std::invalid_argument if `features` are not part of it.
core::StateLayout LayoutWith(const std::string& features);

inline constexpr const char* kNoRecordings = "none";

struct RunOptions {
  SceneOptions scene;
  /// A robot's configuration; empty: the simulation in this process.
  std::filesystem::path config;
  // An empty value stands for the configuration's value or, without a configuration, for "model",
  // "controller" or "recordings".
  std::filesystem::path model;
  std::string method;
  std::filesystem::path recordings;  ///< A folder, or kNoRecordings.
  int episodes = 10;
  std::uint64_t seed = 1001;
};
void RunRun(const RunOptions& options);
/// Metadata of a run's recording, including the presence of an emergency stop.
[[nodiscard]] recording::RecordingMetadata RunMetadata(const RobotConfig& config,
                                                       std::uint64_t seed);

struct ReplayOptions {
  std::filesystem::path recording;
  std::filesystem::path model;  ///< Empty: the model named by the recording.
};
void RunReplay(const ReplayOptions& options);

struct LaunchOptions {
  std::filesystem::path config;
  std::filesystem::path folder = "out/line_tracking";
  int episodes = 3;
  std::uint64_t seed = 1001;
};
void RunLaunch(const LaunchOptions& options);
/// Returns the arguments with which RunLaunch() starts dvrk_simulator, except the network's
/// arguments.
[[nodiscard]] std::vector<std::string> SimulatorArguments(const RobotConfig& config);

struct ExperimentOptions : experiment::ExperimentOptions {
  ExperimentOptions() { out = "out/line_tracking"; }
  std::vector<std::string> worlds = {"30ms", "frozen"};  ///< Arguments of InWorld().
  LineModelOptions model;
  sim::LineTrackingOptions plant;
};
void RunExperiment(const ExperimentOptions& options);

struct RenderOptions {
  SceneOptions scene;
  std::filesystem::path model = "model";
  std::string method = "controller";
  std::uint64_t seed = 1;
  std::filesystem::path out = "rollout.mp4";
};
void RunRender(const RenderOptions& options);

struct VisionOptions {
  SceneOptions scene;
  int episodes = 10;
  std::uint64_t seed = 1;
};
void RunVision(const VisionOptions& options);

/// Returns the calibration of the scene's file, or the true one for kNoCalibration.
/// @throws std::runtime_error naming a missing file and the command that writes this file.
[[nodiscard]] line_task::LineCalibration LoadCalibration(const SceneOptions& scene);
/// Returns the calibration of the configuration's file, after checks of its provenance and camera.
/// @throws std::runtime_error as the overload above, CheckProvenance() and CheckCamera().
[[nodiscard]] line_task::LineCalibration LoadCalibration(const RobotConfig& config);

/// Returns the configuration of a robot for a command other than `run`.
/// @throws std::runtime_error if it selects the simulation in this process, or lock-step.
[[nodiscard]] RobotConfig LoadRobot(const std::filesystem::path& file);

}  // namespace dfr::apps::line_tracking
