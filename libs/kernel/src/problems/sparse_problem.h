#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/workers.h"
#include "dfr/kernel/one_class_svm.h"
#include "gaussian/gaussian_terms.h"
#include "problems/large_memory.h"
#include "smo/active_set.h"
#include "smo/kkt.h"
#include "smo/smo_loop.h"

namespace dfr::kernel::internal {

/// Cache of sparse rows. When the memory is full, it evicts the oldest rows.
template <typename T>
class SparseRows {
 public:
  /// Allocates `bytes` bytes, but at least room for four rows of `groups` groups and at most room
  /// for `rows` such rows.
  SparseRows(std::size_t rows, std::size_t groups, double bytes);

  /// Evicts all rows and sets their number. Rows must not be longer than at construction.
  void Reset(std::size_t rows);

  [[nodiscard]] const SparseRow<T>* table() const { return rows_.data(); }
  [[nodiscard]] bool Has(std::size_t i) const { return rows_[i].groups != nullptr; }
  /// Returns true if a row of `count` groups fits without evicting another.
  [[nodiscard]] bool HasRoom(std::size_t count) const;
  /// Reserves room for `count` groups of row i, which must not be in the cache. Does not evict row
  /// `keep`. The caller then calls Write().
  void Make(std::size_t i, std::size_t count, std::size_t keep);
  /// Writes the row that Make() reserved room for.
  void Write(std::size_t i, const std::uint32_t* groups, const T* values);

 private:
  struct Place {
    std::size_t row;
    std::size_t begin;
    std::size_t end;
  };
  static std::size_t Bytes(std::size_t count);

  std::vector<SparseRow<T>> rows_;
  LargeMemory memory_;
  std::size_t head_ = 0;
  std::deque<Place> places_;  // oldest first
};

/// Computes sparse rows of some terms.
template <typename T>
class SparseKernel {
 public:
  /// @pre the terms fill whole groups
  SparseKernel(GaussianTerms<T> terms, double reach);

  /// Buffer for a row whose size Compute() determines.
  struct Draft {
    std::vector<std::uint32_t> groups;
    AlignedVector<T> values;
    std::size_t count = 0;     // number of groups
    std::size_t computed = 0;  // number of computed kernel values
    [[nodiscard]] SparseRow<T> row() const { return {groups.data(), values.data(), count}; }
  };
  /// Computes the row of x' = `point`.
  void Compute(const T* point, Draft& draft) const;

  [[nodiscard]] const GaussianTerms<T>& terms() const { return terms_; }
  [[nodiscard]] std::size_t groups() const { return boxes_.count; }

 private:
  GaussianTerms<T> terms_;
  GroupBoxes<T> boxes_;
  T reach_;
};

/// A dual problem with a narrow kernel. As in the general solver, an outer loop keeps the exact
/// gradient of all samples, and an inner loop does SMO on an active set. Rows hold only values that
/// are not negligible: a step updates only the samples within reach of its two samples.
template <typename T>
class SparseProblem {
 public:
  /// Returns true if memory suffices and most kernel values in a sample of pairs are negligible.
  [[nodiscard]] static bool Fits(const core::Matrix& samples, const OneClassSvmOptions& options);

  /// All arguments must outlive the problem.
  SparseProblem(const core::Matrix& samples, const OneClassSvmOptions& options,
                core::Workers& workers, FitSummary& summary);

  /// Solves from a feasible `start`. Writes reason, iterations, gap and objective to the summary.
  void Run(std::span<const double> start);

  [[nodiscard]] std::span<const double> alpha() const { return alpha_; }
  [[nodiscard]] std::span<const double> gradient() const { return gradient_; }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  [[nodiscard]] std::span<const double> center() const { return kernel_.terms().center; }
  /// Error bound for entries of the gradient.
  [[nodiscard]] double neglected() const { return kNegligible * options_.tolerance; }

 private:
  // The sum of all values left out of G is below this fraction of the tolerance, for alpha that sum
  // to nu m.
  static constexpr double kNegligible = 1.0 / 32.0;
  static double Reach(const core::Matrix& samples, const OneClassSvmOptions& options);

  // Active samples, and the kernel that computes rows over them.
  struct Active {
    std::vector<std::size_t> places;  // ascending
    SparseKernel<T> kernel;
  };
  using Draft = typename SparseKernel<T>::Draft;

  [[nodiscard]] bool AddToGradient(std::span<const std::size_t> places,
                                   std::span<const double> change);
  void ComputeAhead(std::span<const std::size_t> wanted);
  void Compute(std::size_t i, std::size_t keep);
  void Activate();
  [[nodiscard]] bool SolveActive(double rho);
  void Iterate();
  [[nodiscard]] std::size_t Together() const;

  const OneClassSvmOptions& options_;
  FitSummary& summary_;
  core::Workers& workers_;
  SmoFunctions<T> smo_;
  double reach_;
  std::vector<std::size_t> order_;  // sample at each position
  SparseKernel<T> kernel_;          // rows over all samples
  ActiveSet chosen_;
  std::optional<Active> active_;
  SparseRows<T> rows_;  // rows over the active samples
  std::vector<T> point_;
  Draft draft_;
  std::vector<Draft> drafts_;
  std::vector<double> placed_alpha_;
  AlignedVector<double> placed_gradient_;
  Rounds rounds_;
  std::vector<double> alpha_;
  std::vector<double> gradient_;
  std::int64_t evaluations_ = 0;
};

}  // namespace dfr::kernel::internal
