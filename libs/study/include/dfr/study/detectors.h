#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/study/fitted_task.h"

namespace dfr::study {

/// Detectors of states that are unlike the demonstrated ones:
///   "guard"         the guard's support, -l
///   "knn-distance"  mean squared distance to the 5 nearest states of nearby time steps
///   "mahalanobis"   distance from a Gaussian of nearby time steps
///   "rnd"           random network distillation (Burda et al., ICLR 2019): error of a network that
///                   learned the outputs of a random network in demonstrated states
///   "ensemble"      disagreement of EnsemblePolicy's members
/// The first three track the time step as the guard's alarm does. The last two do not depend on
/// time.
inline constexpr std::array<std::string_view, 5> kDetectors = {"guard", "knn-distance",
                                                               "mahalanobis", "rnd", "ensemble"};

/// Scores the states of an episode; a larger score is more unusual. Immutable.
class Detector {
 public:
  virtual ~Detector() = default;
  /// Returns one score per row.
  [[nodiscard]] virtual std::vector<double> Scores(const core::Matrix& states) const = 0;
};

/// Creates a detector. Borrows `fit` and the `demonstrations` to which the task was fitted. `seed`
/// initialises networks.
/// @throws std::invalid_argument naming an unknown detector and listing the valid ones.
[[nodiscard]] std::unique_ptr<const Detector> MakeDetector(
    std::string_view name, const FittedTask& fit, const imitation::DemonstrationSet& demonstrations,
    std::uint64_t seed);

/// Scores of an episode, with a failure flag.
struct ScoredEpisode {
  std::vector<double> scores;
  bool failed = false;
};

/// Counts of a detector's alarms, over episodes cut at the same time step.
struct DetectorRates {
  int failures = 0;
  int alarmed_failures = 0;
  int successes = 0;
  int alarmed_successes = 0;
  /// Number of controls from the alarm to the end, for each alarmed failure.
  std::vector<int> leads = {};

  /// Returns the mean of two fractions: failures with an alarm, and successes without an alarm.
  /// Absent if there is no failure or no success.
  [[nodiscard]] std::optional<double> balanced_accuracy() const noexcept;
  /// Returns the median of `leads`; absent if there are none.
  [[nodiscard]] std::optional<double> lead() const;
};

/// Returns the threshold that a further demonstration exceeds by time step `until` with a
/// probability of at most `alpha` (kernel::ConformalThreshold()). With too few demonstrations for
/// such a threshold, returns the highest score.
/// @throws std::invalid_argument if there are no episodes.
[[nodiscard]] double CalibratedThreshold(std::span<const ScoredEpisode> demonstrations, int until,
                                         double alpha);
/// Counts episodes with a score above `threshold` in time steps 0 to `until`. Later scores do not
/// count: long episodes have more time for an alarm, and failures are often long.
[[nodiscard]] DetectorRates RatesOf(std::span<const ScoredEpisode> episodes, double threshold,
                                    int until);

}  // namespace dfr::study
