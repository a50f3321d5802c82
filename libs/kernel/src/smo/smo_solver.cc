#include "smo/smo_solver.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <numeric>
#include <span>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/workers.h"
#include "gaussian/gaussian_sum.h"
#include "problems/small_problem.h"
#include "problems/sparse_problem.h"
#include "smo/active_set.h"
#include "smo/kkt.h"
#include "smo/row_store.h"
#include "smo/smo_loop.h"
#include "smo/starts.h"
#include "smo/true_gap.h"

namespace dfr::kernel::internal {
namespace {

// From this number of samples on, a fit to a part of them provides the start.
constexpr Eigen::Index kManySamples = 4000;
// For a large nu, such a fit provides the start above this number of samples. For fewer samples, a
// SmallProblem stores the whole kernel matrix.
constexpr Eigen::Index kMostWhole = 2048;

// AddGaussianRows(), distributed over the workers. Each entry is summed in the same order for any
// number of workers. Calls `go_on` several times a second. Stops and returns false if `go_on`
// returns false.
template <typename T, class GoOn>
[[nodiscard]] bool AddRows(const GaussianTerms<T>& terms, std::span<const T> points,
                           std::span<const T> weights, double* totals, core::Workers& workers,
                           GoOn&& go_on) {
  // Number of blocks of a part: enough to justify a thread, few enough to distribute the parts
  // evenly.
  constexpr std::size_t kBlocks = 64;
  constexpr std::size_t kChunk = 512;  // number of points that stay in L2
  constexpr std::uint64_t kWork = std::uint64_t{1} << 33;
  const auto chunks = static_cast<std::size_t>(
      std::max<std::uint64_t>(1, kWork / (kChunk * (terms.dim + 8) * terms.row_size())));
  for (std::size_t first = 0; first < weights.size(); first += chunks * kChunk) {
    if (!go_on()) return false;
    const std::size_t last = std::min(first + chunks * kChunk, weights.size());
    workers.Run((terms.num_blocks + kBlocks - 1) / kBlocks, [&](std::size_t part) {
      const std::size_t begin = part * kBlocks;
      const std::size_t end = std::min(begin + kBlocks, terms.num_blocks);
      for (std::size_t q = first; q < last; q += kChunk) {
        AddGaussianRows(terms, begin, end, points.data() + q * terms.dim, weights.data() + q,
                        std::min(kChunk, last - q), totals);
      }
    });
  }
  return true;
}

// Number of bytes that a Solver<T> needs in addition to its rows: the terms of all and of the
// active samples, two vectors of doubles, and indices.
template <typename T>
double FixedBytes(const core::Matrix& samples) {
  const double n = static_cast<double>(samples.rows());
  const double d = static_cast<double>(samples.cols());
  return 2.0 * n * (d + 1.0) * sizeof(T) + 64.0 * n + 0x1p16;
}

// Minimum number of bytes of a Solver<T>: FixedBytes() and three rows.
template <typename T>
double LeastBytes(const core::Matrix& samples) {
  return FixedBytes<T>(samples) + 3.0 * static_cast<double>(samples.rows()) * sizeof(T);
}

// Returns true if memory_mib suffices for a fit with kernel values in T.
template <typename T>
bool IsAffordable(const core::Matrix& samples, const OneClassSvmOptions& options,
                  const Scratch& scratch) {
  return LeastBytes<T>(samples) <= options.memory_mib * 0x1p20 ||
         SmallProblem<T>::Fits(samples, options, scratch) ||
         SparseProblem<T>::Fits(samples, options);
}

template <typename T>
void CheckMemory(const core::Matrix& samples, const OneClassSvmOptions& options,
                 const Scratch& scratch) {
  DFR_THROW_UNLESS(IsAffordable<T>(samples, options, scratch),
                   "memory_mib of " << options.memory_mib << " is too little for " << samples.rows()
                                    << " x " << samples.cols() << " samples: set it to at least "
                                    << std::ceil(LeastBytes<T>(samples) / 0x1p20));
}

// Solver with kernel values in T, and with alpha and the gradient of all samples in double.
//
// The outer loop keeps the exact gradient G = K alpha. It selects an active set (the free samples
// and those that violate their KKT condition or nearly do). The inner loop does SMO on that set
// alone, with a gradient in T relative to rho. One tiled pass then updates G.
template <typename T>
class Solver {
 public:
  Solver(const core::Matrix& samples, const Extent& extent, const OneClassSvmOptions& options,
         core::Workers& workers, FitSummary& summary)
      : options_(options),
        summary_(summary),
        workers_(workers),
        terms_(samples, extent, {}, options.gamma),
        smo_(BestSmoFunctions<T>()),
        alpha_(terms_.count, 0.0),
        gradient_(terms_.row_size(), 0.0),
        rounds_(options, terms_.count, summary),
        rows_(options.memory_mib * 0x1p20 - FixedBytes<T>(samples)) {}

