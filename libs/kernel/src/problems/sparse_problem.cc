#include "problems/sparse_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "dfr/core/contract.h"
#include "gaussian/gaussian_sum.h"

namespace dfr::kernel::internal {
namespace {

constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

constexpr std::size_t kMargin = 256;
// Limit on violators in the active set; n / 16 if that is larger.
constexpr std::size_t kMostViolators = 2048;
// The inner loop ends at the larger of kTarget times the tolerance and kInner times the gap.
constexpr double kTarget = 0.7;
constexpr double kInner = 0.05;

// Splits `order` at the median of the coordinate with the largest variance, recursively, down to
// groups.
void SortIntoGroups(const core::Matrix& samples, std::span<std::size_t> order) {
  if (order.size() <= kSparseGroup) return;
  const auto dim = static_cast<std::size_t>(samples.cols());
  std::vector<double> sum(dim, 0.0);
  std::vector<double> squares(dim, 0.0);
  const double* origin = samples.data() + order[0] * dim;
  for (const std::size_t i : order) {
    const double* x = samples.data() + i * dim;
    for (std::size_t k = 0; k < dim; ++k) {
      const double v = x[k] - origin[k];
      sum[k] += v;
      squares[k] += v * v;
    }
  }
  std::size_t widest = 0;
  double most = -1.0;
  for (std::size_t k = 0; k < dim; ++k) {
    const double variance = squares[k] - sum[k] * sum[k] / static_cast<double>(order.size());
    if (variance > most) {
      most = variance;
      widest = k;
    }
  }
  // Assigns whole groups to the left half.
  const std::size_t groups = (order.size() + kSparseGroup - 1) / kSparseGroup;
  const std::size_t middle = groups / 2 * kSparseGroup;
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(middle), order.end(),
                   [&](std::size_t a, std::size_t b) {
                     const double u = samples.data()[a * dim + widest];
                     const double v = samples.data()[b * dim + widest];
                     return u != v ? u < v : a < b;
                   });
  SortIntoGroups(samples, order.first(middle));
  SortIntoGroups(samples, order.subspan(middle));
}

std::vector<std::size_t> Neighbourly(const core::Matrix& samples) {
  std::vector<std::size_t> order(static_cast<std::size_t>(samples.rows()));
  std::iota(order.begin(), order.end(), std::size_t{0});
  SortIntoGroups(samples, order);
  return order;
}

double RowBytes(const core::Matrix& samples, const OneClassSvmOptions& options, std::size_t size) {
  const double n = static_cast<double>(samples.rows());
  const double d = static_cast<double>(samples.cols());
  const double fixed = 2.0 * n * (d + 1.0) * static_cast<double>(size) + 96.0 * n;
  return options.memory_mib * 0x1p20 - fixed;
}

}  // namespace

template <typename T>
SparseRows<T>::SparseRows(std::size_t rows, std::size_t groups, double bytes)
    : rows_(rows),
      memory_(std::max(static_cast<std::size_t>(
                           std::min(static_cast<double>(rows) * static_cast<double>(Bytes(groups)),
                                    std::max(bytes, 0.0))),
                       4 * Bytes(groups))) {}

template <typename T>
void SparseRows<T>::Reset(std::size_t rows) {
  rows_.assign(rows, {});
  places_.clear();
  head_ = 0;
}

template <typename T>
std::size_t SparseRows<T>::Bytes(std::size_t count) {
  constexpr std::size_t kLine = 64;
  const std::size_t groups = (count * sizeof(std::uint32_t) + kLine - 1) / kLine * kLine;
  return count * kSparseGroup * sizeof(T) + groups;
}

template <typename T>
bool SparseRows<T>::HasRoom(std::size_t count) const {
  // Until the memory has been filled once, the oldest row begins at byte 0.
  return head_ + Bytes(count) <= memory_.size() && (places_.empty() || places_[0].begin == 0);
}

