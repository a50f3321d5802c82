#include "smo/weighted_dual.h"

#include <algorithm>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "gaussian/gaussian_sum.h"
#include "smo/kkt.h"

namespace dfr::kernel::internal {
namespace {

class WeightedSolver {
 public:
  WeightedSolver(const core::Matrix& samples, const OneClassSvmOptions& options,
                 FitSummary& summary)
      : options_(options),
        summary_(summary),
        terms_(samples, {}, options.gamma),
        point_(terms_.dim),
        row_i_(terms_.row_size()),
        row_j_(terms_.row_size()),
        alpha_(terms_.count, 0.0),
        gradient_(terms_.count, 0.0),
        fresh_(terms_.count),
        most_rows_(std::max<std::size_t>(1, kWork / (terms_.row_size() * (terms_.dim + 8)))) {
    double rest = options.nu * std::accumulate(options.weights.begin(), options.weights.end(), 0.0);
    for (std::size_t i = 0; i < alpha_.size() && rest > 0.0; ++i) {
      alpha_[i] = std::min(options.weights[i], rest);
      rest -= alpha_[i];
    }
  }

  void Run() {
    using Reason = FitSummary::Reason;
    const std::int64_t most = MostIterations(options_, alpha_.size());
    // Each step adds rounding errors to the gradient. If a recomputed gradient does not confirm
    // convergence, the next round starts from it.
    constexpr int kRounds = 3;
    for (int round = 0; round < kRounds; ++round) {
      if (!ComputeGradient()) return Finish(Reason::kInterrupted);
      bool moves = true;
      while (true) {
        const Bounds bounds = Scan();
        summary_.kkt_gap = bounds.gap();
        if (summary_.kkt_gap < options_.tolerance || !moves) break;
        if (summary_.iterations >= most) return Finish(Reason::kMaxIterations);
        if (!Continue()) return Finish(Reason::kInterrupted);
        ++summary_.iterations;
        moves = Step(bounds.smallest_at);
      }
    }
    if (!ComputeGradient()) return Finish(Reason::kInterrupted);
    summary_.kkt_gap = Scan().gap();
    Finish(summary_.kkt_gap < options_.tolerance ? Reason::kConverged : Reason::kStalled);
  }

  [[nodiscard]] DualSolution Solution() const {
    if (known_) return {core::AsVector(alpha_), Scan().rho(), {}};
    // Without G, the caller computes rho as the mean G of a few support vectors.
    constexpr std::size_t kEnough = 8;
    DualSolution solution{core::AsVector(alpha_), 0.0, {}};
    const std::vector<std::size_t> support = Support(alpha_);
    const std::size_t count = std::min(kEnough, support.size());
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t i = support[k * support.size() / count];
      solution.rho_samples.push_back({static_cast<Eigen::Index>(i), 0.0});
    }
    return solution;
  }

 private:
  // Number of kernel operations between two reports of progress.
  static constexpr std::size_t kWork = std::size_t{1} << 24;

  struct Bounds : KktBounds {
    std::size_t smallest_at = 0;
  };

  // The upper bound of alpha is its weight.
  [[nodiscard]] Bounds Scan() const {
    Bounds bounds;
    for (std::size_t i = 0; i < alpha_.size(); ++i) {
      const double g = gradient_[i];
      const bool may_grow = alpha_[i] < options_.weights[i];
      if (may_grow && g < bounds.smallest) {
        bounds.smallest = g;
        bounds.smallest_at = i;
      }
      if (alpha_[i] <= 0.0) continue;
      bounds.largest = std::max(bounds.largest, g);
      if (!may_grow) continue;
      bounds.free_sum += g;
      ++bounds.free;
    }
    return bounds;
  }

  void ComputeRow(std::size_t i, AlignedVector<double>& row) {
    terms_.Point(i, point_.data());
    GaussianRow(terms_, point_.data(), row.data());
    summary_.kernel_evaluations += static_cast<std::int64_t>(terms_.count);
    ++rows_;
  }

  // Reports progress several times a second. Returns false if the fit must stop.
  [[nodiscard]] bool Continue() {
    if (rows_ < most_rows_) return true;
    rows_ = 0;
    return GoOn(options_, summary_);
  }

  // Returns false, and keeps the previous gradient, if the fit must stop.
  [[nodiscard]] bool ComputeGradient() {
    std::fill(fresh_.begin(), fresh_.end(), 0.0);
    for (std::size_t i = 0; i < alpha_.size(); ++i) {
      if (alpha_[i] == 0.0) continue;
      if (!Continue()) return false;
      ComputeRow(i, row_i_);
      for (std::size_t k = 0; k < alpha_.size(); ++k) fresh_[k] += alpha_[i] * row_i_[k];
    }
    gradient_.swap(fresh_);
    known_ = true;
    return true;
  }

  // Moves alpha to sample i from the sample whose step decreases the objective most. Returns false
  // if rounding allows no step.
  bool Step(std::size_t i) {
    ComputeRow(i, row_i_);
    // Lower limit of the curvature, used for equal points: the step then ends at a bound.
    constexpr double kLeastCurvature = 1e-12;
    std::size_t j = alpha_.size();
    double best = 0.0;
    for (std::size_t k = 0; k < alpha_.size(); ++k) {
      const double slope = gradient_[k] - gradient_[i];
      if (alpha_[k] <= 0.0 || slope <= 0.0) continue;
      const double gain = slope * slope / std::max(2.0 - 2.0 * row_i_[k], kLeastCurvature);
      if (gain > best) {
        best = gain;
        j = k;
      }
    }
    if (j == alpha_.size()) return false;
    ComputeRow(j, row_j_);
    const double curvature = std::max(2.0 - 2.0 * row_i_[j], kLeastCurvature);
    const double wanted = (gradient_[j] - gradient_[i]) / curvature;
    const double room = options_.weights[i] - alpha_[i];
    const double step = std::min({wanted, alpha_[j], room});
    if (alpha_[i] + step == alpha_[i] && alpha_[j] - step == alpha_[j]) return false;
    // Sets alpha exactly to the reached bound, without rounding.
    alpha_[i] = step >= room ? options_.weights[i] : alpha_[i] + step;
    alpha_[j] = step >= alpha_[j] ? 0.0 : alpha_[j] - step;
    for (std::size_t k = 0; k < alpha_.size(); ++k) gradient_[k] += step * (row_i_[k] - row_j_[k]);
    return true;
  }

  void Finish(FitSummary::Reason reason) {
    summary_.reason = reason;
    summary_.objective =
        known_ ? Objective(alpha_, gradient_) : std::numeric_limits<double>::infinity();
  }

  const OneClassSvmOptions& options_;
  FitSummary& summary_;
  GaussianTerms<double> terms_;
  std::vector<double> point_;
  AlignedVector<double> row_i_;
  AlignedVector<double> row_j_;
  std::vector<double> alpha_;
  std::vector<double> gradient_;
  std::vector<double> fresh_;
  std::size_t most_rows_;
  std::size_t rows_ = most_rows_;  // rows since the last report; initially, a report is due
  bool known_ = false;             // true if gradient_ belongs to alpha_
};

}  // namespace

DualSolution SolveWeightedDual(const core::Matrix& samples, const OneClassSvmOptions& options,
                               FitSummary& summary) {
  WeightedSolver solver(samples, options, summary);
  solver.Run();
  return solver.Solution();
}

}  // namespace dfr::kernel::internal
