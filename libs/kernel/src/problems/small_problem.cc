#include "problems/small_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

#include "gaussian/gaussian_sum.h"
#include "smo/kkt.h"
#include "smo/starts.h"

namespace dfr::kernel::internal {
namespace {

// With this gamma, exp(-gamma r^2) = 2^(-r^2).
constexpr double kBaseTwo = 1.0 / std::numbers::log2e;

template <typename T>
std::size_t RowSize(std::size_t samples) {
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  return (samples + kLanes - 1) / kLanes * kLanes;
}

}  // namespace

template <typename T>
Distances<T>::Distances(const core::Matrix& samples)
    : terms_(samples, {}, kBaseTwo),
      exponents_(terms_.count * terms_.row_size()),
      known_(terms_.count, 0),
      point_(terms_.dim) {}

template <typename T>
void Distances<T>::KernelRow(std::size_t i, double gamma, T* row) {
  T* exponents = exponents_.data() + i * terms_.row_size();
  if (known_[i] == 0) {
    terms_.Point(i, point_.data());
    ExponentRow(terms_, point_.data(), exponents);
    known_[i] = 1;
  }
  PowerRow(terms_, exponents, static_cast<T>(gamma / kBaseTwo), terms_.row_size(), row);
}

template <typename T>
bool SmallProblem<T>::Fits(const core::Matrix& samples, const OneClassSvmOptions& options,
                           const Scratch& scratch) {
  constexpr double kMostBytes = 16.0 * 0x1p20;
  const auto count = static_cast<std::size_t>(samples.rows());
  const auto row = static_cast<double>(RowSize<T>(count) * sizeof(T));
  const double matrix = static_cast<double>(RowSize<T>(count)) * row;
  const double rest = row * static_cast<double>(samples.cols() + 1) + 64.0 * row + 0x1p16;
  const double all = scratch.has_distances() ? 2.0 * (matrix + rest) : matrix + rest;
  return matrix <= kMostBytes && all <= options.memory_mib * 0x1p20;
}

template <typename T>
SmallProblem<T>::SmallProblem(const core::Matrix& samples, const Extent& extent,
                              const OneClassSvmOptions& options, Scratch& scratch,
                              FitSummary& summary)
    : options_(options),
      summary_(summary),
      distances_(scratch.DistancesIn<T>()),
      smo_(BestSmoFunctions<T>()),
      row_size_(RowSize<T>(static_cast<std::size_t>(samples.rows()))),
      invert_(row_size_ * row_size_ * sizeof(T) <= kMostInverseBytes &&
              options.memory_mib >= kLeastInverseMib),
      // Room for all rows, three arrays of the loop, and the inverse curvatures.
      rows_(scratch.Room<T>((row_size_ + 3 + (invert_ ? row_size_ : 0)) * row_size_)),
      known_(static_cast<std::size_t>(samples.rows()), nullptr),
      used_(known_.size(), 0),
      point_(static_cast<std::size_t>(samples.cols())),
      gradient_(row_size_) {
  if (distances_ == nullptr)
    terms_.emplace(samples, extent, std::span<const double>(), options.gamma);
}

template <typename T>
const T* SmallProblem<T>::Row(std::size_t i) {
  if (known_[i] != nullptr) return known_[i];
  T* row = rows_ + i * row_size_;
  if (distances_ != nullptr) {
    distances_->KernelRow(i, options_.gamma, row);
  } else {
    terms_->Point(i, point_.data());
    GaussianRow(*terms_, point_.data(), row);
  }
  evaluations_ += static_cast<std::int64_t>(known_.size());
  known_[i] = row;
  return row;
}

// Computes the support and G = K alpha from scratch, which removes the rounding of earlier rounds.
template <typename T>
void SmallProblem<T>::UpdateGradient() {
  support_ = Support(alpha_);
  std::vector<const T*> rows(support_.size());
  std::vector<double> weights(support_.size());
  for (std::size_t q = 0; q < support_.size(); ++q) {
    rows[q] = Row(support_[q]);
    weights[q] = alpha_[support_[q]];
  }
  smo_.combine(rows.data(), weights.data(), rows.size(), row_size_, gradient_.data());
}

// Returns true if the kernel sum over all samples, averaged over the support vectors with weights
// alpha, is small. Each sample contributes 1 to its own sum.
template <typename T>
bool SmallProblem<T>::FewNeighbors() const {
  constexpr double kFewNeighbors = 6.0;
  const double total = options_.nu * static_cast<double>(known_.size());
  const std::span<const double> g = gradient();
  return std::accumulate(g.begin(), g.end(), 0.0) < (1.0 + kFewNeighbors) * total;
}

// Gives all samples the same alpha. G is then proportional to the sums of the rows.
template <typename T>
void SmallProblem<T>::StartEqual() {
  const std::size_t count = known_.size();
  alpha_.assign(count, options_.nu);
  if (distances_ != nullptr) return UpdateGradient();
  support_.resize(count);
  std::iota(support_.begin(), support_.end(), std::size_t{0});
  std::vector<T> sums(count);
  AllGaussianRows(*terms_, point_.data(), rows_, sums.data());
  for (std::size_t i = 0; i < count; ++i) {
    known_[i] = rows_ + i * row_size_;
    gradient_[i] = options_.nu * static_cast<double>(sums[i]);
  }
  evaluations_ += static_cast<std::int64_t>(count * (count + 1) / 2);
}

// Gives the samples with the smallest kernel sums the largest alpha. If kernels overlap little,
// keeps the same alpha for all unless this start has a smaller objective.
template <typename T>
void SmallProblem<T>::StartAtBound() {
  StartEqual();
  const std::size_t count = known_.size();
  const double total = options_.nu * static_cast<double>(count);
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto outermost = std::min(count, static_cast<std::size_t>(std::ceil(total)));
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(outermost) - 1,
                   order.end(), [this](std::size_t a, std::size_t b) {
                     return gradient_[a] != gradient_[b] ? gradient_[a] < gradient_[b] : a < b;
                   });
  const bool few = FewNeighbors();
  const AlignedVector<double> equal_gradient = gradient_;
  const std::vector<double> equal = std::exchange(alpha_, Fill(order, count, total));
  UpdateGradient();
  if (!few || Objective(alpha_, gradient()) <= Objective(equal, equal_gradient)) return;
  alpha_ = equal;
  support_ = order;
  std::sort(support_.begin(), support_.end());
  gradient_ = equal_gradient;
}

