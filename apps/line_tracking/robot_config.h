#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "dfr/core/provenance.h"
#include "dfr/dds/participant.h"
#include "dfr/hardware/psm_client.h"
#include "dfr/line_task/line_task.h"
#include "dfr/line_task/tip_region.h"
#include "platform_motion.h"

namespace dfr::apps::line_tracking {

/// Which robot a run drives.
enum class RobotPlace {
  kProcess,  ///< The simulation in this process.
  kDds,      ///< An arm behind a console on the network: dvrk_simulator's, or a real one.
};

/// A configuration file of `run --config`, in TOML; config/*.toml say what each key means. All that
/// is not set has the value here.
// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): in the order of the file
struct RobotConfig {
  std::filesystem::path file;  ///< For messages.
  std::string text;            ///< The whole file, for recordings.

  RobotPlace robot = RobotPlace::kProcess;
  std::filesystem::path model = "out/line_tracking/model";
  std::filesystem::path calibration = "out/line_tracking/calibration.dfr";
  std::string method = "guided";
  std::filesystem::path recordings = "out/line_tracking/recordings";  ///< Empty: none are made.

  // [network]
  dds::ParticipantOptions network = {.name = "line_tracking"};

  // [arm]
  std::string arm = "PSM1";
  std::string arm_serial;  ///< What tells this arm from others; a real one needs it.
  hardware::PsmClientOptions arm_client;
  std::vector<std::string> teleoperation;  ///< Topics that say so; empty: the usual ones.
  bool servo_cs = false;  ///< Set-points with their twist, where the console takes them.
  double speed_m_s = line_task::LineTask::kSpeed;  ///< The tip's, while a control is carried out.
  /// The arm's base in the world frame: the gauze's when nothing moves it. Absent: as in the
  /// simulation.
  std::optional<Eigen::Isometry3d> p_world_base;

  // [task]
  line_task::TipRegionOptions region;  ///< Where the tips may be on any way that is sent.
  double lift_m = 0.005;  ///< By how much the tool is lifted before it is turned upright.

  // [camera]
  std::string camera = "/ECM/image_raw";  ///< A DDS topic, a device, a file or a pipeline.
  std::string camera_name;  ///< What tells this camera from others; a real one needs it.
  /// The camera's intrinsics. A calibration on a robot takes them as they are; any other has to be
  /// of them. Empty: not looked at.
  std::filesystem::path intrinsics;
  /// Where the camera roughly is in the world frame, for a calibration to begin with: within 20 mm
  /// and 10 degrees. Absent: as in the simulation.
  std::optional<Eigen::Isometry3d> p_world_cam;
  double image_max_age_s = 0.1;  ///< By its stamp, and by its arrival.
  double image_latency_s = 0.0;  ///< What a stamp may be later than the light it shows.

  PlatformOptions platform;  // [platform]

  // [simulator]
  bool simulator = false;  ///< The console is dvrk_simulator's, which sets up episodes.
  bool lock_step = false;  ///< Its time goes on only when asked.
  /// How long its answers are waited for: drawing a picture may take a while.
  double simulator_answer_s = 5.0;

  // [emergency_stop]
  bool emergency_stop = true;
  double emergency_stop_silence_s = 0.06;
  bool emergency_stop_datagrams = true;  ///< It has to be heard in datagrams, too.

  // [loop]
  double period_s = 0.005;
  double max_period_s = 0.05;  ///< A later one is a fault.
  int priority = 20;           ///< SCHED_FIFO; 0: the usual scheduling.
  /// How much further than a control asked for the tip may seem to have moved, mm.
  double max_state_jump_mm = 3.0;
  /// How far pictures and encoders may disagree about the way of the last 10 mm, mm.
  double max_drift_mm = 2.5;
  /// How much further than the tip the line may move while a control is carried out, mm.
  double max_line_jump_mm = 1.5;

  /// @throws std::runtime_error naming file, line and key, what is wrong and what there is.
  static RobotConfig Load(const std::filesystem::path& file);

  /// Nobody is there whom it could hurt: the simulation in this process, or dvrk_simulator.
  [[nodiscard]] bool simulated() const noexcept {
    return robot == RobotPlace::kProcess || simulator;
  }
};

/// What files say that are made today with the robot of the configuration.
/// @throws std::runtime_error naming the key that a real robot has to have, arm.serial or
///   camera.name, if it is not set.
[[nodiscard]] core::Provenance ProvenanceOf(const RobotConfig& config);

/// Whether what `file` holds may drive the robot of the configuration: what was made in simulation
/// is for simulations, which take what says nothing, too; what was made on a robot is for the same
/// arm and camera.
/// @param remedy  what to do if not: "calibrate it ...".
/// @throws std::runtime_error naming both files, the key, both values and the remedy.
void CheckProvenance(const RobotConfig& config, const std::filesystem::path& file,
                     const core::Provenance& provenance, const std::string& remedy);

/// Whether `calibration` is of the camera whose intrinsics the configuration names, if it does:
/// its size, and focal lengths and principal point within 5 % of them.
/// @throws std::runtime_error naming both files and what differs; as hardware::ReadIntrinsics().
void CheckCamera(const RobotConfig& config, const line_task::LineCalibration& calibration);

}  // namespace dfr::apps::line_tracking
