#include "dfr/experiment/intervals.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <map>
#include <set>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/log_gamma.h"

namespace dfr::experiment {
namespace {

void CheckConfidence(double confidence) {
  DFR_THROW_UNLESS(confidence > 0.0 && confidence < 1.0,
                   "confidence must lie in (0, 1), not " << confidence);
}

void Check(int successes, int trials, double confidence) {
  DFR_THROW_UNLESS(trials > 0, "an interval needs at least one trial, not " << trials);
  DFR_THROW_UNLESS(successes >= 0 && successes <= trials,
                   "successes must lie in [0, " << trials << "], not " << successes);
  CheckConfidence(confidence);
}

int NumEpisodes(double least) {
  DFR_THROW_UNLESS(least <= std::numeric_limits<int>::max(), "more than 2e9 episodes are needed");
  return static_cast<int>(std::ceil(least));
}

// Returns the zero of an increasing function in [low, high], to the last bit.
template <typename Function>
double Bisect(double low, double high, Function function) {
  while (true) {
    const double middle = low + 0.5 * (high - low);
    if (middle <= low || middle >= high) return middle;
    (function(middle) < 0.0 ? low : high) = middle;
  }
}

// Returns z with P(|Z| <= z) = confidence, Z standard normal.
double NormalQuantile(double confidence) {
  return Bisect(0.0, 40.0,
                [&](double z) { return (1.0 - confidence) - std::erfc(z / std::sqrt(2.0)); });
}

// The regularised incomplete beta function I_x(a, b) by its continued fraction (Lentz), which
// converges fast for x below the mean of the distribution.
double IncompleteBeta(double x, double a, double b) {
  if (x <= 0.0) return 0.0;
  if (x >= 1.0) return 1.0;
  if (x > (a + 1.0) / (a + b + 2.0)) return 1.0 - IncompleteBeta(1.0 - x, b, a);
  const double log_front = core::LogGamma(a + b) - core::LogGamma(a) - core::LogGamma(b) +
                           a * std::log(x) + b * std::log1p(-x) - std::log(a);
  constexpr int kMostTerms = 100'000;
  double c = 1.0;
  double d = 1.0 / (1.0 - (a + b) * x / (a + 1.0));
  double fraction = d;
  for (int m = 1; m < kMostTerms; ++m) {
    const double even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
    d = 1.0 / (1.0 + even * d);
    c = 1.0 + even / c;
    fraction *= c * d;
    const double odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
    d = 1.0 / (1.0 + odd * d);
    c = 1.0 + odd / c;
    fraction *= c * d;
    if (std::abs(1.0 - c * d) < 1e-15) break;
  }
  return std::exp(log_front) * fraction;
}

// Returns the q-quantile of the beta distribution, a and b > 0.
double BetaQuantile(double q, double a, double b) {
  return Bisect(0.0, 1.0, [&](double x) { return IncompleteBeta(x, a, b) - q; });
}

// Returns t with P(|T| <= t) = confidence, T Student-distributed with `degrees` degrees of freedom.
double StudentQuantile(double confidence, double degrees) {
  const double x = BetaQuantile(1.0 - confidence, 0.5 * degrees, 0.5);
  return std::sqrt(degrees * (1.0 - x) / x);
}

// Clopper and Pearson's interval for counts that need not be integers.
Interval BetaInterval(double successes, double trials, double confidence) {
  const double tail = 0.5 * (1.0 - confidence);
  const double failures = trials - successes;
  return {successes > 0.0 ? BetaQuantile(tail, successes, failures + 1.0) : 0.0,
          failures > 0.0 ? BetaQuantile(1.0 - tail, successes + 1.0, failures) : 1.0};
}

PairedCounts Sum(PairedCounts a, const PairedCounts& b) {
  a.episodes += b.episodes;
  a.completed += b.completed;
  a.collided += b.collided;
  a.reference_completed += b.reference_completed;
  a.reference_collided += b.reference_collided;
  return a;
}

}  // namespace

Interval WilsonInterval(int successes, int trials, double confidence) {
  Check(successes, trials, confidence);
  const double n = trials;
  const double p = successes / n;
  const double z = NormalQuantile(confidence);
  const double scale = 1.0 / (1.0 + z * z / n);
  const double centre = scale * (p + z * z / (2.0 * n));
  const double half = scale * z * std::sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n));
  // Without successes or failures one end is exact; rounding would shift it.
  return {successes == 0 ? 0.0 : centre - half, successes == trials ? 1.0 : centre + half};
}

Interval ClopperPearsonInterval(int successes, int trials, double confidence) {
  Check(successes, trials, confidence);
  return BetaInterval(successes, trials, confidence);
}

Interval ProportionInterval(int successes, int trials, double confidence) {
  constexpr int kFew = 5;
  return std::min(successes, trials - successes) < kFew
             ? ClopperPearsonInterval(successes, trials, confidence)
             : WilsonInterval(successes, trials, confidence);
}

