#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// Returns the demonstrations' indices in an order that depends on `seed` and their content only,
/// not on the order of recording or reading. Two steps determine the order:
/// 1. Sort by the first entry that differs in single precision. Machines whose arithmetic differs
///    in the last bit then agree. Exact values break ties.
/// 2. Shuffle with a seed made from `seed` and the entries that decided the sort. The first few
///    demonstrations are then a random sample, not always the same ranks.
/// The order of identical demonstrations is unspecified. A NaN counts as infinite.
[[nodiscard]] std::vector<std::size_t> DeterministicOrder(
    std::span<const Trajectory> demonstrations, std::uint64_t seed = 0);
/// Overload for states or features alone.
[[nodiscard]] std::vector<std::size_t> DeterministicOrder(std::span<const Matrix> demonstrations,
                                                          std::uint64_t seed = 0);

/// Returns the demonstrations in DeterministicOrder(). A fit to the result is the same to the last
/// bit for every input order.
[[nodiscard]] std::vector<Trajectory> InDeterministicOrder(
    std::span<const Trajectory> demonstrations, std::uint64_t seed = 0);

/// Groups of demonstrations, by index. Each index belongs to exactly one group. A fit leaves out
/// one whole group.
using Folds = std::vector<std::vector<std::size_t>>;

/// Returns `folds` groups whose sizes differ by at most one, assigned in DeterministicOrder(). If
/// the demonstrations form clusters (ways to do the task, goals) of at least `folds` members, the
/// members of each cluster are spread over all folds: no fit misses a cluster. Clusters result from
/// single linkage after cutting all links longer than three times their median. The distance
/// between two demonstrations compares five states of each, at equal fractions of their lengths.
/// @param demonstrations  features, one row per time step, on comparable scales (whitened ones).
/// @throws std::invalid_argument if there are fewer demonstrations than folds, fewer than two
///   folds, widths differ, or a demonstration has no row.
[[nodiscard]] Folds StratifiedFolds(std::span<const Matrix> demonstrations, int folds,
                                    std::uint64_t seed = 0);

/// Returns `folds` groups of demonstrations that were recorded consecutively. Fits that leave one
/// group out reveal changes of the recording conditions over time.
/// @throws std::invalid_argument if there are fewer demonstrations than folds, or fewer than two
///   folds.
[[nodiscard]] Folds ContiguousFolds(std::size_t demonstrations, int folds);

/// Returns the indices of the demonstrations of all folds except `left_out`, sorted as in `order`.
[[nodiscard]] std::vector<std::size_t> Others(const Folds& folds, std::size_t left_out,
                                              std::span<const std::size_t> order);
/// Returns the `values` of all folds except `left_out`. `values` has one entry per demonstration,
/// or none.
template <typename T>
[[nodiscard]] std::vector<T> WithoutFold(const std::vector<T>& values, const Folds& folds,
                                         std::size_t left_out) {
  std::vector<T> others;
  others.reserve(values.size());
  for (std::size_t d = 0; d < values.size(); ++d) {
    const std::vector<std::size_t>& fold = folds[left_out];
    if (std::find(fold.begin(), fold.end(), d) == fold.end()) others.push_back(values[d]);
  }
  return others;
}

}  // namespace dfr::core
