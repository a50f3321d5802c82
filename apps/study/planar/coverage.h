#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace dfr::study::planar {

/// Returns the worlds of MeasureCoverage(). "corridor": the task's demonstrations. "reach": 8
/// actions towards one goal in 6 dimensions, with rotation and noise. "heavy-tails": "reach" in 2
/// dimensions, with errors from Student's t with 3 degrees of freedom.
[[nodiscard]] const std::vector<std::string>& CoverageWorlds();

/// Options for MeasureCoverage().
struct CoverageOptions {
  std::string world = "corridor";
  int demonstrations = 20;
  double hold_out = 0.0;    ///< GuardOptions::hold_out
  double confidence = 0.0;  ///< GuardOptions::confidence
  double false_alarms = 0.2;
  int fits = 400;
  int further = 200;  ///< New demonstrations to evaluate each fit.
  std::uint64_t seed = 1;
};

/// Results of MeasureCoverage(): frequency with which the bounds of a fit hold for further
/// demonstrations.
struct CoverageResult {
  double promised = 0.0;    ///< GuardSummary::false_alarms
  double confidence = 0.0;  ///< GuardSummary::confidence
  double mean = 0.0;        ///< Rate of alarms, averaged over fits.
  double mean_error = 0.0;  ///< Standard error of `mean`.
  int kept = 0;             ///< Number of fits whose rate is at most `promised`.
  int error_short = 0;      ///< Number of fits whose eps covers a smaller share than promised.
  int gain_short = 0;       ///< Number of fits whose K covers a smaller share than promised.
  /// Probabilities that a fit counts in `kept`, and in `error_short` or `gain_short`, for exact
  /// bounds and `further` demonstrations, by the law of order statistics. Negative for
  /// cross-validation, which has no such law.
  double kept_chance = -1.0;
  double short_chance = -1.0;
};

/// Fits a guard `options.fits` times, each time to new demonstrations.
/// @throws std::invalid_argument naming the option out of range, or listing the valid worlds.
[[nodiscard]] CoverageResult MeasureCoverage(const CoverageOptions& options);

}  // namespace dfr::study::planar