Interval ClusteredInterval(std::span<const ClusterCount> clusters, double confidence) {
  ClusterCount all;
  int count = 0;
  for (const ClusterCount& cluster : clusters) {
    if (cluster.episodes == 0) continue;
    Check(cluster.successes, cluster.episodes, confidence);
    all.successes += cluster.successes;
    all.episodes += cluster.episodes;
    ++count;
  }
  Check(all.successes, all.episodes, confidence);
  const double n = all.episodes;
  const double p = all.successes / n;
  double squares = 0.0;
  for (const ClusterCount& cluster : clusters) {
    const double residual = cluster.successes - p * cluster.episodes;
    squares += residual * residual;
  }
  if (count < 2 || squares == 0.0) {
    return ClopperPearsonInterval(all.successes, all.episodes, confidence);
  }
  const double variance = squares * count / (count - 1.0) / (n * n);
  const double ratio =
      StudentQuantile(confidence, n - 1.0) / StudentQuantile(confidence, count - 1.0);
  const double effective = std::min(n, p * (1.0 - p) / variance * ratio * ratio);
  return BetaInterval(p * effective, effective, confidence);
}

Interval RateRatioInterval(double events, double reference_events, double confidence) {
  DFR_THROW_UNLESS(
      events >= 0.0 && reference_events > 0.0,
      "a ratio of rates needs events of the reference: " << events << " to " << reference_events);
  CheckConfidence(confidence);
  const Interval share = BetaInterval(events, events + reference_events, confidence);
  return {share.low / (1.0 - share.low), share.high / (1.0 - share.high)};
}

int EpisodesForDifference(double only_first, double only_second, double power, double confidence) {
  DFR_THROW_UNLESS(only_first >= 0.0 && only_second >= 0.0 && only_first != only_second &&
                       only_first + only_second <= 1.0,
                   "the shares of start states at which just one method fails must differ and add "
                   "up to at most 1: "
                       << only_first << " and " << only_second);
  DFR_THROW_UNLESS(power > 0.5 && power < 1.0, "power must lie in (0.5, 1), not " << power);
  CheckConfidence(confidence);
  const double sum = only_first + only_second;
  const double difference = only_first - only_second;
  // The one-sided quantile of `power` equals the two-sided quantile of 2 power - 1.
  const double root = NormalQuantile(confidence) * std::sqrt(sum) +
                      NormalQuantile(2.0 * power - 1.0) * std::sqrt(sum - difference * difference);
  return NumEpisodes(root * root / (difference * difference));
}

int EpisodesForBound(double bound, double confidence) {
  DFR_THROW_UNLESS(bound > 0.0 && bound < 1.0, "a bound must lie in (0, 1), not " << bound);
  CheckConfidence(confidence);
  return NumEpisodes(std::log(0.5 * (1.0 - confidence)) / std::log1p(-bound));
}

double ClusteredMcNemar(std::span<const DiscordantPairs> clusters) {
  std::int64_t sum = 0;
  std::vector<std::size_t> sizes;
  std::size_t total = 0;
  for (const DiscordantPairs& cluster : clusters) {
    DFR_THROW_UNLESS(cluster.only_first >= 0 && cluster.only_second >= 0,
                     "counts of pairs must not be negative: " << cluster.only_first << ", "
                                                              << cluster.only_second);
    const int difference = cluster.only_first - cluster.only_second;
    sum += difference;
    if (difference == 0) continue;
    sizes.push_back(static_cast<std::size_t>(std::abs(difference)));
    total += sizes.back();
  }
  // Entry s is the probability that the clusters with a positive sign sum to s. The sum of all
  // clusters is then 2 s - total.
  std::vector<double> probability(total + 1, 0.0);
  probability[0] = 1.0;
  for (const std::size_t size : sizes) {
    for (std::size_t s = total + 1; s-- > 0;) {
      probability[s] = 0.5 * (probability[s] + (s >= size ? probability[s - size] : 0.0));
    }
  }
  double p = 0.0;
  for (std::size_t s = 0; s <= total; ++s) {
    const std::int64_t other = 2 * static_cast<std::int64_t>(s) - static_cast<std::int64_t>(total);
    if (std::abs(other) >= std::abs(sum)) p += probability[s];
  }
  return std::min(1.0, p);
}

