#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"

namespace dfr::kernel {

/// Split-conformal threshold. For `scores` of n exchangeable held-out items (larger is more
/// unusual), returns a value that the score of a new item of the same kind exceeds with probability
/// at most `alpha`. It is the score of rank ceil((n + 1)(1 - alpha)), or +infinity if that rank
/// exceeds n: n items are too few for this alpha.
///
/// This probability is an average over sets of held-out items. For one set, the probability that a
/// new score stays below the score of rank k is Beta(k, n + 1 - k) distributed. With a positive
/// `confidence`, k is the smallest rank for which this probability is at least 1 - alpha in a
/// fraction `confidence` of all sets.
/// @throws std::invalid_argument if there are no scores, one is NaN, alpha is not in (0, 1), or
///   confidence not in [0, 1).
[[nodiscard]] double ConformalThreshold(std::span<const double> scores, double alpha,
                                        double confidence = 0.0);

/// Returns max over t of -l_t(x_t), with l_t the log form of g_t: the largest distance of a
/// demonstration from the support. The score is negative if all its states are inside.
/// ConformalThreshold() takes these scores.
[[nodiscard]] double ExcursionScore(const TimeVaryingSupport& support, const core::Matrix& states);

/// Options for SelectModel().
struct SelectionOptions {
  std::vector<double> gammas = {0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0};
  std::vector<double> nus = {0.05};
  /// Number of folds for cross-validation, >= 2. Folds hold out whole demonstrations, because the
  /// states of a demonstration resemble each other.
  int folds = 4;
  /// Fraction of held-out states that must lie inside, in (0, 1].
  double acceptance = 0.90;
  /// Fraction of held-out demonstrations that may raise a false alarm, in (0, 1). Sets the
  /// threshold.
  double false_alarms = 0.1;
  /// SelectModel() replaces nu and gamma by the candidates and ignores `svm.start`. `threads`
  /// applies to the comparison.
  TimeVaryingSupportOptions support = {};
  std::uint64_t seed = 1;  ///< Seed of the folds and of the states drawn for the volume.
};

/// One row of the table: results of one pair of nu and gamma on held-out demonstrations.
struct SelectionRow {
  double nu = 0.0;
  double gamma = 0.0;
  double acceptance = 0.0;         ///< Fraction of held-out states with g >= 0.
  double inside_throughout = 0.0;  ///< Fraction of held-out demonstrations without an exit.
  double threshold = 0.0;          ///< Conformal threshold: alarm if l_t < -threshold.
  double support_vectors = 0.0;    ///< Mean number over time steps and folds.
  double volume = 0.0;  ///< Fraction of the bounding box that is inside, by uniform sampling.
};

/// The table, in the order of nus and then gammas, and the chosen row. The chosen row has the
/// smallest volume among the rows with sufficient acceptance. If no row suffices, the chosen row
/// has the largest acceptance.
struct Selection {
  std::vector<SelectionRow> rows;
  std::size_t chosen = 0;
  bool accepted = false;  ///< True if the chosen row reaches the required acceptance.

  /// Returns the table as text with the chosen row marked.
  [[nodiscard]] std::string Table() const;
};

/// Compares pairs of nu and gamma by cross-validation over whole demonstrations. If the samples are
/// few, computes the distances between them once for the whole grid.
/// @throws std::invalid_argument naming the option that is out of range, or the demonstration that
///   is empty, not finite or of a different width from the first. Also if there are fewer than two
///   demonstrations per fold.
Selection SelectModel(std::span<const core::Matrix> demonstrations,
                      const SelectionOptions& options);

}  // namespace dfr::kernel