  void Run(std::span<const double> start) {
    std::copy(start.begin(), start.end(), alpha_.begin());
    std::vector<std::size_t> changed;
    std::vector<double> change;
    for (std::size_t i = 0; i < alpha_.size(); ++i) {
      if (alpha_[i] > 0.0) {
        changed.push_back(i);
        change.push_back(alpha_[i]);
      }
    }
    if (!AddToGradient(changed, change)) {
      std::fill(gradient_.begin(), gradient_.end(), 0.0);
      return rounds_.Stop();
    }
    while (true) {
      const KktBounds bounds(alpha_, gradient());
      if (!rounds_.Next(bounds.gap(), Objective(alpha_, gradient()))) return;
      active_.Choose(alpha_, gradient(), bounds.rho());
      if (!SolveActive(bounds.rho())) return rounds_.Stop();
    }
  }

  [[nodiscard]] std::span<const double> alpha() const { return alpha_; }
  [[nodiscard]] std::span<const double> gradient() const {
    return {gradient_.data(), alpha_.size()};
  }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_ + rows_.evaluations(); }
  [[nodiscard]] std::span<const double> center() const { return terms_.center; }

 private:
  // G += K change, where `change` is the change of alpha of `samples`. Returns false if the caller
  // stopped the sum midway.
  [[nodiscard]] bool AddToGradient(std::span<const std::size_t> samples,
                                   std::span<const double> change) {
    std::vector<T> points(samples.size() * terms_.dim);
    std::vector<T> weights(samples.size());
    for (std::size_t q = 0; q < samples.size(); ++q) {
      terms_.Point(samples[q], points.data() + q * terms_.dim);
      weights[q] = static_cast<T>(change[q]);
    }
    evaluations_ += static_cast<std::int64_t>(samples.size() * terms_.count);
    return AddRows<T>(terms_, points, weights, gradient_.data(), workers_,
                      [this] { return rounds_.Continue(); });
  }

  // Runs SMO on the active samples, with all others fixed. Returns false if the caller stopped the
  // fit before G was updated: alpha and G keep their previous values.
  [[nodiscard]] bool SolveActive(double rho) {
    const GaussianTerms<T> terms = terms_.Subset(active_.samples());
    rows_.Reset(terms);
    const std::size_t count = terms.row_size();
    AlignedVector<T> gradient(count, T{0});
    AlignedVector<T> may_rise(count, SmoProblem<T>::kNever);
    AlignedVector<T> may_fall(count, -SmoProblem<T>::kNever);
    std::vector<double> alpha(active_.samples().size());
    for (std::size_t k = 0; k < active_.samples().size(); ++k) {
      alpha[k] = alpha_[active_.samples()[k]];
      gradient[k] = static_cast<T>(gradient_[active_.samples()[k]] - rho);
      if (alpha[k] < 1.0) may_rise[k] = T{0};
      if (alpha[k] > 0.0) may_fall[k] = T{0};
    }
    const SmoProblem<T> problem{count,           rows_.Table(),   alpha.data(),
                                gradient.data(), may_rise.data(), may_fall.data()};

    // Half the tolerance is a margin for the rounding of T and for the other samples. The other
    // samples join earlier if the gap has decreased enough and the inner loop has spent as much
    // time as an update of all of G takes (two samples per iteration).
    const double target = 0.5 * options_.tolerance;
    const double early = std::max(target, kInnerTolerance * summary_.kkt_gap);
    const auto worthwhile = static_cast<std::int64_t>(kSpend * static_cast<double>(alpha_.size()));
    bool done = false;
    rounds_.Take(worthwhile, [&](std::int64_t most) {
      const SmoSteps steps = smo_.loop(problem, target, most);
      done = !steps.more;
      return steps;
    });
    if (!done) {
      rounds_.Take(std::numeric_limits<std::int64_t>::max(),
                   [&](std::int64_t most) { return smo_.loop(problem, early, most); });
    }

    std::vector<std::size_t> changed;
    std::vector<double> change;
    std::vector<double> changed_alpha;
    for (std::size_t k = 0; k < active_.samples().size(); ++k) {
      const std::size_t i = active_.samples()[k];
      if (alpha[k] == alpha_[i]) continue;
      changed.push_back(i);
      change.push_back(alpha[k] - alpha_[i]);
      changed_alpha.push_back(alpha[k]);
    }
    AlignedVector<double> before;
    if (options_.progress) before = gradient_;
    if (!AddToGradient(changed, change)) {
      gradient_ = std::move(before);
      return false;
    }
    for (std::size_t q = 0; q < changed.size(); ++q) alpha_[changed[q]] = changed_alpha[q];
    return true;
  }

