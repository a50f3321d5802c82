#include "smo_solver.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <span>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "gaussian_sum.h"
#include "smo_passes.h"

namespace dfr::kernel::internal {
namespace {

using Reason = FitSummary::Reason;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Up to here all samples are solved at once, on their whole kernel matrix.
constexpr std::size_t kWholeProblem = 1500;
// A row that is this small, 16 MiB for all of them, is read faster than it is computed.
constexpr double kQuickCacheBytes = 16.0 * 0x1p20;
// From this dimension on computing a row takes longer than reading it from memory.
constexpr std::size_t kManyFeatures = 16;

// Largest and smallest G that may still move, and with them the KKT gap.
struct Bounds {
  double largest = -kInfinity;  // over alpha > 0
  double smallest = kInfinity;  // over alpha < 1
  double free_sum = 0.0;
  std::size_t free = 0;
  // nu = 1 has no alpha < 1 and no gap.
  [[nodiscard]] double gap() const {
    return std::isinf(smallest) ? 0.0 : std::max(0.0, largest - smallest);
  }
  [[nodiscard]] double rho() const {
    if (free > 0) return free_sum / static_cast<double>(free);
    return std::isinf(smallest) ? largest : 0.5 * (largest + smallest);
  }
};

// Rows of a kernel matrix, computed when asked for and kept while there is room; then one that was
// not used since the last round makes room.
template <typename T>
class RowStore {
 public:
  explicit RowStore(double budget_bytes) : budget_bytes_(budget_bytes) {}

  void Reset(const GaussianTerms<T>& terms) {
    terms_ = &terms;
    stride_ = terms.row_size();
    query_.resize(terms.dim);
    const double row_bytes = static_cast<double>(stride_ * sizeof(T));
    const double all = row_bytes * static_cast<double>(terms.count);
    const bool keep = all <= kQuickCacheBytes || terms.dim >= kManyFeatures;
    const double fit = keep ? std::min(budget_bytes_ / row_bytes, 1e9) : 0.0;
    // A step looks at two rows; with three, the one that is used next is never overwritten.
    capacity_ = std::min(terms.count, std::max<std::size_t>(3, static_cast<std::size_t>(fit)));
    if (values_.size() < capacity_ * stride_) values_.resize(capacity_ * stride_);
    slot_of_.assign(terms.count, kNone);
    owner_.assign(capacity_, kNone);
    used_.assign(capacity_, 0);
    hand_ = 0;
  }

  // Valid until the next but one call.
  const T* Row(std::size_t i) {
    std::size_t slot = slot_of_[i];
    if (slot == kNone) {
      slot = FreeSlot();
      owner_[slot] = i;
      slot_of_[i] = slot;
      terms_->Point(i, query_.data());
      GaussianRow(*terms_, query_.data(), values_.data() + slot * stride_);
      evaluations_ += static_cast<std::int64_t>(terms_->count);
    }
    used_[slot] = 1;
    last_ = slot;
    return values_.data() + slot * stride_;
  }

  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }

 private:
  static constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

  std::size_t FreeSlot() {
    while (owner_[hand_] != kNone && (used_[hand_] != 0 || hand_ == last_)) {
      used_[hand_] = 0;
      hand_ = (hand_ + 1) % capacity_;
    }
    const std::size_t slot = hand_;
    if (owner_[slot] != kNone) slot_of_[owner_[slot]] = kNone;
    hand_ = (hand_ + 1) % capacity_;
    return slot;
  }

  double budget_bytes_;
  const GaussianTerms<T>* terms_ = nullptr;
  std::size_t stride_ = 0;
  std::size_t capacity_ = 0;
  std::size_t hand_ = 0;
  std::size_t last_ = 0;
  std::vector<T> query_;
  AlignedVector<T> values_;
  std::vector<std::size_t> slot_of_;
  std::vector<std::size_t> owner_;
  std::vector<char> used_;
  std::int64_t evaluations_ = 0;
};

// Kernel values in T, alpha and the gradient of all samples in double.
//
// The outer loop knows the exact gradient G = K alpha. It picks an active set (free alpha and the
// samples nearest to or beyond their KKT condition), the inner loop does SMO on that set alone with
// a gradient in T relative to rho, and one tiled pass brings G up to date.
template <typename T>
class Solver {
 public:
  Solver(const core::Matrix& samples, const OneClassSvmOptions& options, FitSummary& summary)
      : options_(options),
        summary_(summary),
        terms_(samples, {}, options.gamma),
        passes_(BestSmoPasses<T>()),
        alpha_(terms_.count, 0.0),
        gradient_(terms_.row_size(), 0.0),
        rows_(RowBudget(samples)) {}

