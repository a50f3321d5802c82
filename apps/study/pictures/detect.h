#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/experiment/report.h"
#include "dfr/imitation/demonstrations.h"

namespace dfr::study {

/// Options of `study detect`.
struct Detection {
  /// Files of demonstrations, all with the same layout; none: demonstrations of `task`.
  std::vector<std::filesystem::path> files = {};
  std::filesystem::path failures = {};  ///< Further episodes, labelled in their file.
  bool unlike = false;                  ///< All episodes of `failures` count as failures.
  std::string task = "pick";            ///< A task of the gallery.
  std::string policy = "biased";        ///< Policy of the further episodes of `task`.
  int demonstrations = 60;              ///< Number of demonstrations of `task`.
  int episodes = 100;                   ///< Number of further episodes of `task`.
  std::string features = {};            ///< Features as in a guard; empty: all, or the task's.
  /// Share of demonstrations that may raise a false alarm. It determines the thresholds.
  double false_alarms = 0.1;
  std::uint64_t seed = 1;
};

/// Demonstrations, and further episodes. Further episodes failed unless they are kCompleted.
struct DetectionSet {
  imitation::DemonstrationSet demonstrations;
  std::vector<core::Trajectory> further;
  std::string features;
};

/// Sources of published demonstrations, for help texts.
[[nodiscard]] const char* DetectionSources() noexcept;

/// Reads the files, or runs the task's policy. Actions that are positions become differences.
/// @throws std::runtime_error as imitation::OpenDemonstrations(), and if a file does not exist or
///   the layouts of two files differ.
[[nodiscard]] DetectionSet LoadDetection(const Detection& detection);

/// Result of a comparison.
struct DetectionReport {
  std::string text;  ///< Numbers of episodes, the guard's fit, and the reduction with its reason.
  experiment::ReportTable table;  ///< A row for each detector.
};

/// Fits detectors to half of the demonstrations and sets thresholds on a fifth. Evaluates them on
/// the rest and the further episodes, up to the median duration of the fitted demonstrations.
/// Features with almost no left-out state inside are rejected; large blocks of the state are then
/// reduced to principal components.
/// @throws std::invalid_argument if there are fewer than 10 demonstrations, or neither choice of
///   features fits.
[[nodiscard]] DetectionReport Detect(const DetectionSet& set, const Detection& detection);

}  // namespace dfr::study
