#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

namespace dfr::experiment {

/// Confidence interval, both ends included.
struct Interval {
  double low = 0.0;
  double high = 0.0;
};

/// Wilson's score interval for a proportion of `successes` in `trials` independent trials. The
/// interval is short, and its coverage is correct on average over the unknown proportion.
/// @throws std::invalid_argument unless trials > 0, 0 <= successes <= trials and confidence lies in
///   (0, 1). The functions below check these arguments as well.
[[nodiscard]] Interval WilsonInterval(int successes, int trials, double confidence = 0.95);

/// Clopper and Pearson's interval, from binomial tails. Coverage is at least `confidence` for any
/// proportion. Use it for safety claims from few or no events: the upper end of the two-sided
/// interval for 0 events in n is 1 - (0.025)^(1/n).
[[nodiscard]] Interval ClopperPearsonInterval(int successes, int trials, double confidence = 0.95);

/// Interval used in tables: ClopperPearsonInterval() with fewer than 5 successes or failures, where
/// Wilson's normal approximation is least accurate, and WilsonInterval() with more.
[[nodiscard]] Interval ProportionInterval(int successes, int trials, double confidence = 0.95);

/// Counts of one independent unit of an experiment: a trial, whose episodes share demonstrations,
/// learner and supervisor.
struct ClusterCount {
  int successes = 0;
  int episodes = 0;
};

/// Interval of Korn and Graubard (Survey Methodology, 1998) for a proportion in clusters: Clopper
/// and Pearson's with the effective sample size p (1 - p) / v, where v is the variance of the
/// proportion p, estimated between clusters. This size is reduced for the degrees of freedom of the
/// estimate, and is at most the number of episodes. With one cluster, no success, or no failure,
/// the variance cannot be estimated and episodes count as independent. Ignores empty clusters.
/// @throws std::invalid_argument as WilsonInterval().
[[nodiscard]] Interval ClusteredInterval(std::span<const ClusterCount> clusters,
                                         double confidence = 0.95);

/// Exact conditional interval for the ratio of two rates with the same exposure: `events` given
/// events + reference_events is binomial, with odds equal to the ratio. Effective, non-integer
/// counts are allowed.
/// @throws std::invalid_argument unless events >= 0, reference_events > 0 and confidence lies in
///   (0, 1).
[[nodiscard]] Interval RateRatioInterval(double events, double reference_events,
                                         double confidence = 0.95);

/// Returns the number of episodes with which a paired comparison detects a difference with
/// probability `power`, at the two-sided level 1 - confidence (Connor, Biometrics 1987).
/// `only_first` and `only_second` are the fractions of start states at which exactly one of the two
/// methods fails.
/// @throws std::invalid_argument unless these fractions differ and add up to at most 1, power lies
///   in (0.5, 1) and confidence in (0, 1), or if the number exceeds an int.
[[nodiscard]] int EpisodesForDifference(double only_first, double only_second, double power = 0.8,
                                        double confidence = 0.95);
/// Returns the number of independent episodes, all without an event, that show an event rate below
/// `bound` by ClopperPearsonInterval(). @throws std::invalid_argument unless bound and confidence
/// lie in (0, 1), or if the number exceeds an int.
[[nodiscard]] int EpisodesForBound(double bound, double confidence = 0.95);

/// Numbers of pairs in one cluster in which exactly one of two methods fails.
struct DiscordantPairs {
  int only_first = 0;
  int only_second = 0;
};

/// McNemar's exact two-sided test for clustered pairs: pairs of one cluster may be dependent;
/// clusters are independent. Under the null hypothesis, each cluster's difference only_first -
/// only_second is equally likely with either sign. Returns the probability, over all signs, of a
/// sum at least as far from zero as the observed sum (the permutation test of Fisher, 1935, sec.
/// 21). With one pair per cluster, this is the exact test of unclustered pairs. With c clusters the
/// result is >= 2^(1-c).
/// @throws std::invalid_argument if a count is negative.
[[nodiscard]] double ClusteredMcNemar(std::span<const DiscordantPairs> clusters);

/// Mean of several curves at each index, and its standard error: 0 for a single curve.
struct MeanCurve {
  std::vector<double> mean;
  std::vector<double> standard_error;
};
/// Averages curves at the indices below `size`. A curve that has ended stays at its last value.
/// @throws std::invalid_argument if there is no curve, or one is empty.
[[nodiscard]] MeanCurve AverageCurves(std::span<const std::vector<double>> curves,
                                      std::size_t size);

/// Contribution of one independent unit to the two totals of a ratio.
struct RatioPart {
  double numerator = 0.0;
  double denominator = 0.0;
  int stratum = 0;  ///< Index of the stratum. Variances are about the stratum's mean.
};

/// Fieller's interval for the ratio of two totals over independent units (Fieller, J. R. Stat. Soc.
/// B, 1954): all ratios r that a t test of "numerator - r denominator is zero on average" does not
/// reject. The test has as many degrees of freedom as units minus strata. Unlike a percentile
/// bootstrap, the interval keeps its confidence level with five units. The lower end is at least 0.
/// Absent if no stratum has two units, or the denominator cannot be distinguished from zero.
/// @throws std::invalid_argument unless confidence lies in (0, 1).
[[nodiscard]] std::optional<Interval> RatioInterval(std::span<const RatioPart> units,
                                                    double confidence = 0.95);

/// Counts of two methods from the same start states, summed over one independent unit of an
/// experiment (a trial).
struct PairedCounts {
  int episodes = 0;  ///< Episodes per method.
  int completed = 0;
  int collided = 0;
  int reference_completed = 0;
  int reference_collided = 0;
  int stratum = 0;  ///< Index of the stratum. Variances are about the stratum's mean.
};

/// Comparison of a method with a reference. A value is absent if the reference has no event. An
/// interval is absent if RatioInterval() is absent, with one exception: a stratum has two units,
/// and the method has fewer than 5 events or the ratio does not vary between units. These data do
/// not determine a variance. The interval then also covers RateRatioInterval(), whose upper bound
/// uses the reference's events divided by their dispersion between units. If RatioInterval() is
/// absent, the interval is RateRatioInterval() alone.
struct PairedContrast {
  std::optional<double> collision_reduction;  ///< 1 - collisions / collisions of the reference
  std::optional<Interval> collision_reduction_interval;
  std::optional<double> completion_ratio;  ///< completions / completions of the reference
  std::optional<Interval> completion_ratio_interval;
};

/// Ratios of totals over all units, with RatioInterval() over whole units. Episodes of one trial
/// share the demonstrations and the learner, so episodes are not independent, whereas trials are.
/// @throws std::invalid_argument unless confidence lies in (0, 1).
[[nodiscard]] PairedContrast EstimateContrast(std::span<const PairedCounts> units,
                                              double confidence = 0.95);

}  // namespace dfr::experiment
