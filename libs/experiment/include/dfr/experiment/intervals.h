#pragma once

#include <cstdint>
#include <optional>
#include <span>

namespace dfr::experiment {

/// An interval of confidence, both ends included.
struct Interval {
  double low = 0.0;
  double high = 0.0;
};

/// Wilson's score interval for a proportion, `successes` of `trials` independent ones. Short, and
/// right on average over the unknown proportion; for cells of figures and tables.
/// @throws std::invalid_argument unless 0 <= successes <= trials, trials > 0, and confidence in
///   (0, 1). So do the functions below.
[[nodiscard]] Interval WilsonInterval(int successes, int trials, double confidence = 0.95);

/// Clopper and Pearson's interval, from binomial tails: covers at least with `confidence` whatever
/// the proportion is. For safety claims from few or no events; its two-sided upper end after 0 of
/// n is 1 - (0.025)^(1/n).
[[nodiscard]] Interval ClopperPearsonInterval(int successes, int trials, double confidence = 0.95);

/// What tables show: Clopper-Pearson with fewer than 5 successes or failures, where Wilson's
/// approximation by a normal law is at its worst, otherwise Wilson.
[[nodiscard]] Interval ProportionInterval(int successes, int trials, double confidence = 0.95);

/// McNemar's exact test for pairs, two-sided: the probability, if both methods were equally likely
/// to be the one that fails where just one does, of a split at least as uneven as `only_first` to
/// `only_second`.
[[nodiscard]] double McNemarExact(int only_first, int only_second);

/// What two methods did from the same start states, summed over one independent unit of an
/// experiment (a trial).
struct PairedCounts {
  int episodes = 0;  ///< Episodes of each method.
  int completed = 0;
  int collided = 0;
  int reference_completed = 0;
  int reference_collided = 0;
  int stratum = 0;  ///< Units are resampled among those of the same stratum.
};

struct BootstrapOptions {
  int resamples = 10'000;
  double confidence = 0.95;
  std::uint64_t seed = 0;
};

/// A method against a reference. Absent where the reference has no event to divide by; an interval
/// is absent too where that is so in more than half of the resamples, or where fewer than two units
/// were given.
struct PairedContrast {
  std::optional<double> collision_reduction;  ///< 1 - collisions / reference's
  std::optional<Interval> collision_reduction_interval;
  std::optional<double> completion_ratio;  ///< completions / reference's
  std::optional<Interval> completion_ratio_interval;
};

/// Ratios of totals over all units, with percentile intervals of a bootstrap that draws whole units
/// with replacement: episodes of one trial share demonstrations and learner, so that they are not
/// independent, whereas trials are.
[[nodiscard]] PairedContrast EstimateContrast(std::span<const PairedCounts> units,
                                              const BootstrapOptions& options);

}  // namespace dfr::experiment
