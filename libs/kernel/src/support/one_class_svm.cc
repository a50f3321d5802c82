#include "dfr/kernel/one_class_svm.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <new>
#include <numbers>
#include <type_traits>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/workers.h"
#include "gaussian/gaussian_sum.h"
#include "gaussian/gaussian_terms.h"
#include "gaussian/sum_block.h"
#include "smo/kkt.h"
#include "smo/smo_solver.h"
#include "smo/weighted_dual.h"
#include "support/check_fit.h"
#include "support/fit_sharing.h"
#include "support/nu_sum.h"

namespace dfr::kernel {

static_assert(OneClassSvm::kMaxStateDim == internal::kMaxStateDim);

// Memory of the decision function's data, and the data that its evaluation does not read.
struct OneClassSvm::Parts {
  core::Matrix support_vectors;
  Eigen::VectorXd alpha;
  internal::AlignedVector<internal::CacheLine> memory;
};

// All data that an evaluation reads are in one block of memory: this cache line, then a SumBlock.
struct alignas(64) OneClassSvm::Data {
  double rho;
  double log_rho;
  double gamma;
  double libsvm_scale;
  bool single;  // True if the block is a SumBlock<float>, false if it is a SumBlock<double>.
  const Parts* parts;
  const void* sum_code;    // code of Decision() and LogDecision()
  const void* shift_code;  // code of the gradients, to prefetch

  template <typename T>
  [[nodiscard]] const internal::SumBlock<T>& sum() const noexcept {
    return *reinterpret_cast<const internal::SumBlock<T>*>(this + 1);
  }

