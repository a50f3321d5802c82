#include "smo_solver.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <list>
#include <vector>

#include "gaussian_sum.h"

namespace dfr::kernel::internal {
namespace {

// Rows of the kernel matrix, computed when first asked for and kept while the budget lasts; then
// the row that was used longest ago makes room.
class KernelRows {
 public:
  KernelRows(const core::Matrix& samples, double gamma, double budget_bytes)
      : terms_(samples, {}, gamma),
        stride_(terms_.num_blocks * GaussianTerms<double>::kLanes),
        query_(terms_.dim),
        rows_(terms_.count) {
    const double row_bytes = static_cast<double>(stride_ * sizeof(double));
    const double count = std::clamp(budget_bytes / row_bytes, 2.0, 1e9);  // a step needs two
    capacity_ = std::min(terms_.count, static_cast<std::size_t>(count));
  }

  const double* Row(std::size_t i) {
    Slot& slot = rows_[i];
    if (!slot.values.empty()) {
      recent_.splice(recent_.begin(), recent_, slot.position);
      return slot.values.data();
    }
    if (recent_.size() == capacity_) {
      const std::size_t oldest = recent_.back();
      recent_.pop_back();
      slot.values = std::move(rows_[oldest].values);
      rows_[oldest].values.clear();
    } else {
      slot.values.resize(stride_);
    }
    recent_.push_front(i);
    slot.position = recent_.begin();
    for (std::size_t k = 0; k < terms_.dim; ++k) query_[k] = terms_.coordinate(i, k);
    GaussianRow(terms_, query_.data(), slot.values.data());
    evaluations_ += static_cast<std::int64_t>(terms_.count);
    return slot.values.data();
  }

  [[nodiscard]] std::int64_t evaluations() const noexcept { return evaluations_; }

 private:
  struct Slot {
    AlignedVector<double> values;
    std::list<std::size_t>::iterator position;
  };
  GaussianTerms<double> terms_;
  std::size_t stride_;
  std::size_t capacity_ = 0;
  std::vector<double> query_;
  std::vector<Slot> rows_;
  std::list<std::size_t> recent_;
  std::int64_t evaluations_ = 0;
};

// Mean of G over the free alpha; without any, the middle of the interval that the KKT conditions
// leave, or its finite end.
double Rho(const Eigen::VectorXd& alpha, const std::vector<double>& gradient) {
  double free_sum = 0.0;
  int free_count = 0;
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
  for (Eigen::Index i = 0; i < alpha.size(); ++i) {
    const double g = gradient[static_cast<std::size_t>(i)];
    if (alpha[i] >= 1.0) {
      low = std::max(low, g);
    } else if (alpha[i] <= 0.0) {
      high = std::min(high, g);
    } else {
      free_sum += g;
      ++free_count;
    }
  }
  if (free_count > 0) return free_sum / free_count;
  if (std::isinf(high)) return low;  // nu = 1: every sample at its bound
  if (std::isinf(low)) return high;
  return 0.5 * (low + high);
}

}  // namespace

DualSolution SolveDual(const core::Matrix& samples, const OneClassSvmOptions& options,
                       FitSummary& summary) {
  const auto m = static_cast<std::size_t>(samples.rows());
  KernelRows rows(samples, options.gamma, options.memory_mib * 0x1p20);

  // LIBSVM's start: the first nu m samples at the bound.
  Eigen::VectorXd alpha = Eigen::VectorXd::Zero(samples.rows());
  std::vector<double> gradient(m, 0.0);
  double rest = options.nu * static_cast<double>(m);
  for (std::size_t i = 0; i < m && rest > 0.0; ++i) {
    const double a = std::min(1.0, rest);
    alpha[static_cast<Eigen::Index>(i)] = a;
    rest -= a;
    const double* row = rows.Row(i);
    for (std::size_t j = 0; j < m; ++j) gradient[j] += a * row[j];
  }

  const std::int64_t max_iterations =
      options.max_iterations > 0
          ? options.max_iterations
          : std::max<std::int64_t>(10'000'000, 100 * static_cast<std::int64_t>(m));
  double* a = alpha.data();
  summary.reason = FitSummary::Reason::kMaxIterations;
  while (true) {
    // Pair: i gains where its gradient is smallest; j gives, chosen for the largest decrease.
    std::size_t i = m;
    double smallest = std::numeric_limits<double>::infinity();
    double largest = -std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < m; ++k) {
      if (a[k] < 1.0 && gradient[k] < smallest) {
        smallest = gradient[k];
        i = k;
      }
      if (a[k] > 0.0) largest = std::max(largest, gradient[k]);
    }
    summary.kkt_gap = i == m ? 0.0 : std::max(0.0, largest - smallest);
    if (summary.kkt_gap < options.tolerance) {
      summary.reason = FitSummary::Reason::kConverged;
      break;
    }
    if (summary.iterations == max_iterations) break;
    ++summary.iterations;

    // Equal points have no curvature between them; a tiny one makes the step end at a bound.
    constexpr double kLeastCurvature = 1e-12;
    const double* row_i = rows.Row(i);
    std::size_t j = m;
    double best = 0.0;
    for (std::size_t k = 0; k < m; ++k) {
      const double slope = gradient[k] - smallest;
      if (a[k] > 0.0 && slope > 0.0) {
        const double decrease = slope * slope / std::max(2.0 - 2.0 * row_i[k], kLeastCurvature);
        if (decrease > best) {
          best = decrease;
          j = k;
        }
      }
    }
    const double curvature = std::max(2.0 - 2.0 * row_i[j], kLeastCurvature);
    const double wanted = (gradient[j] - smallest) / curvature;
    double step = wanted;
    if (wanted >= a[j] || wanted >= 1.0 - a[i]) {
      step = std::min(a[j], 1.0 - a[i]);
      // Exactly at the bound, whatever the rounding.
      const bool empties = a[j] <= 1.0 - a[i];
      const bool fills = 1.0 - a[i] <= a[j];
      a[i] = fills ? 1.0 : a[i] + step;
      a[j] = empties ? 0.0 : a[j] - step;
    } else {
      a[i] += step;
      a[j] -= step;
    }
    const double* row_j = rows.Row(j);
    for (std::size_t k = 0; k < m; ++k) gradient[k] += step * (row_i[k] - row_j[k]);
  }

  summary.objective = 0.0;
  for (std::size_t k = 0; k < m; ++k) summary.objective += 0.5 * a[k] * gradient[k];
  summary.kernel_evaluations = rows.evaluations();
  const double rho = Rho(alpha, gradient);
  return {std::move(alpha), rho};
}

}  // namespace dfr::kernel::internal