  void Start(std::span<const double> alpha) {
    std::copy(alpha.begin(), alpha.end(), alpha_.begin());
    std::vector<std::size_t> changed;
    std::vector<double> change;
    for (std::size_t i = 0; i < alpha_.size(); ++i) {
      if (alpha_[i] > 0.0) {
        changed.push_back(i);
        change.push_back(alpha_[i]);
      }
    }
    AddToGradient(changed, change);
  }

  Reason Run() {
    double least_gap = kInfinity;
    double least_objective = kInfinity;
    int rounds_without_gain = 0;
    while (true) {
      bounds_ = Scan();
      summary_.kkt_gap = bounds_.gap();
      const double objective = Objective();
      if (summary_.kkt_gap < options_.tolerance) return Reason::kConverged;
      if (!Continue()) return Reason::kInterrupted;
      if (summary_.iterations >= MaxIterations()) return Reason::kMaxIterations;
      // Samples that enter may keep the gap up while the objective falls.
      constexpr int kPatience = 10;
      const bool gain =
          summary_.kkt_gap < 0.9 * least_gap || objective < (1.0 - 1e-6) * least_objective;
      rounds_without_gain = gain ? 0 : rounds_without_gain + 1;
      least_gap = std::min(least_gap, summary_.kkt_gap);
      least_objective = std::min(least_objective, objective);
      if (rounds_without_gain > kPatience) return Reason::kStalled;
      ChooseActive();
      if (!SolveActive()) return Reason::kInterrupted;
    }
  }

  [[nodiscard]] double Objective() const {
    double sum = 0.0;
    for (std::size_t i = 0; i < alpha_.size(); ++i) sum += alpha_[i] * gradient_[i];
    return 0.5 * sum;
  }
  [[nodiscard]] const std::vector<double>& alpha() const { return alpha_; }
  [[nodiscard]] std::span<const double> gradient() const {
    return {gradient_.data(), alpha_.size()};
  }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_ + rows_.evaluations(); }

 private:
  double RowBudget(const core::Matrix& samples) const {
    const double n = static_cast<double>(samples.rows());
    const double d = static_cast<double>(samples.cols());
    // Terms of all and of the active samples, two vectors of doubles, indices.
    const double fixed = 2.0 * n * (d + 1.0) * sizeof(T) + 64.0 * n + 0x1p16;
    const double budget = options_.memory_mib * 0x1p20;
    DFR_THROW_UNLESS(fixed + 3.0 * n * sizeof(T) <= budget,
                     "memory_mib of " << options_.memory_mib << " is too little for " << n << " x "
                                      << d << " samples: the least is "
                                      << std::ceil((fixed + 3.0 * n * sizeof(T)) / 0x1p20));
    return budget - fixed;
  }

  [[nodiscard]] std::int64_t MaxIterations() const {
    const auto n = static_cast<std::int64_t>(alpha_.size());
    return options_.max_iterations > 0 ? options_.max_iterations
                                       : std::max<std::int64_t>(10'000'000, 100 * n);
  }

  [[nodiscard]] bool Continue() const {
    return !options_.progress ||
           options_.progress({summary_.iterations, summary_.kkt_gap, options_.tolerance});
  }

  [[nodiscard]] Bounds Scan() const {
    Bounds bounds;
    for (std::size_t i = 0; i < alpha_.size(); ++i) {
      if (alpha_[i] > 0.0) bounds.largest = std::max(bounds.largest, gradient_[i]);
      if (alpha_[i] < 1.0) bounds.smallest = std::min(bounds.smallest, gradient_[i]);
      if (alpha_[i] > 0.0 && alpha_[i] < 1.0) {
        bounds.free_sum += gradient_[i];
        ++bounds.free;
      }
    }
    return bounds;
  }

  // G += K change, for these samples' alpha.
  void AddToGradient(std::span<const std::size_t> samples, std::span<const double> change) {
    constexpr std::size_t kChunk = 512;  // points of a chunk stay in L2
    std::vector<T> points(std::min(kChunk, samples.size()) * terms_.dim);
    std::vector<T> weights(std::min(kChunk, samples.size()));
    for (std::size_t first = 0; first < samples.size(); first += kChunk) {
      const std::size_t count = std::min(kChunk, samples.size() - first);
      for (std::size_t q = 0; q < count; ++q) {
        terms_.Point(samples[first + q], points.data() + q * terms_.dim);
        weights[q] = static_cast<T>(change[first + q]);
      }
      AddGaussianRows(terms_, points.data(), weights.data(), count, gradient_.data());
      evaluations_ += static_cast<std::int64_t>(count * terms_.count);
    }
  }