  // Returns an estimate in the precision of `terms` whose rho and log_rho remain to be set.
  template <typename T>
  static std::shared_ptr<Data> Make(const internal::GaussianTerms<T>& terms,
                                    core::Matrix support_vectors, Eigen::VectorXd alpha,
                                    double gamma, double libsvm_scale) {
    auto parts = std::make_shared<Parts>();
    parts->support_vectors = std::move(support_vectors);
    parts->alpha = std::move(alpha);
    parts->memory.resize(sizeof(Data) / sizeof(internal::CacheLine) +
                         internal::SumBlock<T>::Lines(terms));
    auto* data =
        ::new (static_cast<void*>(parts->memory.data())) Data{.rho = 0.0,
                                                              .log_rho = 0.0,
                                                              .gamma = gamma,
                                                              .libsvm_scale = libsvm_scale,
                                                              .single = std::is_same_v<T, float>,
                                                              .parts = parts.get(),
                                                              .sum_code = nullptr,
                                                              .shift_code = nullptr};
    const auto& functions = internal::SumBlock<T>::Write(terms, data + 1).functions;
    data->sum_code = reinterpret_cast<const void*>(functions.sum);
    data->shift_code = reinterpret_cast<const void*>(functions.sum_shift);
    return {std::move(parts), data};
  }
};

namespace {

constexpr double kOutside = -std::numeric_limits<double>::infinity();

[[gnu::cold, gnu::noinline]] double OutsideOrFar(std::span<const double> x, double far) noexcept {
  return core::AllFinite(x) ? far : kOutside;
}

// Returns one decision in the precision of `terms`, for states of at most kCapacity entries. `x`
// must have the right size.
template <int kCapacity, typename T>
[[gnu::hot, gnu::noinline]] double DecideWithin(const internal::SumBlock<T>& terms, double rho,
                                                std::span<const double> x) noexcept {
  T scaled[kCapacity];
  if (!terms.Scale(x.data(), scaled)) [[unlikely]] {
    return OutsideOrFar(x, -rho);
  }
  return static_cast<double>(internal::GaussianSum(terms, scaled)) - rho;
}

// Returns the sum of all terms for a state of the right size.
double SumAt(const internal::SumBlock<double>& terms, std::span<const double> x) noexcept {
  return DecideWithin<internal::kMaxStateDim>(terms, 0.0, x);
}

double LogOfRho(double rho) { return rho > 0.0 ? std::log(rho) : kOutside; }

// Prefetches kLines cache lines, the first of them kOffset bytes after `start`. Always inline: GCC
// drops calls whose only effect is to prefetch.
template <int kLines, int kOffset = 0>
[[gnu::always_inline]] inline void Prefetch(const void* start) noexcept {
  const auto address = reinterpret_cast<std::uintptr_t>(start) + kOffset;
#pragma GCC unroll 16
  for (std::uintptr_t k = 0; k < kLines; ++k) {
    // The address may lie beyond the object, where pointer arithmetic is undefined.
    // NOLINTNEXTLINE(performance-no-int-to-ptr)
    __builtin_prefetch(reinterpret_cast<const void*>(address + 64 * k));
  }
}

// States of up to this size, the usual case, use a part of the stack that is in the cache.
constexpr int kSmallState = 64;

// Prefetches the data of a decision into a cold cache: the constants of 2^e, the start of the block
// of the estimate `data` and the code that sums its terms. Cache misses then overlap. Processors
// fetch the rest of a page ahead, but not the next page.
[[gnu::always_inline]] inline void PrefetchBlock(const void* data, const void* code) noexcept {
  Prefetch<2>(&internal::kExp2Double);
  Prefetch<1>(&internal::kExp2Float);
  Prefetch<6>(data);
  Prefetch<1, 4096>(data);
  Prefetch<16>(code);
}

// Prefetches the code of std::log().
[[gnu::always_inline]] inline void PrefetchLog() noexcept {
  Prefetch<4>(reinterpret_cast<const void*>(static_cast<double (*)(double)>(&std::log)));
}

template <typename T>
double Decide(const internal::SumBlock<T>& terms, double rho, std::span<const double> x) noexcept {
  if (x.size() != terms.dim) return kOutside;
  if (x.size() > kSmallState) [[unlikely]] {
    return DecideWithin<internal::kMaxStateDim>(terms, rho, x);
  }
  return DecideWithin<kSmallState>(terms, rho, x);
}

// A sum below this value may have lost terms to underflow. It is recomputed relative to its largest
// term.
template <typename T>
constexpr T kSmallSum = sizeof(T) == sizeof(double) ? T(1e-280) : T(1e-25);

// Returns log(sum), for states of at most kCapacity entries. `x` must have the right size.
template <int kCapacity, typename T>
double LogSumWithin(const internal::SumBlock<T>& terms, std::span<const double> x) noexcept {
  T scaled[kCapacity];
  if (!terms.Scale(x.data(), scaled)) return kOutside;
  const T sum = internal::GaussianSum(terms, scaled);
  if (sum > kSmallSum<T>) return std::log(static_cast<double>(sum));
  T unused[kCapacity];
  const T largest = internal::LargestExponent(terms, scaled);
  const T shifted = internal::GaussianSumShift(terms, scaled, -largest, unused);
  return std::log(static_cast<double>(shifted)) + std::numbers::ln2 * largest;
}

template <typename T>
double LogSum(const internal::SumBlock<T>& terms, std::span<const double> x) noexcept {
  PrefetchLog();
  if (x.size() != terms.dim) return kOutside;
  return x.size() <= kSmallState ? LogSumWithin<kSmallState>(terms, x)
                                 : LogSumWithin<internal::kMaxStateDim>(terms, x);
}

// Returns log(sum) and writes sum_i w_i (x_i - x) to `mean_shift`, for states of at most kCapacity
// entries.
template <int kCapacity, typename T>
double LogSumShiftWithin(const internal::SumBlock<T>& terms, std::span<const double> x,
                         std::span<double> mean_shift) noexcept {
  T scaled[kCapacity];
  T shift[kCapacity];
  if (!terms.Scale(x.data(), scaled)) return kOutside;
  double offset = 0.0;
  T sum = internal::GaussianSumShift(terms, scaled, T{0}, shift);
  if (!(sum > kSmallSum<T>)) {
    const T largest = internal::LargestExponent(terms, scaled);
    sum = internal::GaussianSumShift(terms, scaled, -largest, shift);
    offset = std::numbers::ln2 * largest;
  }
  if (!(sum > 0)) return kOutside;
  const double unscale = 1.0 / (static_cast<double>(sum) * terms.scale);
  for (std::size_t k = 0; k < terms.dim; ++k) mean_shift[k] = unscale * shift[k];
  return std::log(static_cast<double>(sum)) + offset;
}

template <typename T>
double LogSumShift(const internal::SumBlock<T>& terms, std::span<const double> x,
                   std::span<double> mean_shift) noexcept {
  PrefetchLog();
  if (x.size() != terms.dim || mean_shift.size() != terms.dim) return kOutside;
  return x.size() <= kSmallState ? LogSumShiftWithin<kSmallState>(terms, x, mean_shift)
                                 : LogSumShiftWithin<internal::kMaxStateDim>(terms, x, mean_shift);
}

// Returns g and writes its gradient, for states of at most kCapacity entries.
template <int kCapacity, typename T>
double GradientWithin(const internal::SumBlock<T>& terms, double rho, double gamma,
                      std::span<const double> x, std::span<double> gradient) noexcept {
  T scaled[kCapacity];
  T shift[kCapacity];
  if (!terms.Scale(x.data(), scaled)) return OutsideOrFar(x, -rho);
  const T sum = internal::GaussianSumShift(terms, scaled, T{0}, shift);
  const double factor = 2.0 * gamma / terms.scale;
  for (std::size_t k = 0; k < terms.dim; ++k) gradient[k] = factor * shift[k];
  return static_cast<double>(sum) - rho;
}

template <typename T>
double GradientOf(const internal::SumBlock<T>& terms, double rho, double gamma,
                  std::span<const double> x, std::span<double> gradient) noexcept {
  if (x.size() != terms.dim || gradient.size() != terms.dim) return kOutside;
  return x.size() <= kSmallState
             ? GradientWithin<kSmallState>(terms, rho, gamma, x, gradient)
             : GradientWithin<internal::kMaxStateDim>(terms, rho, gamma, x, gradient);
}

template <typename T>
void DecideBatch(const internal::SumBlock<T>& terms, double rho,
                 const Eigen::Ref<const core::Matrix>& x, std::span<double> g) noexcept {
  constexpr std::size_t kMostQueries = 64;
  T scaled[2 * internal::kMaxStateDim];
  T sums[kMostQueries];
  bool near[kMostQueries];
  const std::size_t together =
      std::clamp<std::size_t>(std::size(scaled) / terms.dim, 1, kMostQueries);
  const auto row = [&](std::size_t i) {
    return std::span(x.data() + static_cast<Eigen::Index>(i) * x.outerStride(), terms.dim);
  };
  for (std::size_t first = 0; first < g.size(); first += together) {
    const std::size_t count = std::min(together, g.size() - first);
    for (std::size_t q = 0; q < count; ++q) {
      T* query = scaled + q * terms.dim;
      near[q] = terms.Scale(row(first + q).data(), query);
      if (!near[q]) std::fill_n(query, terms.dim, T{0});
    }
    internal::GaussianSums(terms, scaled, count, sums);
    for (std::size_t q = 0; q < count; ++q) {
      g[first + q] =
          near[q] ? static_cast<double>(sums[q]) - rho : OutsideOrFar(row(first + q), -rho);
    }
  }
}

}  // namespace

OneClassSvm::OneClassSvm(std::shared_ptr<const Data> data) noexcept : data_(std::move(data)) {}

OneClassSvm OneClassSvm::Fit(const Eigen::Ref<const core::Matrix>& samples,
                             const OneClassSvmOptions& options, FitSummary* summary) {
  // Small fits of one thread share memory. A fit that `progress` starts during another fit uses
  // separate memory.
  constexpr std::size_t kMostKept = std::size_t{1} << 19;
  thread_local internal::Scratch kept;
  internal::Scratch scratch = std::exchange(kept, internal::Scratch());
  // std::copy_n() moves more bytes at a time than Eigen.
  core::Matrix copy(samples.rows(), samples.cols());
  if (samples.outerStride() == samples.cols()) {
    std::copy_n(samples.data(), samples.size(), copy.data());
  } else {
    copy = samples;
  }
  OneClassSvm svm = internal::FitSharing(copy, options, scratch, summary);
  if (scratch.bytes() <= kMostKept) kept = std::move(scratch);
  return svm;
}

OneClassSvm internal::FitSharing(const core::Matrix& samples, const OneClassSvmOptions& options,
                                 Scratch& scratch, FitSummary* summary) {
  CheckShapes(samples, options);
  const Extent extent(samples);
  CheckSamples(samples, extent, options.gamma);
  const auto start = std::chrono::steady_clock::now();
  FitSummary result;
  result.kkt_gap = std::numeric_limits<double>::infinity();
  OneClassSvmOptions solved = options;
  const NuSum sum = SumOf(options, samples.rows());
  if (sum.ratio < 1.0) solved.nu = sum.solved / sum.samples;
  solved.tolerance *= std::min(1.0, sum.solved);
  const DualSolution dual = options.weights.empty()
                                ? SolveDual(samples, extent, solved, scratch, result)
                                : SolveWeightedDual(samples, solved, result);

  const std::vector<std::size_t> chosen = Support(core::AsSpan(dual.alpha));
  core::Matrix support_vectors(static_cast<Eigen::Index>(chosen.size()), samples.cols());
  Eigen::VectorXd alpha(support_vectors.rows());
  for (Eigen::Index k = 0; k < alpha.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(chosen[static_cast<std::size_t>(k)]);
    std::copy_n(samples.data() + i * samples.cols(), samples.cols(),
                support_vectors.data() + k * samples.cols());
    alpha[k] = dual.alpha[i];
  }
  // Equals nu m up to the rounding of the solver's steps.
  const double scale = alpha.sum();
  alpha /= scale;
  const GaussianTerms<double> terms(support_vectors, core::AsSpan(alpha), options.gamma);
  const auto data = OneClassSvm::Data::Make(terms, std::move(support_vectors), std::move(alpha),
                                            options.gamma, scale * sum.ratio);
  data->rho = dual.rho / scale;
  for (const DualSolution::RhoSample& s : dual.rho_samples) {
    const double exact = SumAt(data->sum<double>(), core::Row(samples, s.sample));
    data->rho += (exact - s.gradient / scale) / static_cast<double>(dual.rho_samples.size());
  }
  data->log_rho = LogOfRho(data->rho);
  result.num_support_vectors = static_cast<int>(chosen.size());
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  result.alpha = dual.alpha / scale;
  result.kkt_gap *= sum.ratio;
  result.objective *= sum.ratio * sum.ratio;
  if (summary != nullptr) *summary = std::move(result);
  return OneClassSvm(data);
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
  const internal::GaussianTerms<double> terms(support_vectors, core::AsSpan(alpha), gamma);
  const auto data =
      Data::Make(terms, std::move(support_vectors), std::move(alpha), gamma, libsvm_scale);
  data->rho = rho;
  data->log_rho = LogOfRho(rho);
  return OneClassSvm(data);
}

OneClassSvm OneClassSvm::InSinglePrecision() const {
  const internal::GaussianTerms<float> terms(support_vectors(), core::AsSpan(alpha()), gamma());
  const auto data = Data::Make(terms, support_vectors(), alpha(), gamma(), libsvm_scale());
  data->rho = data_->rho;
  data->log_rho = data_->log_rho;
  return OneClassSvm(data);
}

// Hot functions are linked next to one another: a cold decision touches fewer pages.
[[gnu::hot]] double OneClassSvm::Decision(std::span<const double> x) const noexcept {
  const Data& d = *data_;
  PrefetchBlock(&d, d.sum_code);
  return d.single ? Decide(d.sum<float>(), d.rho, x) : Decide(d.sum<double>(), d.rho, x);
}

[[gnu::hot]] double OneClassSvm::Gradient(std::span<const double> x,
                                          std::span<double> gradient) const noexcept {
  const Data& d = *data_;
  PrefetchBlock(&d, d.shift_code);
  std::fill(gradient.begin(), gradient.end(), 0.0);
  return d.single ? GradientOf(d.sum<float>(), d.rho, d.gamma, x, gradient)
                  : GradientOf(d.sum<double>(), d.rho, d.gamma, x, gradient);
}

double OneClassSvm::FromLog(double l) const noexcept {
  return std::isinf(l) ? l : rho() * std::expm1(l);
}

[[gnu::hot]] double OneClassSvm::LogDecision(std::span<const double> x) const noexcept {
  const Data& d = *data_;
  PrefetchBlock(&d, d.sum_code);
  const double log_sum = d.single ? LogSum(d.sum<float>(), x) : LogSum(d.sum<double>(), x);
  return log_sum == kOutside ? kOutside : log_sum - d.log_rho;
}

[[gnu::hot]] double OneClassSvm::LogGradient(std::span<const double> x,
                                             std::span<double> gradient) const noexcept {
  const Data& d = *data_;
  PrefetchBlock(&d, d.shift_code);
  std::fill(gradient.begin(), gradient.end(), 0.0);
  const double log_sum = d.single ? LogSumShift(d.sum<float>(), x, gradient)
                                  : LogSumShift(d.sum<double>(), x, gradient);
  if (log_sum == kOutside) return kOutside;
  for (double& g : gradient) g *= 2.0 * d.gamma;
  return log_sum - d.log_rho;
}

void OneClassSvm::DecisionBatch(const Eigen::Ref<const core::Matrix>& x, std::span<double> g,
                                int threads) const {
  const Data& d = *data_;
  DFR_THROW_UNLESS(x.cols() == state_dim(),
                   "the states of the batch have " << x.cols() << " entries, not " << state_dim());
  DFR_THROW_UNLESS(
      static_cast<std::size_t>(x.rows()) == g.size(),
      "there are " << x.rows() << " states, but room for " << g.size() << " decisions");
  const auto decide = [&](Eigen::Index first, Eigen::Index count) {
    const auto rows = x.middleRows(first, count);
    const auto values = g.subspan(static_cast<std::size_t>(first), static_cast<std::size_t>(count));
    if (d.single) {
      DecideBatch(d.sum<float>(), d.rho, rows, values);
    } else {
      DecideBatch(d.sum<double>(), d.rho, rows, values);
    }
  };
  if (threads == 1) return decide(0, x.rows());
  constexpr Eigen::Index kRun = 1024;
  core::Workers workers(threads);
  workers.Run(static_cast<std::size_t>((x.rows() + kRun - 1) / kRun), [&](std::size_t run) {
    const Eigen::Index first = static_cast<Eigen::Index>(run) * kRun;
    decide(first, std::min(kRun, x.rows() - first));
  });
}

double OneClassSvm::lipschitz_bound() const noexcept {
  return std::sqrt(2.0 * data_->gamma / std::numbers::e);
}

int OneClassSvm::state_dim() const noexcept {
  return static_cast<int>(data_->parts->support_vectors.cols());
}
int OneClassSvm::num_support_vectors() const noexcept {
  return static_cast<int>(data_->parts->support_vectors.rows());
}
const core::Matrix& OneClassSvm::support_vectors() const noexcept {
  return data_->parts->support_vectors;
}
const Eigen::VectorXd& OneClassSvm::alpha() const noexcept { return data_->parts->alpha; }
double OneClassSvm::gamma() const noexcept { return data_->gamma; }
double OneClassSvm::rho() const noexcept { return data_->rho; }
double OneClassSvm::libsvm_scale() const noexcept { return data_->libsvm_scale; }

}  // namespace dfr::kernel
