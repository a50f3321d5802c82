#include "dfr/calibration/calibrate.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <iostream>
#include <numeric>
#include <optional>
#include <sstream>
#include <stdexcept>

#include "commands/commands.h"
#include "dfr/core/files/output_path.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/hardware/intrinsics_file.h"
#include "dfr/sim/line_tracking/calibration_motion.h"
#include "robot/robot_plant.h"
#include "robot/terminal.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

void PrintErrors(const char* name, std::vector<double> errors_mm) {
  std::sort(errors_mm.begin(), errors_mm.end());
  const double mean = std::accumulate(errors_mm.begin(), errors_mm.end(), 0.0) /
                      static_cast<double>(errors_mm.size());
  std::printf("%-22s %6.2f %6.2f %6.2f\n", name, mean, errors_mm[errors_mm.size() * 95 / 100],
              errors_mm.back());
}

// Approximate calibration of a robot, from its configuration.
line_task::LineCalibration Guess(const RobotConfig& config) {
  if (config.intrinsics.empty()) {
    throw std::runtime_error(config.file.string() +
                             ": camera.intrinsics is not set, but a robot's calibration needs it. "
                             "Set it to a camera calibration file written by OpenCV or ROS");
  }
  line_task::LineCalibration guess = sim::NominalCalibration();
  const Eigen::Isometry3d p_world_cam =
      config.p_world_cam.value_or(sim::LineTrackingPlant::p_world_base() * guess.p_base_cam);
  guess.camera = hardware::ReadIntrinsics(config.intrinsics);
  guess.p_base_cam = Base(config).inverse() * p_world_cam;
  guess.provenance = ProvenanceOf(config);
  return guess;
}

// Returns the calibration from these pictures. If it fails, informs the operator and returns
// nothing.
std::optional<line_task::LineCalibration> FromPictures(
    const std::vector<vision::CalibrationFrame>& frames, const line_task::LineCalibration& guess,
    const RobotConfig& config, runtime::AsyncPrinter& printer) {
  try {
    calibration::CalibrateOptions options;
    options.known_camera = true;
    calibration::CalibrationSummary summary;
    line_task::LineCalibration found =
        calibration::Calibrate(frames, line_task::StandardTarget().marks_m, guess,
                               (Base(config) * guess.p_base_cam).inverse(), options, &summary);
    std::ostringstream table;
    calibration::Print(table, found, summary);
    std::istringstream lines(table.str());
    for (std::string line; std::getline(lines, line);) printer.Say("%s\n", line.c_str());
    if (!summary.converged || !summary.has_covariance) {
      printer.Say("not calibrated: %s. Take more pictures at other poses\n",
                  summary.message.c_str());
      return std::nullopt;
    }
    found.provenance = guess.provenance;
    return found;
  } catch (const std::invalid_argument& e) {
    printer.Say("not calibrated: %s\n", e.what());
    return std::nullopt;
  }
}

// The operator moves arm and platform and triggers each picture. The program moves nothing.
void CalibrateRobot(const CalibrateOptions& options) {
  constexpr std::ptrdiff_t kTouching = 10;
  constexpr std::array<std::string_view, 3> kWords = {"", "t", "done"};
  const RobotConfig config = LoadRobot(options.config);
  const line_task::LineCalibration guess = Guess(config);
  const std::filesystem::path out = options.out.empty() ? config.calibration : options.out;
  const std::string unwritable = core::UnwritableFile(out, /*makes_folders=*/true);
  if (!unwritable.empty()) throw std::runtime_error(unwritable);
  Terminal terminal;
  runtime::AsyncPrinter& printer = terminal.printer();
  const std::unique_ptr<RobotPlant> plant = BringUpRobot(config, guess, nullptr, terminal);
  printer.Say(
      "Move the tip by teleoperation all over the gauze, up to 30 mm above it, and let it "
      "rest for each\npicture. The tip must touch the gauze in at least %td pictures, better in "
      "40.\n",
      kTouching);
  std::vector<vision::CalibrationFrame> frames;
  std::optional<line_task::LineCalibration> found;
  while (!found) {
    const std::ptrdiff_t touching = std::ranges::count_if(
        frames, [](const vision::CalibrationFrame& frame) { return frame.touching; });
    const std::optional<std::string> word = terminal.prompt().Answer(
        plant->loop(),
        core::Format(
            "%zu pictures; the tip touches the gauze in %td. Enter takes a picture, t takes "
            "one in which the tip touches, done calibrates",
            frames.size(), touching),
        kWords);
    if (!word) throw std::runtime_error("not calibrated: nothing was written");
    if (*word == "done" && touching < kTouching) {
      printer.Say("not calibrated: the tip has to touch the gauze in %td pictures\n", kTouching);
    } else if (*word == "done") {
      found = FromPictures(frames, guess, config, printer);
    } else {
      try {
        frames.push_back(plant->CaptureCalibrationFrame());
        frames.back().touching = *word == "t";
      } catch (const std::runtime_error& e) {
        printer.Say("  %s: no picture was taken\n", e.what());
      }
    }
  }
  if (out.has_parent_path()) std::filesystem::create_directories(out.parent_path());
  found->Save(out);
  printer.Say("%s written\n", out.c_str());
}

}  // namespace