template <typename T>
void SparseRows<T>::Make(std::size_t i, std::size_t count, std::size_t keep) {
  const std::size_t size = Bytes(count);
  const auto drop = [&](std::size_t from, std::size_t to) {
    while (!places_.empty() && places_[0].begin >= from && places_[0].begin < to) {
      if (places_[0].row == keep) return false;
      rows_[places_[0].row] = {};
      places_.pop_front();
    }
    return true;
  };
  // A kept row becomes the newest.
  const auto step_over = [&] {
    head_ = places_[0].end;
    places_.push_back(places_[0]);
    places_.pop_front();
  };
  while (true) {
    if (head_ + size > memory_.size()) {
      if (!drop(head_, memory_.size())) {
        step_over();
        continue;
      }
      head_ = 0;
    }
    if (drop(head_, head_ + size)) break;
    step_over();
  }
  auto* values = reinterpret_cast<T*>(memory_.data() + head_);
  rows_[i] = {reinterpret_cast<std::uint32_t*>(values + count * kSparseGroup), values, count};
  places_.push_back({i, head_, head_ + size});
  head_ += size;
}

template <typename T>
void SparseRows<T>::Write(std::size_t i, const std::uint32_t* groups, const T* values) {
  const SparseRow<T>& row = rows_[i];
  std::copy_n(groups, row.count, const_cast<std::uint32_t*>(row.groups));
  std::copy_n(values, row.count * kSparseGroup, const_cast<T*>(row.values));
}

// -log2 of the largest value that is negligible.
template <typename T>
double SparseProblem<T>::Reach(const core::Matrix& samples, const OneClassSvmOptions& options) {
  const double total = options.nu * static_cast<double>(samples.rows());
  return std::max(1.0, std::log2(total / (kNegligible * options.tolerance)));
}

template <typename T>
bool SparseProblem<T>::Fits(const core::Matrix& samples, const OneClassSvmOptions& options) {
  constexpr Eigen::Index kSome = 64;
  constexpr double kMost = 0.25;
  const double reach = Reach(samples, options) / (options.gamma * std::numbers::log2e);
  const Eigen::Index some = std::min(kSome, samples.rows());
  int near = 0;
  for (Eigen::Index a = 0; a < some; ++a) {
    for (Eigen::Index b = 0; b < a; ++b) {
      const auto shift =
          samples.row(a * samples.rows() / some) - samples.row(b * samples.rows() / some);
      near += shift.squaredNorm() <= reach ? 1 : 0;
    }
  }
  return near <= kMost * 0.5 * static_cast<double>(some * (some - 1)) &&
         RowBytes(samples, options, sizeof(T)) > 0.0;
}

template <typename T>
SparseKernel<T>::SparseKernel(GaussianTerms<T> terms, double reach)
    : terms_(std::move(terms)), boxes_(terms_), reach_(static_cast<T>(reach)) {}

template <typename T>
void SparseKernel<T>::Compute(const T* point, Draft& draft) const {
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  draft.groups.resize((boxes_.count + kLanes) / kLanes * kLanes);
  const std::size_t near = NearGroups(terms_, boxes_, point, reach_, draft.groups.data());
  draft.computed = near * kSparseGroup;
  if (draft.values.size() < draft.computed) {
    draft.values.clear();
    draft.values.resize(draft.computed);
  }
  draft.count = NearRow(terms_, point, reach_, draft.groups.data(), near, draft.values.data());
}

template <typename T>
SparseProblem<T>::SparseProblem(const core::Matrix& samples, const OneClassSvmOptions& options,
                                core::Workers& workers, FitSummary& summary)
    : options_(options),
      summary_(summary),
      workers_(workers),
      smo_(BestSmoFunctions<T>()),
      reach_(Reach(samples, options)),
      order_(Neighbourly(samples)),
      kernel_(GaussianTerms<T>(samples, {}, options.gamma).Subset(order_, kSparseGroup), reach_),
      chosen_(kMargin, std::max(kMostViolators, order_.size() / 16)),
      rows_(order_.size(), kernel_.groups(), RowBytes(samples, options, sizeof(T))),
      point_(kernel_.terms().dim),
      placed_alpha_(order_.size()),
      placed_gradient_(kernel_.terms().row_size(), 0.0),
      rounds_(options, order_.size(), summary),
      alpha_(order_.size()),
      gradient_(order_.size()) {}

// Number of rows computed together: 8 to kMost, within kBytes of dense rows if possible.
template <typename T>
std::size_t SparseProblem<T>::Together() const {
  constexpr std::size_t kMost = 256;
  constexpr std::size_t kBytes = std::size_t{32} << 20;
  return std::clamp<std::size_t>(kBytes / (kernel_.terms().row_size() * sizeof(T)), 8, kMost);
}

// Number of neighbouring rows that a worker receives at a time.
constexpr std::size_t kRun = 8;

