#pragma once

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

/// What happened in one independent unit of an experiment: a trial, whose episodes share
/// demonstrations, learner and supervisor.
struct ClusterCount {
  int successes = 0;
  int episodes = 0;
};

/// The interval of Korn and Graubard (Survey Methodology, 1998) for a proportion in clusters:
/// Clopper and Pearson's with the effective sample size p (1 - p) / v, v the variance of the share
/// between clusters, and the degrees of freedom that so many clusters leave. It takes at most as
/// many episodes as there are. With one cluster, or without a success or without a failure, there
/// is no variance between clusters to see: then episodes count as independent.
/// @throws std::invalid_argument as above; clusters without episodes are left out.
[[nodiscard]] Interval ClusteredInterval(std::span<const ClusterCount> clusters,
                                         double confidence = 0.95);

/// The exact conditional interval for the ratio of two rates with the same exposure: `events`
/// given events + reference_events is binomial, with odds that are the ratio. Counts may be
/// effective ones, not whole.
/// @throws std::invalid_argument unless events >= 0 and reference_events > 0.
[[nodiscard]] Interval RateRatioInterval(double events, double reference_events,
                                         double confidence = 0.95);

/// Episodes from which a paired comparison finds a difference with probability `power`, two-sided
/// at 1 - confidence (Connor, Biometrics 1987): `only_first` and `only_second` are the shares of
/// start states at which just one of the two methods fails.
/// @throws std::invalid_argument unless these differ and add up to at most 1, and power lies in
///   (0.5, 1).
[[nodiscard]] int EpisodesForDifference(double only_first, double only_second, double power = 0.8,
                                        double confidence = 0.95);
/// Independent episodes without a single event that show, by ClopperPearsonInterval(), that events
/// are rarer than `bound`. @throws std::invalid_argument unless bound lies in (0, 1).
[[nodiscard]] int EpisodesForBound(double bound, double confidence = 0.95);

/// McNemar's exact test for pairs, two-sided: the probability, if both methods were equally likely
/// to be the one that fails where just one does, of a split at least as uneven as `only_first` to
/// `only_second`.
[[nodiscard]] double McNemarExact(int only_first, int only_second);

/// Pairs of one cluster in which just one of two methods fails.
struct DiscordantPairs {
  int only_first = 0;
  int only_second = 0;
};

/// McNemar's test for pairs in clusters, exact and two-sided: pairs of one cluster may depend on
/// each other, clusters do not. If the methods were alike, each cluster's difference only_first -
/// only_second would be as likely with the other sign; the result is the probability of a sum at
/// least as large over all signs (the permutation test of Fisher, 1935, sec. 21). With one pair a
/// cluster that is McNemarExact(). With c clusters it is at least 2^(1 - c).
/// @throws std::invalid_argument if a count is negative.
[[nodiscard]] double ClusteredMcNemar(std::span<const DiscordantPairs> clusters);

/// What one independent unit adds to the two totals of a ratio.
struct RatioPart {
  double numerator = 0.0;
  double denominator = 0.0;
  int stratum = 0;  ///< Units vary about the mean of their stratum.
};

/// Fieller's interval for the ratio of two totals over independent units (Fieller, J. R. Stat. Soc.
/// B, 1954): all ratios r that a t test of "numerator - r denominator is zero on average" does not
/// reject, with the degrees of freedom that so many units leave. Unlike a percentile bootstrap it
/// holds its confidence with five units. The lower end is at least 0. Absent where no stratum has
/// two units, or the denominator cannot be told from zero.
/// @throws std::invalid_argument unless confidence lies in (0, 1).
[[nodiscard]] std::optional<Interval> RatioInterval(std::span<const RatioPart> units,
                                                    double confidence = 0.95);

/// What two methods did from the same start states, summed over one independent unit of an
/// experiment (a trial).
struct PairedCounts {
  int episodes = 0;  ///< Episodes of each method.
  int completed = 0;
  int collided = 0;
  int reference_completed = 0;
  int reference_collided = 0;
  int stratum = 0;  ///< Units vary about the mean of their stratum.
};

/// A method against a reference. With fewer than 5 collisions of the method, of which a variance
/// says too little, the interval of the reduction includes RateRatioInterval()'s as well, with the
/// reference's collisions divided by their dispersion between units. Absent where the reference has
/// no event to divide by; an interval is absent too where RatioInterval() is, unless it is one of
/// fewer than 5 collisions and units can vary: then it is RateRatioInterval()'s alone.
struct PairedContrast {
  std::optional<double> collision_reduction;  ///< 1 - collisions / reference's
  std::optional<Interval> collision_reduction_interval;
  std::optional<double> completion_ratio;  ///< completions / reference's
  std::optional<Interval> completion_ratio_interval;
};

/// Ratios of totals over all units, with RatioInterval() over whole units: episodes of one trial
/// share demonstrations and learner, so they are not independent, whereas trials are.
/// @throws std::invalid_argument unless confidence lies in (0, 1).
[[nodiscard]] PairedContrast EstimateContrast(std::span<const PairedCounts> units,
                                              double confidence = 0.95);

}  // namespace dfr::experiment