// Uses the minimum number of support vectors, evenly spread: rows that are never requested are not
// computed. If kernels overlap little, most samples become support vectors, and the start uses all.
// A large nu needs most rows anyway; their sums show which samples are outermost.
template <typename T>
void SmallProblem<T>::ChooseStart() {
  if (options_.nu >= kLargeNu) return StartAtBound();
  const std::size_t count = known_.size();
  const double total = options_.nu * static_cast<double>(count);
  alpha_ = EvenlySpread(count, total);
  UpdateGradient();
  if (FewNeighbors()) StartEqual();
}

template <typename T>
void SmallProblem<T>::Run(std::span<const double> start) {
  if (start.empty()) {
    ChooseStart();
  } else {
    alpha_.assign(start.begin(), start.end());
    UpdateGradient();
  }
  constexpr T kNever = SmoProblem<T>::kNever;
  T* gradient = rows_ + row_size_ * row_size_;
  T* may_rise = gradient + row_size_;
  T* may_fall = may_rise + row_size_;
  const std::size_t count = alpha_.size();
  for (std::size_t i = 0; i < count; ++i) {
    may_rise[i] = alpha_[i] < 1.0 ? T{0} : kNever;
    may_fall[i] = alpha_[i] > 0.0 ? T{0} : -kNever;
  }
  std::fill(gradient + count, may_rise, T{0});
  std::fill(may_rise + count, may_fall, kNever);
  std::fill(may_fall + count, may_fall + row_size_, -kNever);
  std::vector<unsigned char> inverse_known(count, 0);
  const auto compute = [](void* problem, std::size_t i, std::size_t) {
    return static_cast<SmallProblem*>(problem)->Row(i);
  };
  const SmoProblem<T> problem{row_size_,
                              {known_.data(), used_.data(), compute, this},
                              alpha_.data(),
                              gradient,
                              may_rise,
                              may_fall,
                              invert_ ? may_fall + row_size_ : nullptr,
                              inverse_known.data()};
  Rounds rounds(options_, alpha_.size(), summary_);
  while (true) {
    const KktBounds bounds(alpha_, this->gradient(), support_);
    if (!rounds.Next(bounds.gap(), 0.5 * bounds.weighted_sum)) return;
    const double rho = bounds.rho();
    for (std::size_t i = 0; i < count; ++i) gradient[i] = static_cast<T>(gradient_[i] - rho);
    // Leaves a tenth of the tolerance for the rounding of T.
    const double target = 0.9 * options_.tolerance;
    rounds.Take(std::numeric_limits<std::int64_t>::max(),
                [&](std::int64_t most) { return smo_.loop(problem, target, most); });
    UpdateGradient();
  }
}

template class Distances<float>;
template class Distances<double>;
template class SmallProblem<float>;
template class SmallProblem<double>;

}  // namespace dfr::kernel::internal