  void ChooseActive() {
    active_.clear();
    if (alpha_.size() <= kWholeProblem) {
      active_.resize(alpha_.size());
      std::iota(active_.begin(), active_.end(), std::size_t{0});
      return;
    }
    // How far each bounded sample is from moving; violators are below zero.
    struct Candidate {
      double slack;
      std::size_t sample;
    };
    std::vector<Candidate> candidates;
    const double rho = bounds_.rho();
    std::size_t violators = 0;
    for (std::size_t i = 0; i < alpha_.size(); ++i) {
      if (alpha_[i] > 0.0 && alpha_[i] < 1.0) {
        active_.push_back(i);
        continue;
      }
      const double slack = alpha_[i] <= 0.0 ? gradient_[i] - rho : rho - gradient_[i];
      candidates.push_back({slack, i});
      violators += slack < 0.0 ? 1 : 0;
    }
    const std::size_t wanted =
        std::min(candidates.size(), std::min(violators, kMostViolators + active_.size()) +
                                        kLeastMargin + active_.size() / 4);
    std::nth_element(candidates.begin(),
                     candidates.begin() + static_cast<std::ptrdiff_t>(wanted) -
                         (wanted == candidates.size() ? 1 : 0),
                     candidates.end(), [](const Candidate& a, const Candidate& b) {
                       return a.slack != b.slack ? a.slack < b.slack : a.sample < b.sample;
                     });
    for (std::size_t i = 0; i < wanted; ++i) active_.push_back(candidates[i].sample);
    std::sort(active_.begin(), active_.end());
  }

  // SMO on the active samples, with all others fixed. False if interrupted.
  bool SolveActive() {
    const bool whole = active_.size() == alpha_.size();
    GaussianTerms<T> subset;
    if (!whole) subset = terms_.Subset(active_);
    const GaussianTerms<T>& terms = whole ? terms_ : subset;
    rows_.Reset(terms);

    const std::size_t count = terms.row_size();
    const double rho = bounds_.rho();
    AlignedVector<T> gradient(count, T{0});
    AlignedVector<T> may_rise(count, std::numeric_limits<T>::infinity());
    AlignedVector<T> may_fall(count, -std::numeric_limits<T>::infinity());
    std::vector<double> alpha(active_.size());
    const auto mark = [&](std::size_t k) {
      may_rise[k] = alpha[k] < 1.0 ? T{0} : std::numeric_limits<T>::infinity();
      may_fall[k] = alpha[k] > 0.0 ? T{0} : -std::numeric_limits<T>::infinity();
    };
    for (std::size_t k = 0; k < active_.size(); ++k) {
      alpha[k] = alpha_[active_[k]];
      gradient[k] = static_cast<T>(gradient_[active_[k]] - rho);
      mark(k);
    }

    // Half the tolerance leaves room for the rounding of T and for what the others do. On the way
    // there the others come in when the gap has fallen enough and as much was spent as bringing all
    // of G up to date will cost, two samples an iteration.
    const double target = 0.5 * options_.tolerance;
    const double early = whole ? target : std::max(target, kInnerTolerance * summary_.kkt_gap);
    const auto worthwhile = static_cast<std::int64_t>(kSpend * static_cast<double>(alpha_.size()));
    const std::int64_t first_iteration = summary_.iterations;
    const auto go_on_until = [&] {
      return summary_.iterations - first_iteration < worthwhile ? target : early;
    };
    const T* any = rows_.Row(0);
    Extremes<T> extremes =
        passes_.update(gradient.data(), any, any, T{0}, may_rise.data(), may_fall.data(), count);
    // Curvature between equal points: the step then ends at a bound.
    constexpr double kLeastCurvature = sizeof(T) == 4 ? 1e-7 : 1e-12;
    bool go_on = true;
    const std::int64_t limit = MaxIterations();
    while (static_cast<double>(extremes.largest) - extremes.smallest >= go_on_until() &&
           summary_.iterations < limit) {
      ++summary_.iterations;
      if ((summary_.iterations & 0x3ff) == 0 && !Continue()) {
        go_on = false;
        break;
      }
      const std::size_t i = extremes.smallest_at;
      const T* row_i = rows_.Row(i);
      const std::size_t j =
          passes_.choose_second(row_i, gradient.data(), may_fall.data(), extremes.smallest, count);
      if (j == count) break;
      const T* row_j = rows_.Row(j);
      const double curvature = std::max(2.0 - 2.0 * row_i[j], kLeastCurvature);
      const double wanted = (static_cast<double>(gradient[j]) - extremes.smallest) / curvature;
      const double room = std::min(alpha[j], 1.0 - alpha[i]);
      const double step = std::min(wanted, room);
      // Exactly at a bound where one is reached, whatever the rounding.
      const bool fills = step >= 1.0 - alpha[i];
      const bool empties = step >= alpha[j];
      alpha[i] = fills ? 1.0 : alpha[i] + step;
      alpha[j] = empties ? 0.0 : alpha[j] - step;
      mark(i);
      mark(j);
      extremes = passes_.update(gradient.data(), row_i, row_j, static_cast<T>(step),
                                may_rise.data(), may_fall.data(), count);
    }

    std::vector<std::size_t> changed;
    std::vector<double> change;
    for (std::size_t k = 0; k < active_.size(); ++k) {
      const std::size_t i = active_[k];
      if (alpha[k] != alpha_[i]) {
        changed.push_back(i);
        change.push_back(alpha[k] - alpha_[i]);
        alpha_[i] = alpha[k];
      }
    }
    AddToGradient(changed, change);
    return go_on;
  }

