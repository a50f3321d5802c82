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

/// Split-conformal threshold: with `scores` of n exchangeable held-out items (larger is stranger),
/// the value that a further item of the same kind exceeds with probability at most `alpha`. It is
/// the score of rank ceil((n + 1)(1 - alpha)); +infinity where that is beyond n: n items
/// cannot promise so little.
///
/// That is on average over sets of held-out items: of one set, the probability that a further item
/// stays below the score of rank k is Beta(k, n + 1 - k) distributed. With a `confidence`, k is the
/// smallest rank at which it is at least 1 - alpha for that share of sets.
/// @throws std::invalid_argument if there are no scores, one is NaN, alpha is not in (0, 1), or
///   confidence not in [0, 1).
[[nodiscard]] double ConformalThreshold(std::span<const double> scores, double alpha,
                                        double confidence = 0.0);

/// max over t of -l_t(x_t), l_t the log form of g_t: how far a demonstration leaves the support,
/// over its whole length. Negative if it never does. The score for ConformalThreshold().
[[nodiscard]] double ExcursionScore(const TimeVaryingSupport& support, const core::Matrix& states);

/// Options for SelectModel().
struct SelectionOptions {
  std::vector<double> gammas = {0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0};
  std::vector<double> nus = {0.05};
  /// Parts that are held out in turn, >= 2. Whole demonstrations: states of one demonstration
  /// resemble each other, and single ones held out would all seem familiar.
  int folds = 4;
  /// Share of held-out states that must lie inside, in (0, 1].
  double acceptance = 0.90;
  /// Held-out demonstrations that may raise a false alarm, in (0, 1); sets the threshold.
  double false_alarms = 0.1;
  /// Its nu and gamma are replaced by the candidates; its threads are those of the comparison.
  TimeVaryingSupportOptions support = {};
  std::uint64_t seed = 1;  ///< Which demonstrations share a fold.
};

/// One row of the table: what a pair of options gave on held-out demonstrations.
struct SelectionRow {
  double nu = 0.0;
  double gamma = 0.0;
  double acceptance = 0.0;         ///< Share of held-out states with g >= 0.
  double inside_throughout = 0.0;  ///< Share of held-out demonstrations that never leave.
  double threshold = 0.0;          ///< Conformal: alarm at l_t < -threshold.
  double support_vectors = 0.0;    ///< Mean over time steps and folds.
  double volume = 0.0;             ///< Share inside, of states drawn evenly from the box of all.
};

/// The table, in the order of nus and then gammas, and the row that was chosen: of those that
/// accept enough the one of least volume, so that the support holds the demonstrations and little
/// else; where none does, the one that accepts most.
struct Selection {
  std::vector<SelectionRow> rows;
  std::size_t chosen = 0;
  bool accepted = false;  ///< Whether the chosen row reaches the wanted acceptance.

  /// The table as text, the chosen row marked.
  [[nodiscard]] std::string Table() const;
};

/// Compares pairs of nu and gamma by cross-validation over whole demonstrations. The distances
/// between samples are computed once for the whole grid.
/// @throws std::invalid_argument naming the option out of range, or if there are fewer
///   demonstrations than 2 folds.
Selection SelectModel(std::span<const core::Matrix> demonstrations,
                      const SelectionOptions& options);

}  // namespace dfr::kernel
