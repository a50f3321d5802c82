#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "dfr/core/files/provenance.h"
#include "dfr/dds/participant.h"
#include "dfr/hardware/platform_motion.h"
#include "dfr/hardware/psm_client.h"
#include "dfr/line_task/line_task.h"
#include "dfr/line_task/tip_region.h"

namespace dfr::apps::line_tracking {

/// Place of the robot that a run controls.
enum class RobotPlace {
  kProcess,  ///< The simulation in this process.
  kDds,      ///< An arm behind a console on the network: dvrk_simulator's, or a real one.
};

/// A configuration file of `run --config`, in TOML; config/*.toml document each key. Missing keys
/// have the defaults below.
// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): in the order of the file
struct RobotConfig {
  std::filesystem::path file;  ///< For messages.
  std::string text;            ///< Complete text, for recordings.

  RobotPlace robot = RobotPlace::kProcess;
  std::filesystem::path model = "out/line_tracking/model";
  std::filesystem::path calibration = "out/line_tracking/calibration.dfr";
  std::string method = "controller";
  std::filesystem::path recordings = "out/line_tracking/recordings";  ///< Empty: no recordings.

  // [network]
  dds::ParticipantOptions network = {.name = "line_tracking"};

  // [arm]
  std::string arm = "PSM1";
  std::string arm_serial;  ///< Identifies this arm; required for a real one.
  hardware::PsmClientOptions arm_client;
  std::vector<std::string>
      teleoperation;      ///< Topics that report teleoperation; empty: the default topics.
  bool servo_cs = false;  ///< Sends set-points with their twist, if the console accepts them.
  double speed_m_s = line_task::LineTask::kSpeed;  ///< Speed of the tip during a control.
  /// Pose of the arm's base in the world frame, the frame of the gauze at rest. Absent: as in the
  /// simulation.
  std::optional<Eigen::Isometry3d> p_world_base;

  // [task]
  line_task::TipRegionOptions region;  ///< Allowed region of the tips on every path.
  double lift_m = 0.005;  ///< Height by which the tool is lifted before it is turned upright.

  // [camera]
  std::string camera = "/ECM/image_raw";  ///< A DDS topic, a device, a file or a pipeline.
  std::string camera_name;                ///< Identifies this camera; required for a real one.
  /// File of the camera's intrinsics. A calibration on a robot uses them unchanged; an existing
  /// calibration must match them. Empty: not checked.
  std::filesystem::path intrinsics;
  /// Approximate pose of the camera in the world frame, as the start of a calibration: within 20 mm
  /// and 10 degrees. Absent: as in the simulation.
  std::optional<Eigen::Isometry3d> p_world_cam;
  double image_max_age_s = 0.1;  ///< Maximum time since a picture's stamp, and since its arrival.
  double image_latency_s = 0.0;  ///< Delay from exposure to the stamp.

  hardware::PlatformOptions platform;  // [platform]

  // [simulator]
  bool simulator = false;  ///< The console is dvrk_simulator, which sets up episodes.
  bool lock_step = false;  ///< The simulator's time advances only on request.
  /// Timeout of the simulator's answers: drawing a picture may take a while.
  double simulator_answer_s = 5.0;

  // [emergency_stop]
  bool emergency_stop = true;
  double emergency_stop_silence_s = 0.06;
  bool emergency_stop_datagrams = true;  ///< Also requires the stop's datagrams.

  // [loop]
  double period_s = 0.005;
  double max_period_s = 0.05;  ///< A longer period is a fault.
  int priority = 20;           ///< Priority under SCHED_FIFO; 0: default scheduling.
  /// Largest difference between the measured and the commanded motion of the tip, mm.
  double max_state_jump_mm = 3.0;
  /// Largest difference between the motion in pictures and the commanded motion, over at most 10 mm
  /// of motion, mm.
  double max_drift_mm = 2.5;
  /// Largest motion of the line relative to the tip during a control, mm.
  double max_line_jump_mm = 1.5;

  /// @throws std::runtime_error naming file, line, key, the error and the valid values.
  static RobotConfig Load(const std::filesystem::path& file);

  /// Returns true if the robot is simulated: in this process, or by dvrk_simulator.
  [[nodiscard]] bool simulated() const noexcept {
    return robot == RobotPlace::kProcess || simulator;
  }
};

/// Returns the provenance of files created today with the robot of the configuration.
/// @throws std::runtime_error naming the key, arm.serial or camera.name, that a real robot requires
///   and the configuration does not set.
[[nodiscard]] core::Provenance ProvenanceOf(const RobotConfig& config);

/// Checks that `file` may be used with the robot of the configuration: files from simulation, or
/// without provenance, are for simulations; files from a robot are for the same arm and camera.
/// @param remedy  remedy for the error: "calibrate it ...".
/// @throws std::runtime_error naming both files, the key, both values and the remedy.
void CheckProvenance(const RobotConfig& config, const std::filesystem::path& file,
                     const core::Provenance& provenance, const std::string& remedy);

/// Checks that `calibration` matches the intrinsics named by the configuration, if any: the same
/// size, and focal lengths and principal point within 5 %.
/// @throws std::runtime_error naming both files and the difference, and as
/// hardware::ReadIntrinsics() does.
void CheckCamera(const RobotConfig& config, const line_task::LineCalibration& calibration);

}  // namespace dfr::apps::line_tracking
