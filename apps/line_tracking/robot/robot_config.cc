#include "robot/robot_config.h"

#include <arpa/inet.h>
#include <toml++/toml.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <map>
#include <stdexcept>
#include <system_error>
#include <vector>

#include "dfr/core/files/toml_text.h"
#include "dfr/hardware/intrinsics_file.h"
#include "dfr/study/controller_factory.h"
#include "model.h"
#include "robot/config_section.h"

namespace dfr::apps::line_tracking {
namespace {

// Rejects the value of a key if check() throws.
template <typename Function>
void Check(const Section& section, const char* key, const std::string& wanted, Function check) {
  try {
    check();
  } catch (const std::invalid_argument& e) {
    section.Wrong(key, wanted + ": " + e.what());
  }
}

// Returns a pose from two keys; empty if both are missing.
std::optional<Eigen::Isometry3d> GetPose(Section& section, const char* position,
                                         const char* quaternion) {
  std::array<double, 3> place{};
  std::array<double, 4> turn{};
  const bool placed = section.Get(position, place);
  const bool turned = section.Get(quaternion, turn);
  if (placed != turned) {
    section.Wrong(placed ? position : quaternion, std::string("left out, unless both ") + position +
                                                      " and " + quaternion + " are given");
  }
  if (!placed) return std::nullopt;
  const Eigen::Quaterniond rotation(turn[3], turn[0], turn[1], turn[2]);
  if (!(std::abs(rotation.norm() - 1.0) < 1e-3)) section.Wrong(quaternion, "of length 1");
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = rotation.normalized().toRotationMatrix();
  pose.translation() = Eigen::Vector3d(place.data());
  return pose;
}

void GetRegion(Section& task, line_task::TipRegionOptions& region) {
  const auto check = [&](const char* key, const char* wanted) {
    try {
      region.Check();
    } catch (const std::invalid_argument&) {
      task.Wrong(key, wanted);
    }
  };
  task.Get("box_min_m", {region.box_min_m.data(), 3});
  task.Get("box_max_m", {region.box_max_m.data(), 3});
  check("box_max_m", "above box_min_m in every entry, and both must be finite");
  for (const std::vector<double>& row : task.Rows("forbidden_boxes_m", 6, "boxes")) {
    region.forbidden.emplace_back(Eigen::Vector3d(row.data()), Eigen::Vector3d(row.data() + 3));
  }
  check("forbidden_boxes_m", "boxes with their lower corner first");
  for (const std::vector<double>& row : task.Rows("planes", 4, "planes")) {
    region.planes.emplace_back(Eigen::Vector3d(row.data()), -row[3]);
  }
  check("planes", "planes whose normals have length 1");
}

void GetPlatform(Section& section, hardware::PlatformOptions& platform) {
  section.Get("device", platform.device);
  using Wave = std::optional<hardware::SprkWaveKind>;
  section.Get("wave", platform.wave,
              std::map<std::string, Wave>{{"none", std::nullopt},
                                          {"sine", hardware::SprkWaveKind::kSine},
                                          {"breath", hardware::SprkWaveKind::kBreath}});
  std::array<double, 6> amplitude{};
  section.Get("amplitude", amplitude);
  platform.motion.amplitude = {Eigen::Vector3d(amplitude.data()),
                               Eigen::Vector3d(amplitude.data() + 3)};
  section.Get("frequency_hz", {platform.motion.frequency_hz.data(), 6});
  if (!platform.wave) return;
  if (platform.device.empty()) section.Wrong("wave", "left out without platform.device");
  hardware::SprkWaveFrame frame;
  hardware::SprkWave sent;
  const hardware::SprkStatus status =
      hardware::EncodeSprkWave(*platform.wave, platform.motion, frame, sent);
  if (status != hardware::SprkStatus::kOk) {
    section.Wrong("amplitude",
                  std::string("feasible with its frequency_hz; it is ") + hardware::Name(status) +
                      ". Units: x, y, z in m; roll, pitch, yaw in rad; frequencies in Hz, "
                      "at most 0.99, for a breath 0.157");
  }
}

}  // namespace

RobotConfig RobotConfig::Load(const std::filesystem::path& file) {
  RobotConfig config;
  config.file = file;
  std::error_code error;
  if (!std::filesystem::exists(file, error)) {
    throw std::runtime_error(
        file.string() +
        ": the configuration does not exist. Examples are in "
        "apps/line_tracking/config, or in share/dfr/line_tracking of an installation");
  }
  config.text = core::ReadTomlText(file);
  toml::table root;
  try {
    root = toml::parse(core::CheckToml(file, config.text), file.string());
  } catch (const toml::parse_error& e) {
    Fail(file, e.source(), std::string(e.description()));
  }
  const toml::table none;
  Section top(config.file, root, "");
  const auto section = [&](const char* name) {
    const toml::table* table = top.Table(name);
    return Section(config.file, table == nullptr ? none : *table, name);
  };

  top.Get("robot", config.robot, {{"process", RobotPlace::kProcess}, {"dds", RobotPlace::kDds}});
  top.Get("model", config.model);
  top.Get("calibration", config.calibration);
  top.Get("method", config.method);
  Check(top, "method", "a method",
        [&] { static_cast<void>(study::ParseMethod(config.method, kRobotLineMethods)); });
  top.Get("recordings", config.recordings);

  Section network = section("network");
  network.Get("domain", config.network.domain, 0, 232);
  network.Get("discovery", config.network.discovery,
              {{"loopback", dds::Discovery::kLoopback},
               {"network", dds::Discovery::kNetwork},
               {"server", dds::Discovery::kServerClient}});
  network.Get("server", config.network.server_address);
  in_addr address{};
  if (inet_pton(AF_INET, config.network.server_address.c_str(), &address) != 1) {
    network.Wrong("server", "an IPv4 address such as \"127.0.0.1\"");
  }
  network.Get("security", config.network.security);
  network.End();

  Section arm = section("arm");
  arm.Get("name", config.arm);
  const auto named = [](unsigned char c) { return std::isalnum(c) != 0 || c == '_' || c == '/'; };
  if (config.arm.empty() || !std::ranges::all_of(config.arm, named)) {
    arm.Wrong("name", "the first part of the arm's topics: letters, digits, _ and /");
  }
  arm.Get("serial", config.arm_serial);
  config.p_world_base = GetPose(arm, "base_position_m", "base_quaternion_xyzw");
  hardware::PsmLimits& limits = config.arm_client.limits;
  arm.Get(
      "generation", limits.generation,
      {{"Classic", kinematics::PsmGeneration::kClassic}, {"Si", kinematics::PsmGeneration::kSi}});
  limits = hardware::PsmLimits::Of(limits.generation);
  arm.Get("workspace_min_m", {limits.workspace_min_m.data(), 3});
  arm.Get("workspace_max_m", {limits.workspace_max_m.data(), 3});
  if (!limits.workspace_min_m.allFinite() || !limits.workspace_max_m.allFinite() ||
      !(limits.workspace_min_m.array() < limits.workspace_max_m.array()).all()) {
    arm.Wrong("workspace_max_m", "above workspace_min_m in every entry, and both must be finite");
  }
  arm.Get("speed", config.speed_m_s, 1e-4, 0.05);
  arm.Get("max_tip_speed", limits.max_tip_speed, 1e-4, 0.2);
  // The tip's path is slightly curved, and therefore longer than its displacement.
  if (config.speed_m_s > 0.9 * limits.max_tip_speed) {
    arm.Wrong("speed", "at most 0.9 times max_tip_speed");
  }
  arm.Get("max_age_s", config.arm_client.watchdog.max_age_s, 0.001, 10.0);
  arm.Get("max_silence_s", config.arm_client.watchdog.max_silence_s, 0.001, 10.0);
  arm.Get("teleoperation", config.teleoperation);
  arm.Get("servo_cs", config.servo_cs);
  arm.Get("max_lag", config.arm_client.max_lag);
  arm.Get("rest_distance", config.arm_client.rest.max_distance);
  arm.Get("rest_speed", config.arm_client.rest.max_speed);
  arm.Get("reach_timeout_s", config.arm_client.reach_timeout_s, 0.1, 60.0);
  arm.Get("settle_s", config.arm_client.rest.settle_s, 0.0, 10.0);
  arm.End();

  Section task = section("task");
  GetRegion(task, config.region);
  task.Get("lift_m", config.lift_m, 0.0, 0.05);
  task.End();

  Section camera = section("camera");
  camera.Get("source", config.camera);
  camera.Get("name", config.camera_name);
  camera.Get("intrinsics", config.intrinsics);
  config.p_world_cam = GetPose(camera, "position_m", "quaternion_xyzw");
  camera.Get("max_age_s", config.image_max_age_s, 0.001, 10.0);
  camera.Get("latency_s", config.image_latency_s, 0.0, 1.0);
  camera.End();

  Section platform = section("platform");
  GetPlatform(platform, config.platform);
  if (!config.platform.device.empty() && config.robot == RobotPlace::kProcess) {
    platform.Wrong("device", "left out with robot = \"process\", whose platform is simulated");
  }
  platform.End();

  Section simulator = section("simulator");
  simulator.Get("present", config.simulator);
  simulator.Get("lock_step", config.lock_step);
  simulator.Get("answer_s", config.simulator_answer_s, 0.1, 86400.0);
  if (config.lock_step && !config.simulator) {
    simulator.Wrong("lock_step", "false without a simulator: simulator.present is not true");
  }
  simulator.End();

  Section stop = section("emergency_stop");
  stop.Get("required", config.emergency_stop);
  stop.Get("datagrams", config.emergency_stop_datagrams);
  stop.Get("max_silence_s", config.emergency_stop_silence_s, 0.05, 10.0);
  stop.End();

  Section loop = section("loop");
  loop.Get("period_s", config.period_s, 1e-3, 0.02);
  loop.Get("max_period_s", config.max_period_s, 2e-3, 10.0);
  loop.Get("priority", config.priority, 0, 98);
  loop.Get("max_state_jump_mm", config.max_state_jump_mm, 0.1, 100.0);
  loop.Get("max_drift_mm", config.max_drift_mm, 0.1, 100.0);
  loop.Get("max_line_jump_mm", config.max_line_jump_mm, 0.1, 100.0);
  if (config.max_period_s < 2.0 * config.period_s) {
    loop.Wrong("max_period_s", "at least twice period_s");
  }
  loop.End();
  top.End();
  config.arm_client.longest_step_s = config.period_s;
  return config;
}

core::Provenance ProvenanceOf(const RobotConfig& config) {
  core::Provenance provenance;
  provenance.origin = config.simulated() ? core::Origin::kSimulated : core::Origin::kReal;
  provenance.arm = config.arm;
  provenance.serial = config.arm_serial;
  provenance.camera = config.camera_name;
  provenance.date = core::Today();
  if (config.simulated()) return provenance;
  for (const auto& [key, value] : {std::pair("arm.serial", &provenance.serial),
                                   std::pair("camera.name", &provenance.camera)}) {
    if (!value->empty()) continue;
    throw std::runtime_error(config.file.string() + ": " + key +
                             " is not set, so this robot's files cannot be identified. Set it to "
                             "the text on the device");
  }
  return provenance;
}

void CheckProvenance(const RobotConfig& config, const std::filesystem::path& file,
                     const core::Provenance& provenance, const std::string& remedy) {
  const core::Provenance here = ProvenanceOf(config);
  const auto refuse = [&](const char* key, const std::string& was, const std::string& is,
                          const char* set_by) {
    const std::string date = provenance.date.empty() ? "" : " of " + provenance.date;
    const std::string by = config.file.empty() ? std::string("this run's")
                                               : config.file.string() + "'s (" + set_by + ")";
    throw std::runtime_error(file.string() + date + ": its " + key + " is '" + was + "', and " +
                             by + " is '" + is + "'. " + remedy);
  };
  if (config.simulated() && provenance.origin == core::Origin::kUnknown) return;
  if (provenance.origin != here.origin) {
    refuse("origin", core::Name(provenance.origin), core::Name(here.origin),
           config.robot == RobotPlace::kProcess ? "robot" : "simulator.present");
  }
  if (config.simulated()) return;
  if (provenance.arm != here.arm) refuse("arm", provenance.arm, here.arm, "arm.name");
  if (provenance.serial != here.serial) {
    refuse("serial", provenance.serial, here.serial, "arm.serial");
  }
  if (provenance.camera != here.camera) {
    refuse("camera", provenance.camera, here.camera, "camera.name");
  }
}

void CheckCamera(const RobotConfig& config, const line_task::LineCalibration& calibration) {
  if (config.intrinsics.empty()) return;
  const vision::CameraModel is = hardware::ReadIntrinsics(config.intrinsics);
  const vision::CameraModel& was = calibration.camera;
  constexpr double kAlike = 0.05;  // relative; calibrations change intrinsics by less
  const auto near = [](double a, double b, double scale) {
    return std::abs(a - b) <= kAlike * scale;
  };
  if (is.width == was.width && is.height == was.height && near(is.fx, was.fx, is.fx) &&
      near(is.fy, was.fy, is.fy) && near(is.cx, was.cx, is.width) &&
      near(is.cy, was.cy, is.height)) {
    return;
  }
  const auto words = [](const vision::CameraModel& camera) {
    std::ostringstream text;
    text << camera.width << " x " << camera.height << ", focal length " << camera.fx
         << " px, centre " << camera.cx << ", " << camera.cy << " px";
    return text.str();
  };
  throw std::runtime_error(config.calibration.string() + " is for another camera (" + words(was) +
                           "), not for that of " + config.intrinsics.string() + " (" + words(is) +
                           "); calibrate with the camera of this robot");
}

}  // namespace dfr::apps::line_tracking