  // Experiments between n = 4000 and 100000 gave these values; a factor of two changes little.
  static constexpr std::size_t kLeastMargin = 256;
  static constexpr std::size_t kMostViolators = 2048;
  static constexpr double kInnerTolerance = 0.05;
  static constexpr double kSpend = 0.1;

  const OneClassSvmOptions& options_;
  FitSummary& summary_;
  core::Workers& workers_;
  GaussianTerms<T> terms_;
  SmoFunctions<T> smo_;
  std::vector<double> alpha_;
  AlignedVector<double> gradient_;
  Rounds rounds_;
  RowStore<T> rows_;
  ActiveSet active_{kLeastMargin, kMostViolators};
  std::int64_t evaluations_ = 0;
};

// Returns the samples whose G determines rho: the free samples or, if there are none, the samples
// at both ends of the interval that the KKT conditions allow. rho is the mean of their G.
std::vector<std::size_t> RhoSamples(std::span<const double> alpha,
                                    std::span<const double> gradient) {
  std::vector<std::size_t> free(alpha.size());
  std::size_t count = 0;
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    free[count] = i;
    count += alpha[i] > 0.0 && alpha[i] < 1.0 ? 1 : 0;
  }
  free.resize(count);
  if (count > 0) return free;
  std::size_t low = alpha.size();
  std::size_t high = alpha.size();
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    if (alpha[i] >= 1.0 && (low == alpha.size() || gradient[i] > gradient[low])) low = i;
    if (alpha[i] <= 0.0 && (high == alpha.size() || gradient[i] < gradient[high])) high = i;
  }
  if (low != alpha.size()) free.push_back(low);
  if (high != alpha.size()) free.push_back(high);
  return free;
}

template <typename T>
DualSolution Solution(const T& solver) {
  DualSolution solution{core::AsVector(solver.alpha()), 0.0, {}};
  const std::span<const double> gradient = solver.gradient();
  const std::vector<std::size_t> chosen = RhoSamples(solver.alpha(), gradient);
  for (const std::size_t i : chosen) solution.rho += gradient[i];
  solution.rho /= static_cast<double>(chosen.size());
  constexpr std::size_t kEnough = 8;
  const std::size_t count = std::min(kEnough, chosen.size());
  solution.rho_samples.reserve(count);
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t i = chosen[k * chosen.size() / count];
    solution.rho_samples.push_back({static_cast<Eigen::Index>(i), gradient[i]});
  }
  return solution;
}

// Returns the start as the solution. The caller computes rho from G at its rho_samples.
DualSolution Unsolved(std::span<const double> start, FitSummary& summary) {
  struct Start {
    [[nodiscard]] std::span<const double> alpha() const { return alpha_; }
    [[nodiscard]] std::span<const double> gradient() const { return gradient_; }
    std::span<const double> alpha_;
    std::vector<double> gradient_;
  };
  summary.kkt_gap = std::numeric_limits<double>::infinity();
  summary.objective = std::numeric_limits<double>::infinity();
  return Solution(Start{start, std::vector<double>(start.size(), 0.0)});
}

