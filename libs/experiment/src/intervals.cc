#include "dfr/experiment/intervals.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"

namespace dfr::experiment {
namespace {

void Check(int successes, int trials, double confidence) {
  DFR_THROW_UNLESS(trials > 0, "an interval needs at least one trial, not " << trials);
  DFR_THROW_UNLESS(successes >= 0 && successes <= trials,
                   successes << " successes do not fit into " << trials << " trials");
  DFR_THROW_UNLESS(confidence > 0.0 && confidence < 1.0,
                   "confidence must lie in (0, 1), not be " << confidence);
}

// Where an increasing function crosses zero in [low, high], to the last bit.
template <typename Function>
double Bisect(double low, double high, Function function) {
  while (true) {
    const double middle = low + 0.5 * (high - low);
    if (middle <= low || middle >= high) return middle;
    (function(middle) < 0.0 ? low : high) = middle;
  }
}

// z with P(|Z| <= z) = confidence, Z standard normal.
double NormalQuantile(double confidence) {
  return Bisect(0.0, 40.0,
                [&](double z) { return (1.0 - confidence) - std::erfc(z / std::sqrt(2.0)); });
}

// log of n over k. std::lgamma would write a global in glibc; these n are thousands, so a sum will
// do.
double LogChoose(int n, int k) {
  double sum = 0.0;
  for (int i = 1; i <= std::min(k, n - k); ++i) sum += std::log((n - i + 1.0) / i);
  return sum;
}

// Lower end of Clopper and Pearson: the p with P(X >= k) = tail for X binomial(n, p), 0 < k < n.
// It lies below k/n, where the probabilities of k, k + 1, ... fall, so that their sum is safe to
// take from the first term on.
double LowerEnd(int k, int n, double tail) {
  const double log_choose = LogChoose(n, k);
  return Bisect(0.0, static_cast<double>(k) / n, [&](double p) {
    const double odds = p / (1.0 - p);
    double term = 1.0;
    double sum = 1.0;
    for (int i = k; i < n && term > 1e-18 * sum; ++i) {
      term *= odds * (n - i) / (i + 1.0);
      sum += term;
    }
    const double log_first = log_choose + k * std::log(p) + (n - k) * std::log1p(-p);
    return log_first + std::log(sum) - std::log(tail);
  });
}

// Ends of the central `confidence` of the values, interpolated between order statistics.
Interval PercentileInterval(std::vector<double>& values, double confidence) {
  std::sort(values.begin(), values.end());
  const auto quantile = [&](double q) {
    const double position = q * static_cast<double>(values.size() - 1);
    const auto below = static_cast<std::size_t>(position);
    const std::size_t above = std::min(below + 1, values.size() - 1);
    const double weight = position - static_cast<double>(below);
    return (1.0 - weight) * values[below] + weight * values[above];
  };
  return {quantile(0.5 * (1.0 - confidence)), quantile(0.5 * (1.0 + confidence))};
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
  // At 0 and n one end is exact; rounding would leave it a bit off.
  return {successes == 0 ? 0.0 : centre - half, successes == trials ? 1.0 : centre + half};
}

Interval ClopperPearsonInterval(int successes, int trials, double confidence) {
  Check(successes, trials, confidence);
  const double tail = 0.5 * (1.0 - confidence);
  const auto lower = [&](int k) {
    if (k == 0) return 0.0;
    if (k == trials) return std::pow(tail, 1.0 / trials);
    return LowerEnd(k, trials, tail);
  };
  return {lower(successes), 1.0 - lower(trials - successes)};
}

Interval ProportionInterval(int successes, int trials, double confidence) {
  constexpr int kFew = 5;
  return std::min(successes, trials - successes) < kFew
             ? ClopperPearsonInterval(successes, trials, confidence)
             : WilsonInterval(successes, trials, confidence);
}

double McNemarExact(int only_first, int only_second) {
  DFR_THROW_UNLESS(only_first >= 0 && only_second >= 0,
                   "counts of pairs must not be negative: " << only_first << ", " << only_second);
  const int n = only_first + only_second;
  const int k = std::min(only_first, only_second);
  // P(X <= k) for X binomial(n, 1/2); from k downwards the terms fall.
  double term = 1.0;
  double sum = 1.0;
  for (int i = k; i > 0 && term > 1e-18 * sum; --i) {
    term *= i / (n - i + 1.0);
    sum += term;
  }
  return std::min(1.0, 2.0 * sum * std::exp(LogChoose(n, k) - n * std::log(2.0)));
}

PairedContrast EstimateContrast(std::span<const PairedCounts> units,
                                const BootstrapOptions& options) {
  DFR_THROW_UNLESS(options.resamples > 0, "resamples must be positive, not " << options.resamples);
  DFR_THROW_UNLESS(options.confidence > 0.0 && options.confidence < 1.0,
                   "confidence must lie in (0, 1), not be " << options.confidence);
  PairedContrast contrast;
  PairedCounts total;
  std::map<int, std::vector<PairedCounts>> strata;
  for (const PairedCounts& unit : units) {
    total = Sum(total, unit);
    strata[unit.stratum].push_back(unit);
  }
  const auto reduction = [](const PairedCounts& counts) {
    return 1.0 - static_cast<double>(counts.collided) / counts.reference_collided;
  };
  const auto ratio = [](const PairedCounts& counts) {
    return static_cast<double>(counts.completed) / counts.reference_completed;
  };
  if (total.reference_collided > 0) contrast.collision_reduction = reduction(total);
  if (total.reference_completed > 0) contrast.completion_ratio = ratio(total);
  const bool can_resample = std::any_of(
      strata.begin(), strata.end(), [](const auto& stratum) { return stratum.second.size() > 1; });
  if (!can_resample) return contrast;

  core::Random random(options.seed);
  std::vector<double> reductions;
  std::vector<double> ratios;
  for (int i = 0; i < options.resamples; ++i) {
    PairedCounts drawn;
    for (const auto& [name, stratum] : strata) {
      for (std::size_t k = 0; k < stratum.size(); ++k) {
        drawn = Sum(drawn, stratum[random.Below(stratum.size())]);
      }
    }
    if (drawn.reference_collided > 0) reductions.push_back(reduction(drawn));
    if (drawn.reference_completed > 0) ratios.push_back(ratio(drawn));
  }
  const auto enough = static_cast<std::size_t>(options.resamples / 2);
  if (contrast.collision_reduction && reductions.size() > enough) {
    contrast.collision_reduction_interval = PercentileInterval(reductions, options.confidence);
  }
  if (contrast.completion_ratio && ratios.size() > enough) {
    contrast.completion_ratio_interval = PercentileInterval(ratios, options.confidence);
  }
  return contrast;
}

}  // namespace dfr::experiment
