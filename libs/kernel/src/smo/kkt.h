#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "dfr/kernel/one_class_svm.h"
#include "smo/smo_loop.h"

namespace dfr::kernel::internal {

/// Returns the indices of alpha > 0, ascending.
[[nodiscard]] inline std::vector<std::size_t> Support(std::span<const double> alpha) {
  // Branches would be unpredictable here.
  std::vector<std::size_t> support(alpha.size());
  std::size_t count = 0;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    support[count] = i;
    count += alpha[i] > 0.0 ? 1 : 0;
  }
  support.resize(count);
  return support;
}

/// Largest and smallest G of samples that may still move; gives the KKT gap and rho.
struct KktBounds {
  double largest = -std::numeric_limits<double>::infinity();  ///< over alpha > 0
  double smallest = std::numeric_limits<double>::infinity();  ///< over alpha below its bound, 1
  double free_sum = 0.0;
  std::size_t free = 0;
  double alpha_sum = 0.0;
  double weighted_sum = 0.0;

  KktBounds() = default;
  KktBounds(std::span<const double> alpha, std::span<const double> gradient)
      : KktBounds(alpha, gradient, Support(alpha)) {}
  /// Overload for known indices of alpha > 0, ascending.
  KktBounds(std::span<const double> alpha, std::span<const double> gradient,
            std::span<const std::size_t> support) {
    const Extremes extremes = FindExtremes(alpha.data(), gradient.data(), alpha.size());
    largest = extremes.largest;
    smallest = extremes.smallest;
    weighted_sum = extremes.finite;
    for (const std::size_t i : support) {
      const double a = alpha[i];
      const double g = gradient[i];
      free_sum += a < 1.0 ? g : 0.0;
      free += a < 1.0 ? 1 : 0;
      alpha_sum += a;
      weighted_sum += a * g;
    }
  }
  /// Returns the KKT gap; 0 if no alpha is below 1, as for nu = 1.
  [[nodiscard]] double gap() const {
    return std::isinf(smallest) ? 0.0 : std::max(0.0, largest - smallest);
  }
  /// Estimate of rho. Near a solution it is rho(). Far from a solution, where few alpha are free,
  /// the mean of G with weights alpha is a better estimate than the extremes.
  [[nodiscard]] double likely_rho() const {
    constexpr double kMostFree = 0.02;
    if (static_cast<double>(free) > kMostFree * alpha_sum || std::isinf(smallest)) return rho();
    return std::clamp(weighted_sum / alpha_sum, smallest, std::max(smallest, largest));
  }
  [[nodiscard]] double rho() const {
    if (free > 0) return free_sum / static_cast<double>(free);
    return std::isinf(smallest) ? largest : 0.5 * (largest + smallest);
  }
};

/// Returns alpha' G / 2.
[[nodiscard]] inline double Objective(std::span<const double> alpha,
                                      std::span<const double> gradient) {
  double sum = 0.0;
  for (std::size_t i = 0; i < alpha.size(); ++i) sum += alpha[i] * gradient[i];
  return 0.5 * sum;
}

/// Reports progress. Returns false if the fit must stop.
[[nodiscard]] inline bool GoOn(const OneClassSvmOptions& options, const FitSummary& summary) {
  return !options.progress ||
         options.progress({summary.iterations, summary.kkt_gap, options.tolerance});
}

/// Returns the number of iterations after which a fit ends.
[[nodiscard]] inline std::int64_t MostIterations(const OneClassSvmOptions& options,
                                                 std::size_t samples) {
  if (options.max_iterations > 0) return options.max_iterations;
  return std::max<std::int64_t>(10'000'000, 100 * static_cast<std::int64_t>(samples));
}

/// Decides after every round with an exact gradient whether another round follows.
class Rounds {
 public:
  Rounds(const OneClassSvmOptions& options, std::size_t samples, FitSummary& summary)
      : options_(options), summary_(summary), most_iterations_(MostIterations(options, samples)) {}

  /// Writes gap and objective to the summary. Returns true to continue; otherwise the summary has
  /// the reason.
  [[nodiscard]] bool Next(double gap, double objective) {
    summary_.kkt_gap = gap;
    summary_.objective = objective;
    // A NaN in G is neither largest nor smallest, but makes the objective NaN.
    if (gap < options_.tolerance && std::isfinite(objective)) {
      return End(FitSummary::Reason::kConverged);
    }
    if (interrupted_ || !Continue()) return End(FitSummary::Reason::kInterrupted);
    if (summary_.iterations >= most_iterations_) return End(FitSummary::Reason::kMaxIterations);
    // New samples may keep the gap large while the objective decreases.
    constexpr int kPatience = 10;
    const bool gain = gap < 0.9 * least_gap_ || objective < (1.0 - 1e-6) * least_objective_;
    without_gain_ = gain ? 0 : without_gain_ + 1;
    least_gap_ = std::min(least_gap_, gap);
    least_objective_ = std::min(least_objective_, objective);
    return without_gain_ <= kPatience || End(FitSummary::Reason::kStalled);
  }

  /// Takes up to `most` steps by calls of step(count), which takes up to `count` steps and returns
  /// their result. Reports progress in between.
  template <typename Step>
  void Take(std::int64_t most, Step&& step) {
    constexpr std::int64_t kBetweenReports = 1024;
    while (true) {
      const std::int64_t count =
          std::min({kBetweenReports, most, most_iterations_ - summary_.iterations});
      if (count <= 0 || interrupted_) return;
      const SmoSteps steps = step(count);
      summary_.iterations += steps.taken;
      most -= steps.taken;
      if (!steps.more || !Continue()) return;
    }
  }

  /// Reports progress. Returns false if the fit must stop.
  [[nodiscard]] bool Continue() {
    interrupted_ = interrupted_ || !GoOn(options_, summary_);
    return !interrupted_;
  }

  /// Records that the caller stopped the fit. The summary keeps the gap and objective of the last
  /// Next(); they become infinite if there was none.
  void Stop() {
    (void)End(FitSummary::Reason::kInterrupted);
    if (std::isfinite(least_gap_)) return;
    summary_.kkt_gap = std::numeric_limits<double>::infinity();
    summary_.objective = std::numeric_limits<double>::infinity();
  }

 private:
  bool End(FitSummary::Reason reason) {
    summary_.reason = reason;
    return false;
  }

  const OneClassSvmOptions& options_;
  FitSummary& summary_;
  std::int64_t most_iterations_;
  double least_gap_ = std::numeric_limits<double>::infinity();
  double least_objective_ = std::numeric_limits<double>::infinity();
  int without_gain_ = 0;
  bool interrupted_ = false;
};

}  // namespace dfr::kernel::internal