// Returns the samples in a fixed random order.
std::vector<std::size_t> Shuffled(std::size_t count) {
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  core::Random random(20190917);
  random.Shuffle(std::span(order));
  return order;
}

// Returns a start, or an empty one to let the problem choose.
std::vector<double> FindStart(const core::Matrix& samples, const Extent& extent,
                              const OneClassSvmOptions& options, core::Workers& workers,
                              FitSummary& summary);

template <typename T, class Problem>
DualSolution Finish(Problem& problem, const core::Matrix& samples, const Extent& extent,
                    const OneClassSvmOptions& options, std::span<const double> start,
                    double neglected, core::Workers& workers, FitSummary& summary) {
  problem.Run(start);
  summary.kernel_evaluations += problem.evaluations();
  if (summary.reason == FitSummary::Reason::kConverged) {
    summary.kkt_gap = TrueGap<T>(samples, extent, options, problem.center(), problem.alpha(),
                                 problem.gradient(), neglected, workers);
    if (!(summary.kkt_gap < options.tolerance)) summary.reason = FitSummary::Reason::kStalled;
  }
  return Solution(problem);
}

template <typename T>
DualSolution SolveIn(const core::Matrix& samples, const Extent& extent,
                     const OneClassSvmOptions& options, std::span<const double> start,
                     Scratch& scratch, core::Workers& workers, FitSummary& summary) {
  if (SmallProblem<T>::Fits(samples, options, scratch)) {
    SmallProblem<T> problem(samples, extent, options, scratch, summary);
    return Finish<T>(problem, samples, extent, options, start, 0.0, workers, summary);
  }
  std::vector<double> spread;
  if (start.empty()) {
    const auto count = static_cast<std::size_t>(samples.rows());
    spread = EvenlySpread(count, options.nu * static_cast<double>(count));
    start = spread;
  }
  if (SparseProblem<T>::Fits(samples, options)) {
    SparseProblem<T> problem(samples, options, workers, summary);
    return Finish<T>(problem, samples, extent, options, start, problem.neglected(), workers,
                     summary);
  }
  Solver<T> solver(samples, extent, options, workers, summary);
  return Finish<T>(solver, samples, extent, options, start, 0.0, workers, summary);
}

// Returns true if squared distances in kernel widths are within the range of float.
bool FitsFloat(const core::Matrix& samples, const Extent& extent, double gamma) {
  constexpr double kFar = 1e15;
  const double scale = std::sqrt(gamma * std::numbers::log2e);
  if (scale * 2.0 * extent.largest < kFar) return true;
  const auto range = samples.colwise().maxCoeff() - samples.colwise().minCoeff();
  return scale * range.maxCoeff() < kFar;
}

DualSolution Solve(const core::Matrix& samples, const Extent& extent,
                   const OneClassSvmOptions& options, Scratch& scratch, core::Workers& workers,
                   FitSummary& summary) {
  // A kernel value in float has an error of up to 1e-7, which gives G an error of up to nu m times
  // 1e-7. Large sums average most of it out. If the gap, verified in double, is too large, a fit in
  // double follows.
  const double total = options.nu * static_cast<double>(samples.rows());
  const double rounding = samples.rows() < kManySamples ? 2e-7 : 2e-8;
  const bool single =
      options.tolerance >= rounding * total && FitsFloat(samples, extent, options.gamma);
  if (single) {
    CheckMemory<float>(samples, options, scratch);
  } else {
    CheckMemory<double>(samples, options, scratch);
  }
  std::vector<double> start = FindStart(samples, extent, options, workers, summary);
  if (summary.reason == FitSummary::Reason::kInterrupted) return Unsolved(start, summary);
  if (single) {
    DualSolution solution =
        SolveIn<float>(samples, extent, options, start, scratch, workers, summary);
    if (summary.reason != FitSummary::Reason::kStalled) return solution;
    if (!IsAffordable<double>(samples, options, scratch)) return solution;
    start.assign(solution.alpha.begin(), solution.alpha.end());
  }
  return SolveIn<double>(samples, extent, options, start, scratch, workers, summary);
}