// G += K change. Returns false if the caller stopped the sum midway.
template <typename T>
bool SparseProblem<T>::AddToGradient(std::span<const std::size_t> places,
                                     std::span<const double> change) {
  const std::size_t together = Together();
  drafts_.resize(together);
  for (std::size_t first = 0; first < places.size(); first += together) {
    if (!rounds_.Continue()) return false;
    const std::size_t count = std::min(together, places.size() - first);
    workers_.Run((count + kRun - 1) / kRun, [&](std::size_t run) {
      std::vector<T> point(kernel_.terms().dim);
      for (std::size_t q = run * kRun; q < std::min(count, (run + 1) * kRun); ++q) {
        kernel_.terms().Point(places[first + q], point.data());
        kernel_.Compute(point.data(), drafts_[q]);
      }
    });
    // Each entry of G is summed in the order of the rows, for any number of workers.
    constexpr std::size_t kParts = 16;
    workers_.Run(kParts, [&](std::size_t part) {
      const std::size_t begin = part * kernel_.groups() / kParts;
      const std::size_t end = (part + 1) * kernel_.groups() / kParts;
      for (std::size_t q = 0; q < count; ++q) {
        smo_.add_sparse(drafts_[q].row(), change[first + q], begin, end, placed_gradient_.data());
      }
    });
    for (std::size_t q = 0; q < count; ++q) {
      evaluations_ += static_cast<std::int64_t>(drafts_[q].computed);
    }
  }
  return true;
}

// Computes the rows of the `wanted` active samples as far as memory allows.
template <typename T>
void SparseProblem<T>::ComputeAhead(std::span<const std::size_t> wanted) {
  std::vector<std::size_t> missing;
  for (const std::size_t i : wanted) {
    if (!rows_.Has(i)) missing.push_back(i);
  }
  const std::size_t together = Together();
  drafts_.resize(together);
  for (std::size_t first = 0; first < missing.size(); first += together) {
    const std::size_t count = std::min(together, missing.size() - first);
    if (!rows_.HasRoom(active_->kernel.groups()) || !rounds_.Continue()) return;
    const std::size_t runs = (count + kRun - 1) / kRun;
    workers_.Run(runs, [&](std::size_t run) {
      std::vector<T> point(kernel_.terms().dim);
      for (std::size_t q = run * kRun; q < std::min(count, (run + 1) * kRun); ++q) {
        active_->kernel.terms().Point(missing[first + q], point.data());
        active_->kernel.Compute(point.data(), drafts_[q]);
      }
    });
    for (std::size_t q = 0; q < count; ++q) {
      evaluations_ += static_cast<std::int64_t>(drafts_[q].computed);
      if (rows_.HasRoom(drafts_[q].count)) {
        rows_.Make(missing[first + q], drafts_[q].count, kNone);
      }
    }
    workers_.Run(runs, [&](std::size_t run) {
      for (std::size_t q = run * kRun; q < std::min(count, (run + 1) * kRun); ++q) {
        const std::size_t i = missing[first + q];
        if (!rows_.Has(i)) continue;
        rows_.Write(i, drafts_[q].groups.data(), drafts_[q].values.data());
      }
    });
  }
}

template <typename T>
void SparseProblem<T>::Compute(std::size_t i, std::size_t keep) {
  active_->kernel.terms().Point(i, point_.data());
  active_->kernel.Compute(point_.data(), draft_);
  evaluations_ += static_cast<std::int64_t>(draft_.computed);
  rows_.Make(i, draft_.count, keep);
  rows_.Write(i, draft_.groups.data(), draft_.values.data());
}

// Keeps the active set and its rows if they include all chosen samples.
template <typename T>
void SparseProblem<T>::Activate() {
  const std::vector<std::size_t>& wanted = chosen_.samples();
  if (active_ &&
      std::includes(active_->places.begin(), active_->places.end(), wanted.begin(), wanted.end())) {
    return;
  }
  active_.emplace(
      Active{wanted, SparseKernel<T>(kernel_.terms().Subset(wanted, kSparseGroup), reach_)});
  rows_.Reset(wanted.size());
}

