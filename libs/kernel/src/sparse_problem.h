#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "active_set.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "gaussian_terms.h"
#include "kkt.h"
#include "large_memory.h"
#include "smo_loop.h"
#include "workers.h"

namespace dfr::kernel::internal {

/// Sparse rows, the oldest of which make room where memory is short.
template <typename T>
class SparseRows {
 public:
  /// Room for `bytes`, but for four rows of `groups` groups at least and no more than all `rows`.
  SparseRows(std::size_t rows, std::size_t groups, double bytes);

  /// None of `rows` rows, which are not longer than was said at first, is there.
  void Reset(std::size_t rows);

  [[nodiscard]] const SparseRow<T>* table() const { return rows_.data(); }
  [[nodiscard]] bool Has(std::size_t i) const { return rows_[i].groups != nullptr; }
  /// Whether a row of `count` groups would make none go.
  [[nodiscard]] bool HasRoom(std::size_t count) const;
  /// Room for row i, which is not there, of `count` groups: to be written by the caller. Row `keep`
  /// stays.
  void Make(std::size_t i, std::size_t count, std::size_t keep);
  /// Copies what Make() made room for.
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
  /// @pre terms are whole groups
  SparseKernel(GaussianTerms<T> terms, double reach);

  /// A row before it is known how large it is.
  struct Draft {
    std::vector<std::uint32_t> groups;
    AlignedVector<T> values;
    std::size_t count = 0;     // groups
    std::size_t computed = 0;  // kernel values
    [[nodiscard]] SparseRow<T> row() const { return {groups.data(), values.data(), count}; }
  };
  /// The row of x' = `point`.
  void Compute(const T* point, Draft& draft) const;

  [[nodiscard]] const GaussianTerms<T>& terms() const { return terms_; }
  [[nodiscard]] std::size_t groups() const { return boxes_.count; }

 private:
  GaussianTerms<T> terms_;
  GroupBoxes<T> boxes_;
  T reach_;
};

/// A dual whose kernel is narrow. As in the solver for others, an outer loop knows the exact
/// gradient of all samples and an inner one does SMO on an active set; but rows hold only what is
/// not negligible, so that a step costs what two samples reach and not what all are.
template <typename T>
class SparseProblem {
 public:
  /// Whether most kernel values are negligible, judged by some of the samples.
  [[nodiscard]] static bool Fits(const core::Matrix& samples, const OneClassSvmOptions& options);

  /// All arguments must outlive the problem.
  SparseProblem(const core::Matrix& samples, const OneClassSvmOptions& options, Workers& workers,
                FitSummary& summary);

  /// Solves from `start`, which is feasible. Writes reason, iterations, gap and objective to the
  /// summary.
  void Run(std::span<const double> start);

  [[nodiscard]] std::span<const double> alpha() const { return alpha_; }
  [[nodiscard]] std::span<const double> gradient() const { return gradient_; }
  [[nodiscard]] std::int64_t evaluations() const { return evaluations_; }
  [[nodiscard]] std::span<const double> center() const { return kernel_.terms().center; }
  /// What entries of the gradient may lack.
  [[nodiscard]] double neglected() const { return kNegligible * options_.tolerance; }

 private:
  // All values left out of G together, for alpha that sum to nu m, are below this part of the
  // tolerance.
  static constexpr double kNegligible = 1.0 / 32.0;
  static double Reach(const core::Matrix& samples, const OneClassSvmOptions& options);

  // The samples that rows are over, and the rows that are known.
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
  Workers& workers_;
  SmoFunctions<T> smo_;
  double reach_;
  std::vector<std::size_t> order_;  // sample of each place
  SparseKernel<T> kernel_;          // of all samples
  ActiveSet chosen_;
  std::optional<Active> active_;
  SparseRows<T> rows_;  // of the active samples
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