namespace {

// Returns the degrees of freedom of units about the means of their strata.
std::size_t Degrees(std::span<const RatioPart> units) {
  std::set<int> strata;
  for (const RatioPart& unit : units) strata.insert(unit.stratum);
  return units.size() - strata.size();
}

// Returns RatioInterval() of counts. With few events or without variation between units, the
// interval also covers RateRatioInterval(), which needs no variance.
std::optional<Interval> CountRatioInterval(std::span<const RatioPart> units, double confidence) {
  constexpr double kFew = 5.0;
  std::optional<Interval> interval = RatioInterval(units, confidence);
  if (Degrees(units) == 0) return interval;
  RatioPart total;
  for (const RatioPart& unit : units) {
    total.numerator += unit.numerator;
    total.denominator += unit.denominator;
  }
  // Rounding alone gives equal ratios an interval about 1e-8 wide.
  const bool varies = !interval || interval->high - interval->low > 1e-6 * interval->high;
  if (total.numerator >= kFew && varies) return interval;
  const auto n = static_cast<double>(units.size());
  const double mean = total.denominator / n;
  double squares = 0.0;
  for (const RatioPart& unit : units) {
    squares += (unit.denominator - mean) * (unit.denominator - mean);
  }
  const double dispersion = std::max(1.0, squares / (n - 1.0) / mean);
  // Dispersion only widens the interval: the lower bound omits it.
  const Interval exact{
      RateRatioInterval(total.numerator, total.denominator, confidence).low,
      RateRatioInterval(total.numerator, total.denominator / dispersion, confidence).high};
  if (!interval) return exact;
  return Interval{std::min(interval->low, exact.low), std::max(interval->high, exact.high)};
}

}  // namespace

std::optional<Interval> RatioInterval(std::span<const RatioPart> units, double confidence) {
  CheckConfidence(confidence);
  struct Stratum {
    int units = 0;
    double numerator = 0.0;
    double denominator = 0.0;
  };
  std::map<int, Stratum> strata;
  double numerator = 0.0;
  double denominator = 0.0;
  for (const RatioPart& unit : units) {
    Stratum& stratum = strata[unit.stratum];
    ++stratum.units;
    stratum.numerator += unit.numerator;
    stratum.denominator += unit.denominator;
    numerator += unit.numerator;
    denominator += unit.denominator;
  }
  // Variances and covariance of the two totals.
  double squares = 0.0;
  double products = 0.0;
  double denominator_squares = 0.0;
  for (const RatioPart& unit : units) {
    const Stratum& stratum = strata[unit.stratum];
    if (stratum.units < 2) continue;
    const double n = stratum.units;
    const double dy = unit.numerator - stratum.numerator / n;
    const double dx = unit.denominator - stratum.denominator / n;
    const double weight = n / (n - 1.0);
    squares += weight * dy * dy;
    products += weight * dx * dy;
    denominator_squares += weight * dx * dx;
  }
  const std::size_t degrees = Degrees(units);
  if (degrees == 0) return std::nullopt;
  const double t = StudentQuantile(confidence, static_cast<double>(degrees));
  // Solves (numerator - r denominator)^2 <= t^2 variance(r), written as a r^2 - 2 b r + c <= 0.
  const double a = denominator * denominator - t * t * denominator_squares;
  const double b = numerator * denominator - t * t * products;
  const double c = numerator * numerator - t * t * squares;
  if (!(a > 0.0)) return std::nullopt;
  const double root = std::sqrt(std::max(0.0, b * b - a * c));
  return Interval{std::max(0.0, (b - root) / a), std::max(0.0, (b + root) / a)};
}

MeanCurve AverageCurves(std::span<const std::vector<double>> curves, std::size_t size) {
  DFR_THROW_UNLESS(!curves.empty() && std::ranges::none_of(curves, &std::vector<double>::empty),
                   "a mean needs curves with values");
  const auto n = static_cast<double>(curves.size());
  MeanCurve average;
  for (std::size_t k = 0; k < size; ++k) {
    const auto sum = [&](const auto& term) {
      double total = 0.0;
      for (const auto& curve : curves) total += term(curve[std::min(k, curve.size() - 1)]);
      return total;
    };
    const double mean = sum([](double value) { return value; }) / n;
    const double squares = sum([=](double value) { return (value - mean) * (value - mean); });
    average.mean.push_back(mean);
    average.standard_error.push_back(std::sqrt(squares / (n * std::max(1.0, n - 1.0))));
  }
  return average;
}

PairedContrast EstimateContrast(std::span<const PairedCounts> units, double confidence) {
  PairedCounts total;
  std::vector<RatioPart> collided;
  std::vector<RatioPart> completed;
  for (const PairedCounts& unit : units) {
    total = Sum(total, unit);
    collided.push_back({static_cast<double>(unit.collided),
                        static_cast<double>(unit.reference_collided), unit.stratum});
    completed.push_back({static_cast<double>(unit.completed),
                         static_cast<double>(unit.reference_completed), unit.stratum});
  }
  PairedContrast contrast;
  if (total.reference_completed > 0) {
    contrast.completion_ratio = static_cast<double>(total.completed) / total.reference_completed;
    contrast.completion_ratio_interval = CountRatioInterval(completed, confidence);
  }
  if (total.reference_collided == 0) return contrast;
  contrast.collision_reduction =
      1.0 - static_cast<double>(total.collided) / total.reference_collided;
  const std::optional<Interval> ratio = CountRatioInterval(collided, confidence);
  if (ratio) contrast.collision_reduction_interval = Interval{1.0 - ratio->high, 1.0 - ratio->low};
  return contrast;
}

}  // namespace dfr::experiment