std::vector<double> FindStart(const core::Matrix& samples, const Extent& extent,
                              const OneClassSvmOptions& options, core::Workers& workers,
                              FitSummary& summary) {
  const auto count = static_cast<std::size_t>(samples.rows());
  const double total = options.nu * static_cast<double>(count);
  if (!options.start.empty()) return Feasible(options.start, total);
  const bool many = samples.rows() >= kManySamples;
  const bool many_at_bound = options.nu >= kLargeNu && samples.rows() > kMostWhole;
  if ((!many && !many_at_bound) || options.nu == 1.0) return {};
  std::vector<std::size_t> order = Shuffled(count);

  // The estimate from a random eighth of the samples shows which samples are outermost.
  constexpr std::size_t kPart = 8;
  std::vector<Eigen::Index> chosen(order.begin(),
                                   order.begin() + static_cast<std::ptrdiff_t>(count / kPart));
  const core::Matrix part = samples(chosen, Eigen::all);
  OneClassSvmOptions part_options = options;
  part_options.tolerance = std::max(options.tolerance, 1e-3 * options.nu * count / kPart);
  Scratch scratch;
  const DualSolution solution = Solve(part, Extent(part), part_options, scratch, workers, summary);
  summary.kkt_gap = std::numeric_limits<double>::infinity();  // not yet known for all samples
  // When interrupted, returns a feasible start made from alpha of the part.
  const auto interrupted = [&] {
    summary.reason = FitSummary::Reason::kInterrupted;
    std::vector<double> known(count, 0.0);
    for (std::size_t k = 0; k < chosen.size(); ++k) {
      known[static_cast<std::size_t>(chosen[k])] = solution.alpha[static_cast<Eigen::Index>(k)];
    }
    return Feasible(known, total);
  };
  if (summary.reason == FitSummary::Reason::kInterrupted) return interrupted();
  std::vector<std::size_t> support;
  for (Eigen::Index i = 0; i < solution.alpha.size(); ++i) {
    if (solution.alpha[i] > 0.0) support.push_back(static_cast<std::size_t>(i));
  }
  const auto free = std::count_if(solution.alpha.begin(), solution.alpha.end(),
                                  [](double a) { return a > 0.0 && a < 1.0; });
  // A small part does not show which samples are outermost among many free ones.
  if (!many && 10 * free > part.rows()) return {};
  // Most samples are support vectors below the bound.
  if (2 * free > part.rows()) return std::vector<double>(count, options.nu);
  const GaussianTerms<float> terms(samples, extent, {}, options.gamma);
  std::vector<float> points(support.size() * terms.dim);
  std::vector<float> weights(support.size());
  for (std::size_t q = 0; q < support.size(); ++q) {
    terms.Point(order[support[q]], points.data() + q * terms.dim);
    weights[q] = static_cast<float>(solution.alpha[static_cast<Eigen::Index>(support[q])]);
  }
  AlignedVector<double> g(terms.row_size(), 0.0);
  if (!AddRows<float>(terms, points, weights, g.data(), workers,
                      [&] { return GoOn(options, summary); })) {
    return interrupted();
  }
  summary.kernel_evaluations += static_cast<std::int64_t>(support.size() * count);
  const auto outermost = std::min(count, static_cast<std::size_t>(std::ceil(total)));
  std::nth_element(
      order.begin(), order.begin() + static_cast<std::ptrdiff_t>(outermost) - 1, order.end(),
      [&](std::size_t a, std::size_t b) { return g[a] != g[b] ? g[a] < g[b] : a < b; });
  return Fill(order, count, total);
}

}  // namespace

DualSolution SolveDual(const core::Matrix& samples, const Extent& extent,
                       const OneClassSvmOptions& options, Scratch& scratch, FitSummary& summary) {
  core::Workers workers(options.threads);
  return Solve(samples, extent, options, scratch, workers, summary);
}

}  // namespace dfr::kernel::internal
