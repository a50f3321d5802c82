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
  std::filesystem::path file = {};      ///< Demonstrations; empty: of `task`.
  std::filesystem::path failures = {};  ///< Further episodes, labelled in their file.
  bool unlike = false;                  ///< All episodes of `failures` count as failures.
  std::string task = "pick";            ///< A task of the gallery.
  std::string policy = "biased";        ///< Its policy in the further episodes.
  int demonstrations = 60;              ///< Of `task`.
  int episodes = 100;                   ///< Further ones of `task`.
  std::string features = {};            ///< As in a guard; empty: all, or the task's.
  double false_alarms = 0.1;            ///< Share of demonstrations that thresholds are set for.
  std::uint64_t seed = 1;
};

/// Demonstrations, and further episodes. Those that failed are not kCompleted.
struct DetectionSet {
  imitation::DemonstrationSet demonstrations;
  std::vector<core::Trajectory> further;
  std::string features;
};

/// Where to get demonstrations of others, for help texts.
[[nodiscard]] const char* DetectionSources() noexcept;

/// Reads the files, or runs the task's policy. Actions that are positions become differences.
/// @throws std::runtime_error as imitation::OpenDemonstrations(), also if a file does
///   not exist or their states differ.
[[nodiscard]] DetectionSet LoadDetection(const Detection& detection);

/// What a comparison finds.
struct DetectionReport {
  std::string text;  ///< Numbers of episodes, the guard's fit, and what was reduced and why.
  experiment::ReportTable table;  ///< A row for each detector.
};

/// Fits detectors to half of the demonstrations and sets thresholds by a fifth. The rest, and the
/// further episodes, judge them by the median duration of the fitted demonstrations. Features with
/// next to no left-out state inside are refused; large blocks of the state are then reduced to
/// principal components.
/// @throws std::invalid_argument if there are fewer than 10 demonstrations, or neither choice of
///   features fits.
[[nodiscard]] DetectionReport Detect(const DetectionSet& set, const Detection& detection);

}  // namespace dfr::study