line_task::LineCalibration LoadCalibration(const SceneOptions& scene) {
  if (scene.calibration != kNoCalibration) {
    if (!std::filesystem::exists(scene.calibration)) {
      throw std::runtime_error(scene.calibration.string() +
                               ": no such file. Run `line_tracking calibrate` first, or continue "
                               "with --calibration none: "
                               "the true camera and an uncorrected arm");
    }
    return line_task::LineCalibration::Load(scene.calibration);
  }
  line_task::LineCalibration known;
  known.camera = sim::LineTrackingPlant::true_camera();
  known.p_base_cam =
      sim::LineTrackingPlant::p_world_base().inverse() * sim::LineTrackingPlant::p_world_cam();
  return known;
}

line_task::LineCalibration LoadCalibration(const RobotConfig& config) {
  SceneOptions scene;
  scene.calibration = config.calibration;
  line_task::LineCalibration known = LoadCalibration(scene);
  if (config.calibration != kNoCalibration) {
    CheckProvenance(config, config.calibration, known.provenance,
                    "Calibrate this robot: line_tracking calibrate --config");
  } else if (!config.simulated()) {
    throw std::runtime_error(config.file.string() +
                             ": calibration is 'none', but a robot needs one. Create it with "
                             "line_tracking calibrate --config");
  }
  CheckCamera(config, known);
  return known;
}

void RunCalibrate(const CalibrateOptions& options) {
  if (!options.config.empty()) return CalibrateRobot(options);
  if (options.held_out < 1) throw std::invalid_argument("--held-out must be positive");
  calibration::CalibrationSummary summary;
  line_task::LineCalibration found =
      CalibratePlant(options.scene.plant, options.frames, options.seed, &summary);
  found.provenance.date = core::Today();
  calibration::Print(std::cout, found, summary);

  sim::LineTrackingOptions still = options.scene.plant;
  still.disturbance.wave = sim::Wave::kNone;
  still.observation = sim::Observation::kGroundTruth;
  sim::LineTrackingPlant plant(still);
  const std::uint64_t seed = core::DeriveSeed(options.seed, {1});
  std::cout << "tip errors at " << options.held_out << " held-out poses [mm]\n"
            << "                         mean   95 %    max\n";
  SceneOptions uncalibrated;
  uncalibrated.calibration = kNoCalibration;
  PrintErrors("arm without correction",
              sim::HeldOutTipErrors(plant, LoadCalibration(uncalibrated), options.held_out, seed));
  PrintErrors("calibrated", sim::HeldOutTipErrors(plant, found, options.held_out, seed));
  if (!summary.converged) {
    throw std::runtime_error("the calibration did not converge (" + summary.message +
                             "); nothing was written");
  }
  const std::filesystem::path out = options.out.empty() ? "calibration.dfr" : options.out;
  found.Save(out);
  std::cout << out.string() << " written\n";
}

}  // namespace dfr::apps::line_tracking