// Runs SMO on the active samples. Returns false if the caller stopped the fit before G was updated:
// alpha and G keep their previous values.
template <typename T>
bool SparseProblem<T>::SolveActive(double rho) {
  constexpr T kNever = SparseSmoProblem<T>::kNever;
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  const std::vector<std::size_t>& places = active_->places;
  const std::size_t size = active_->kernel.terms().row_size();
  const std::size_t groups = (active_->kernel.groups() + kLanes - 1) / kLanes * kLanes;
  std::vector<double> alpha(places.size());
  AlignedVector<T> gradient(size, T{0});
  AlignedVector<T> may_rise(size, kNever);
  AlignedVector<T> may_fall(size, -kNever);
  AlignedVector<T> smallest(groups, kNever);
  AlignedVector<T> largest(groups, -kNever);
  std::vector<std::size_t> violators;
  for (std::size_t k = 0; k < places.size(); ++k) {
    const double g = placed_gradient_[places[k]] - rho;
    alpha[k] = placed_alpha_[places[k]];
    gradient[k] = static_cast<T>(g);
    if (alpha[k] < 1.0) may_rise[k] = T{0};
    if (alpha[k] > 0.0) may_fall[k] = T{0};
    const bool violates = std::abs(g) > 0.5 * options_.tolerance &&
                          (alpha[k] <= 0.0 ? g < 0.0 : alpha[k] < 1.0 || g > 0.0);
    if (violates) violators.push_back(k);
  }
  ComputeAhead(violators);
  const auto compute = [](void* problem, std::size_t i, std::size_t keep) {
    static_cast<SparseProblem*>(problem)->Compute(i, keep);
  };
  const SparseSmoProblem<T> problem{active_->kernel.groups(),
                                    rows_.table(),
                                    compute,
                                    this,
                                    alpha.data(),
                                    gradient.data(),
                                    may_rise.data(),
                                    may_fall.data(),
                                    smallest.data(),
                                    largest.data()};
  // Leaves part of the tolerance for the rounding of T and for the other samples.
  const double target = std::max(kTarget * options_.tolerance, kInner * summary_.kkt_gap);
  rounds_.Take(std::numeric_limits<std::int64_t>::max(),
               [&](std::int64_t most) { return smo_.sparse_loop(problem, target, most); });
  std::vector<std::size_t> changed;
  std::vector<double> change;
  for (std::size_t k = 0; k < places.size(); ++k) {
    const std::size_t i = places[k];
    if (alpha[k] == placed_alpha_[i]) continue;
    changed.push_back(i);
    change.push_back(alpha[k] - placed_alpha_[i]);
  }
  AlignedVector<double> before;
  if (options_.progress) before = placed_gradient_;
  if (!AddToGradient(changed, change)) {
    placed_gradient_ = std::move(before);
    return false;
  }
  for (std::size_t k = 0; k < places.size(); ++k) placed_alpha_[places[k]] = alpha[k];
  return true;
}

// Runs rounds until one of them ends the fit, starting from alpha and its G.
template <typename T>
void SparseProblem<T>::Iterate() {
  const std::span<const double> gradient(placed_gradient_.data(), placed_alpha_.size());
  while (true) {
    const KktBounds bounds(placed_alpha_, gradient);
    if (!rounds_.Next(bounds.gap(), Objective(placed_alpha_, gradient))) return;
    chosen_.Choose(placed_alpha_, gradient, bounds.likely_rho());
    Activate();
    if (!SolveActive(bounds.likely_rho())) return rounds_.Stop();
  }
}

template <typename T>
void SparseProblem<T>::Run(std::span<const double> start) {
  std::vector<std::size_t> support;
  std::vector<double> weights;
  for (std::size_t i = 0; i < order_.size(); ++i) {
    placed_alpha_[i] = start[order_[i]];
    if (placed_alpha_[i] <= 0.0) continue;
    support.push_back(i);
    weights.push_back(placed_alpha_[i]);
  }
  if (AddToGradient(support, weights)) {
    Iterate();
  } else {
    std::fill(placed_gradient_.begin(), placed_gradient_.end(), 0.0);
    rounds_.Stop();
  }
  for (std::size_t i = 0; i < order_.size(); ++i) {
    alpha_[order_[i]] = placed_alpha_[i];
    gradient_[order_[i]] = placed_gradient_[i];
  }
}

template class SparseRows<float>;
template class SparseRows<double>;
template class SparseKernel<float>;
template class SparseKernel<double>;
template class SparseProblem<float>;
template class SparseProblem<double>;

}  // namespace dfr::kernel::internal
