#include "support/check_fit.h"

#include <cmath>
#include <numbers>
#include <span>
#include <vector>

#include "dfr/core/contract.h"

namespace dfr::kernel::internal {
namespace {

void CheckFinite(const core::Matrix& samples, const Extent& extent) {
  if (extent.finite) return;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    for (Eigen::Index k = 0; k < samples.cols(); ++k) {
      DFR_THROW_UNLESS(std::isfinite(samples(i, k)), "sample " << i << ", entry " << k << " is "
                                                               << samples(i, k)
                                                               << "; all must be finite");
    }
  }
}

void CheckStart(std::span<const double> start, Eigen::Index samples) {
  if (start.empty()) return;
  DFR_THROW_UNLESS(
      static_cast<Eigen::Index>(start.size()) == samples,
      "the start has " << start.size() << " values of alpha for " << samples << " samples");
  double sum = 0.0;
  for (const double a : start) {
    DFR_THROW_UNLESS(a >= 0.0 && std::isfinite(a),
                     "alpha of the start must be finite and not negative: " << a);
    sum += a;
  }
  DFR_THROW_UNLESS(sum > 0.0 && std::isfinite(sum),
                   "alpha of the start must have a positive and finite sum, not " << sum);
}

void CheckWeights(const OneClassSvmOptions& options, Eigen::Index samples) {
  if (options.weights.empty()) return;
  DFR_THROW_UNLESS(
      static_cast<Eigen::Index>(options.weights.size()) == samples,
      "there are " << options.weights.size() << " weights for " << samples << " samples");
  DFR_THROW_UNLESS(options.start.empty(), "a fit with weights does not accept a start");
  double sum = 0.0;
  for (std::size_t i = 0; i < options.weights.size(); ++i) {
    const double w = options.weights[i];
    DFR_THROW_UNLESS(w >= 0.0 && std::isfinite(w), "the weight of sample "
                                                       << i << " is " << w
                                                       << "; it must be finite and not negative");
    sum += w;
  }
  DFR_THROW_UNLESS(sum > 0.0 && std::isfinite(sum),
                   "the weights must have a positive and finite sum, not " << sum);
}

}  // namespace

void CheckShapes(const core::Matrix& samples, const OneClassSvmOptions& options) {
  DFR_THROW_UNLESS(options.nu > 0.0 && options.nu <= 1.0,
                   "nu must lie in (0, 1], not " << options.nu);
  DFR_THROW_UNLESS(options.gamma > 0.0 && std::isfinite(options.gamma),
                   "gamma must be positive and finite, not " << options.gamma);
  DFR_THROW_UNLESS(options.tolerance > 0.0 && std::isfinite(options.tolerance),
                   "tolerance must be positive and finite, not " << options.tolerance);
  DFR_THROW_UNLESS(options.max_iterations >= 0,
                   "max_iterations must not be negative: " << options.max_iterations);
  DFR_THROW_UNLESS(options.memory_mib >= 1.0,
                   "memory_mib must be at least 1, not " << options.memory_mib);
  DFR_THROW_UNLESS(samples.rows() >= 2,
                   "a one-class SVM needs at least 2 samples; there are " << samples.rows());
  DFR_THROW_UNLESS(samples.cols() >= 1 && samples.cols() <= OneClassSvm::kMaxStateDim,
                   "a sample must have 1 to " << OneClassSvm::kMaxStateDim << " entries, not "
                                              << samples.cols());
  CheckStart(options.start, samples.rows());
  CheckWeights(options, samples.rows());
}

void CheckSamples(const core::Matrix& samples, const Extent& extent, double gamma) {
  CheckFinite(samples, extent);
  constexpr double kFar = 1e150;
  const double scale = std::sqrt(gamma * std::numbers::log2e);
  const double most = kFar / scale;
  if (extent.largest < 0.25 * most) return;
  const std::vector<double> center = Center(samples, extent, scale);
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    for (Eigen::Index k = 0; k < samples.cols(); ++k) {
      DFR_THROW_UNLESS(std::abs(samples(i, k) - center[static_cast<std::size_t>(k)]) < 0.5 * most,
                       "sample " << i << ", entry " << k << " is " << samples(i, k)
                                 << ": its distance to the others, in widths of the kernel with "
                                    "gamma "
                                 << gamma << ", overflows when squared. Leave the sample out");
    }
  }
}

}  // namespace dfr::kernel::internal
