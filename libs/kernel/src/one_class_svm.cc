#include "dfr/kernel/one_class_svm.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "gaussian_sum.h"
#include "gaussian_terms.h"
#include "smo_solver.h"

namespace dfr::kernel {

static_assert(OneClassSvm::kMaxStateDim == internal::kMaxStateDim);

struct OneClassSvm::Data {
  core::Matrix support_vectors;
  Eigen::VectorXd alpha;
  double gamma;
  double rho;
  double libsvm_scale;
  internal::GaussianTerms<double> terms;
};

namespace {

constexpr double kOutside = -std::numeric_limits<double>::infinity();

bool AllFinite(std::span<const double> x) noexcept {
  // A non-finite entry makes its product with zero, and so the sum, NaN.
  double sum = 0.0;
  for (const double v : x) sum += 0.0 * v;
  return sum == 0.0;
}

void CheckSamples(const Eigen::Ref<const core::Matrix>& samples) {
  DFR_THROW_UNLESS(samples.rows() >= 2,
                   "a one-class SVM needs at least 2 samples; there are " << samples.rows());
  DFR_THROW_UNLESS(samples.cols() >= 1 && samples.cols() <= OneClassSvm::kMaxStateDim,
                   "a sample must have 1 to " << OneClassSvm::kMaxStateDim << " entries, not "
                                              << samples.cols());
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    for (Eigen::Index k = 0; k < samples.cols(); ++k) {
      DFR_THROW_UNLESS(std::isfinite(samples(i, k)), "sample " << i << ", entry " << k << " is "
                                                               << samples(i, k)
                                                               << "; all must be finite");
    }
  }
}

void CheckOptions(const OneClassSvmOptions& options) {
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
}

}  // namespace

OneClassSvm::OneClassSvm(std::shared_ptr<const Data> data) noexcept : data_(std::move(data)) {}

OneClassSvm OneClassSvm::Fit(const Eigen::Ref<const core::Matrix>& samples,
                             const OneClassSvmOptions& options, FitSummary* summary) {
  CheckOptions(options);
  CheckSamples(samples);
  const auto start = std::chrono::steady_clock::now();
  FitSummary result;
  const internal::DualSolution dual = internal::SolveDual(samples, options, result);

  std::vector<Eigen::Index> chosen;
  for (Eigen::Index i = 0; i < dual.alpha.size(); ++i) {
    if (dual.alpha[i] > 0.0) chosen.push_back(i);
  }
  core::Matrix support_vectors = samples(chosen, Eigen::all);
  Eigen::VectorXd alpha = dual.alpha(chosen);
  // nu m up to the rounding of the solver's steps.
  const double scale = alpha.sum();
  alpha /= scale;
  OneClassSvm svm = FromParts(std::move(support_vectors), std::move(alpha), options.gamma,
                              dual.rho / scale, scale);
  result.num_support_vectors = svm.num_support_vectors();
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (summary != nullptr) *summary = result;
  return svm;
}

OneClassSvm OneClassSvm::FromParts(core::Matrix support_vectors, Eigen::VectorXd alpha,
                                   double gamma, double rho, double libsvm_scale) {
  DFR_THROW_UNLESS(support_vectors.rows() >= 1, "there is no support vector");
  DFR_THROW_UNLESS(support_vectors.cols() >= 1 && support_vectors.cols() <= kMaxStateDim,
                   "a support vector must have 1 to " << kMaxStateDim << " entries, not "
                                                      << support_vectors.cols());
  DFR_THROW_UNLESS(alpha.size() == support_vectors.rows(),
                   alpha.size() << " alpha for " << support_vectors.rows() << " support vectors");
  DFR_THROW_UNLESS(support_vectors.allFinite(), "a support vector is not finite");
  DFR_THROW_UNLESS(alpha.allFinite() && (alpha.array() > 0.0).all(),
                   "alpha must be positive and finite");
  DFR_THROW_UNLESS(std::abs(alpha.sum() - 1.0) < 1e-9, "alpha must sum to 1, not " << alpha.sum());
  DFR_THROW_UNLESS(gamma > 0.0 && std::isfinite(gamma),
                   "gamma must be positive and finite, not " << gamma);
  DFR_THROW_UNLESS(std::isfinite(rho), "rho must be finite, not " << rho);
  DFR_THROW_UNLESS(libsvm_scale > 0.0 && std::isfinite(libsvm_scale),
                   "libsvm_scale must be positive and finite, not " << libsvm_scale);
  internal::GaussianTerms<double> terms(support_vectors, core::AsSpan(alpha), gamma);
  return OneClassSvm(std::make_shared<const Data>(Data{
      std::move(support_vectors), std::move(alpha), gamma, rho, libsvm_scale, std::move(terms)}));
}

double OneClassSvm::Decision(std::span<const double> x) const noexcept {
  const auto& terms = data_->terms;
  if (x.size() != terms.dim) return kOutside;
  double scaled[kMaxStateDim];
  if (!terms.Scale(x.data(), scaled)) return AllFinite(x) ? -data_->rho : kOutside;
  return internal::GaussianSum(terms, scaled) - data_->rho;
}

double OneClassSvm::Gradient(std::span<const double> x, std::span<double> gradient) const noexcept {
  const auto& terms = data_->terms;
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (x.size() != terms.dim || gradient.size() != terms.dim) return kOutside;
  double scaled[kMaxStateDim];
  if (!terms.Scale(x.data(), scaled)) return AllFinite(x) ? -data_->rho : kOutside;
  const double sum = internal::GaussianSumShift(terms, scaled, gradient.data());
  for (double& g : gradient) g *= 2.0 * data_->gamma / terms.scale;
  return sum - data_->rho;
}

double OneClassSvm::lipschitz_bound() const noexcept {
  return std::sqrt(2.0 * data_->gamma / std::numbers::e);
}

int OneClassSvm::state_dim() const noexcept { return static_cast<int>(data_->terms.dim); }
int OneClassSvm::num_support_vectors() const noexcept {
  return static_cast<int>(data_->terms.count);
}
const core::Matrix& OneClassSvm::support_vectors() const noexcept { return data_->support_vectors; }
const Eigen::VectorXd& OneClassSvm::alpha() const noexcept { return data_->alpha; }
double OneClassSvm::gamma() const noexcept { return data_->gamma; }
double OneClassSvm::rho() const noexcept { return data_->rho; }
double OneClassSvm::libsvm_scale() const noexcept { return data_->libsvm_scale; }

}  // namespace dfr::kernel