  // Found by experiment between n = 4000 and 100000; within a factor of two nothing much changes.
  static constexpr std::size_t kLeastMargin = 256;
  static constexpr std::size_t kMostViolators = 2048;
  static constexpr double kInnerTolerance = 0.05;
  static constexpr double kSpend = 0.1;

  const OneClassSvmOptions& options_;
  FitSummary& summary_;
  GaussianTerms<T> terms_;
  SmoPasses<T> passes_;
  std::vector<double> alpha_;
  AlignedVector<double> gradient_;
  RowStore<T> rows_;
  Bounds bounds_;
  std::vector<std::size_t> active_;
  std::int64_t evaluations_ = 0;
};

// Samples whose G determines rho: free ones, or where there are none, those at both ends of the
// interval that the KKT conditions leave. The mean of their G is rho.
std::vector<std::size_t> RhoSamples(std::span<const double> alpha,
                                    std::span<const double> gradient) {
  std::vector<std::size_t> free;
  std::size_t low = alpha.size();
  std::size_t high = alpha.size();
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    if (alpha[i] >= 1.0) {
      if (low == alpha.size() || gradient[i] > gradient[low]) low = i;
    } else if (alpha[i] <= 0.0) {
      if (high == alpha.size() || gradient[i] < gradient[high]) high = i;
    } else {
      free.push_back(i);
    }
  }
  if (free.empty() && low != alpha.size()) free.push_back(low);
  if (free.empty() || (free[0] == low && high != alpha.size())) free.push_back(high);
  return free;
}

// rho = mean of G over these samples. The solver's G may stem from kernel values in float, which
// are all off in the same direction; a few values in double show by how much.
double Rho(const core::Matrix& samples, double gamma, std::span<const double> alpha,
           std::span<const double> gradient) {
  const std::vector<std::size_t> chosen = RhoSamples(alpha, gradient);
  double mean = 0.0;
  for (const std::size_t i : chosen) mean += gradient[i] / static_cast<double>(chosen.size());

  std::vector<Eigen::Index> support;
  std::vector<double> weights;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    if (alpha[i] > 0.0) {
      support.push_back(static_cast<Eigen::Index>(i));
      weights.push_back(alpha[i]);
    }
  }
  const GaussianTerms<double> terms(samples(support, Eigen::all), weights, gamma);
  std::vector<double> query(terms.dim);
  constexpr std::size_t kEnough = 16;
  const std::size_t count = std::min(kEnough, chosen.size());
  double correction = 0.0;
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t i = chosen[k * chosen.size() / count];
    const auto row = core::Row(samples, static_cast<Eigen::Index>(i));
    if (terms.Scale(row.data(), query.data())) {
      correction += GaussianSum(terms, query.data()) - gradient[i];
    }
  }
  return mean + correction / static_cast<double>(count);
}

// The first samples of `order` at the bound, until alpha sums to `total`.
std::vector<double> Fill(std::span<const std::size_t> order, double total) {
  std::vector<double> alpha(order.size(), 0.0);
  for (const std::size_t i : order) {
    if (total <= 0.0) break;
    alpha[i] = std::min(1.0, total);
    total -= alpha[i];
  }
  return alpha;
}

