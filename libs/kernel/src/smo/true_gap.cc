#include "smo/true_gap.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "gaussian/gaussian_sum.h"
#include "gaussian/gaussian_terms.h"
#include "smo/kkt.h"

namespace dfr::kernel::internal {
namespace {

// Bound on the relative error of G at a sample at `distance` from the centre, in kernel widths
// (base 2).
//
// Rounding changes coordinates q and s by u |q| and u |s|, and therefore their difference. The
// exponent r^2 has an error of 2 r u (|q| + |s| + r), plus (d + 2) u r^2 from its sum. Because K
// sqrt(-log2 K) is concave, the relevant mean of r is at most sqrt(log2(sum of alpha / G)). exp2
// adds 5 u, and sums of up to 32 terms add 34 u. kChanges allows for the number of changes whose
// sum is G: the changes of alpha together exceed alpha.
template <typename T>
double RelativeError(double distance, double r, double dim) {
  constexpr double kUnit = 0.5 * std::numeric_limits<T>::epsilon();
  constexpr double kChanges = 3.0;
  const double exponent = 2.0 * r * (2.0 * distance + 2.0 * r) + (dim + 2.0) * r * r;
  return kChanges * kUnit * (std::numbers::ln2 * exponent + 39.0);
}

// Returns G of the `chosen` samples, in double.
std::vector<double> ExactGradient(const core::Matrix& samples, double gamma,
                                  std::span<const double> alpha,
                                  std::span<const std::size_t> chosen, bool far,
                                  core::Workers& workers) {
  std::vector<Eigen::Index> support;
  std::vector<double> weights;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    if (alpha[i] <= 0.0) continue;
    support.push_back(static_cast<Eigen::Index>(i));
    weights.push_back(alpha[i]);
  }
  const core::Matrix points = samples(support, Eigen::all);
  const SumTerms<double> terms(GaussianTerms<double>(points, weights, gamma));
  std::vector<double> gradient(chosen.size());
  // Number of samples that justify starting a thread.
  const std::size_t run_size = 32 + (std::size_t{1} << 18) / (support.size() + 1);
  workers.Run((chosen.size() + run_size - 1) / run_size, [&](std::size_t run) {
    std::vector<double> scaled(terms->dim);
    for (std::size_t q = run * run_size; q < std::min(chosen.size(), (run + 1) * run_size); ++q) {
      const auto x = core::Row(samples, static_cast<Eigen::Index>(chosen[q]));
      if (far) {
        gradient[q] = GaussianSumReference(points, weights, gamma, x);
      } else {
        (void)terms->Scale(x.data(), scaled.data());
        gradient[q] = GaussianSum(*terms, scaled.data());
      }
    }
  });
  return gradient;
}

}  // namespace

template <typename T>
double TrueGap(const core::Matrix& samples, const Extent& extent, const OneClassSvmOptions& options,
               std::span<const double> center, std::span<const double> alpha,
               std::span<const double> gradient, double neglected, core::Workers& workers) {
  const auto dim = static_cast<std::size_t>(samples.cols());
  const double total = options.nu * static_cast<double>(alpha.size());
  const double scale = std::sqrt(options.gamma * std::numbers::log2e);
  const auto distance = [&](std::size_t i) {
    const double* x = samples.data() + i * dim;
    double square = 0.0;
    for (std::size_t k = 0; k < dim; ++k) square += (x[k] - center[k]) * (x[k] - center[k]);
    return scale * std::sqrt(square);
  };
  // The first selection uses the same bounds on distance and r for all samples. r exceeds kMost
  // only if G is below 2^-64 of its maximum. The second selection uses the values of each remaining
  // sample.
  constexpr double kMost = 8.0;
  const double reach = 2.1 * scale * std::sqrt(static_cast<double>(dim)) * extent.largest;
  const double error_share = RelativeError<T>(reach, kMost, static_cast<double>(dim));
  const Extremes found = FindExtremes(alpha.data(), gradient.data(), alpha.size());
  const double least_largest = (1.0 - error_share) * found.largest - neglected;
  const double most_smallest = (1.0 + error_share) * found.smallest + neglected;
  std::vector<std::size_t> chosen(alpha.size());
  std::size_t count = 0;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    const double g = gradient[i];
    const bool largest = alpha[i] > 0.0 && (1.0 + error_share) * g + neglected >= least_largest;
    const bool smallest = alpha[i] < 1.0 && (1.0 - error_share) * g - neglected <= most_smallest;
    chosen[count] = i;
    count += largest || smallest ? 1 : 0;
  }
  chosen.resize(count);

  // Inner (likely_) and outer (extreme) bounds on the largest and the smallest G, given the errors
  // of G.
  constexpr double kNever = std::numeric_limits<double>::infinity();
  double likely_largest = -kNever;
  double likely_smallest = kNever;
  KktBounds extreme;
  std::vector<double> error(count);
  for (std::size_t q = 0; q < count; ++q) {
    const std::size_t i = chosen[q];
    const double g = gradient[i];
    const double r = std::sqrt(std::max(1.0, std::log2(total / std::clamp(g, 1e-18, total))));
    const double e = g * RelativeError<T>(distance(i), r, static_cast<double>(dim)) + neglected;
    error[q] = e;
    const double off = alpha[i] > 0.0 ? 0.0 : kNever;
    const double on = alpha[i] < 1.0 ? 0.0 : kNever;
    likely_largest = std::max(likely_largest, g - e - off);
    likely_smallest = std::min(likely_smallest, g + e + on);
    extreme.largest = std::max(extreme.largest, g + e - off);
    extreme.smallest = std::min(extreme.smallest, g - e + on);
  }
  if (extreme.gap() < options.tolerance) return extreme.gap();
  std::size_t kept = 0;
  for (std::size_t q = 0; q < count; ++q) {
    const std::size_t i = chosen[q];
    const bool largest = alpha[i] > 0.0 && gradient[i] + error[q] >= likely_largest;
    const bool smallest = alpha[i] < 1.0 && gradient[i] - error[q] <= likely_smallest;
    chosen[kept] = i;
    kept += largest || smallest ? 1 : 0;
  }
  chosen.resize(kept);

  // Beyond this distance from the centre, differences of doubles lose digits.
  constexpr double kFar = 1e6;
  bool far = false;
  for (std::size_t i = 0; reach > kFar && !far && i < alpha.size(); ++i) far = distance(i) > kFar;
  const std::vector<double> exact =
      ExactGradient(samples, options.gamma, alpha, chosen, far, workers);
  std::vector<double> chosen_alpha(chosen.size());
  for (std::size_t q = 0; q < chosen.size(); ++q) chosen_alpha[q] = alpha[chosen[q]];
  return KktBounds(chosen_alpha, exact).gap();
}

template double TrueGap<float>(const core::Matrix&, const Extent&, const OneClassSvmOptions&,
                               std::span<const double>, std::span<const double>,
                               std::span<const double>, double, core::Workers&);
template double TrueGap<double>(const core::Matrix&, const Extent&, const OneClassSvmOptions&,
                                std::span<const double>, std::span<const double>,
                                std::span<const double>, double, core::Workers&);

}  // namespace dfr::kernel::internal