// The given start, scaled, cut at the bound and filled up to `total`.
std::vector<double> Feasible(std::span<const double> start, double total) {
  const double scale = total / std::accumulate(start.begin(), start.end(), 0.0);
  std::vector<double> alpha(start.size());
  double rest = total;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    alpha[i] = std::min({1.0, scale * start[i], rest});
    rest -= alpha[i];
  }
  // First those that are support vectors already.
  for (const bool support : {true, false}) {
    for (std::size_t i = 0; i < alpha.size() && rest > 0.0; ++i) {
      if ((start[i] > 0.0) != support) continue;
      const double more = std::min(1.0 - alpha[i], rest);
      alpha[i] += more;
      rest -= more;
    }
  }
  return alpha;
}

// Samples in random order, the same every time.
std::vector<std::size_t> Shuffled(std::size_t count) {
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  core::Random random(20190917);
  random.Shuffle(std::span(order));
  return order;
}

std::vector<double> FindStart(const core::Matrix& samples, const OneClassSvmOptions& options,
                              FitSummary& summary);

template <typename T>
DualSolution SolveIn(const core::Matrix& samples, const OneClassSvmOptions& options,
                     std::span<const double> start, FitSummary& summary) {
  Solver<T> solver(samples, options, summary);
  solver.Start(start);
  summary.reason = solver.Run();
  summary.kernel_evaluations += solver.evaluations();
  const std::vector<double>& alpha = solver.alpha();
  summary.objective = solver.Objective();
  return {core::AsVector(alpha), Rho(samples, options.gamma, alpha, solver.gradient())};
}

DualSolution Solve(const core::Matrix& samples, const OneClassSvmOptions& options,
                   FitSummary& summary) {
  std::vector<double> start = FindStart(samples, options, summary);
  // A kernel value in float is off by up to 1e-7, G by nu m times that at most.
  const double total = options.nu * static_cast<double>(samples.rows());
  if (options.tolerance >= 2e-7 * total) {
    DualSolution solution = SolveIn<float>(samples, options, start, summary);
    if (summary.reason != Reason::kStalled) return solution;
    start.assign(solution.alpha.begin(), solution.alpha.end());
  }
  return SolveIn<double>(samples, options, start, summary);
}

std::vector<double> FindStart(const core::Matrix& samples, const OneClassSvmOptions& options,
                              FitSummary& summary) {
  const auto count = static_cast<std::size_t>(samples.rows());
  const double total = options.nu * static_cast<double>(count);
  if (!options.start.empty()) return Feasible(options.start, total);
  std::vector<std::size_t> order = Shuffled(count);
  constexpr std::size_t kWorthwhile = 4000;
  if (count < kWorthwhile) return Fill(order, total);

  // The estimate from every eighth sample says which ones lie outermost.
  constexpr std::size_t kPart = 8;
  std::vector<Eigen::Index> chosen(order.begin(),
                                   order.begin() + static_cast<std::ptrdiff_t>(count / kPart));
  const core::Matrix part = samples(chosen, Eigen::all);
  OneClassSvmOptions part_options = options;
  part_options.tolerance = std::max(options.tolerance, 1e-3 * options.nu * count / kPart);
  const DualSolution solution = Solve(part, part_options, summary);
  std::vector<std::size_t> support;
  for (Eigen::Index i = 0; i < solution.alpha.size(); ++i) {
    if (solution.alpha[i] > 0.0) support.push_back(static_cast<std::size_t>(i));
  }
  const GaussianTerms<float> terms(samples, {}, options.gamma);
  std::vector<float> points(support.size() * terms.dim);
  std::vector<float> weights(support.size());
  for (std::size_t q = 0; q < support.size(); ++q) {
    terms.Point(order[support[q]], points.data() + q * terms.dim);
    weights[q] = static_cast<float>(solution.alpha[static_cast<Eigen::Index>(support[q])]);
  }
  AlignedVector<double> g(terms.row_size(), 0.0);
  AddGaussianRows(terms, points.data(), weights.data(), support.size(), g.data());
  summary.kernel_evaluations += static_cast<std::int64_t>(support.size() * count);
  const auto outermost = std::min(count, static_cast<std::size_t>(std::ceil(total)));
  std::nth_element(
      order.begin(), order.begin() + static_cast<std::ptrdiff_t>(outermost) - 1, order.end(),
      [&](std::size_t a, std::size_t b) { return g[a] != g[b] ? g[a] < g[b] : a < b; });
  return Fill(order, total);
}

}  // namespace

DualSolution SolveDual(const core::Matrix& samples, const OneClassSvmOptions& options,
                       FitSummary& summary) {
  return Solve(samples, options, summary);
}

}  // namespace dfr::kernel::internal
