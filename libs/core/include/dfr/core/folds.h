#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// Demonstrations in an order that follows from `seed` and from what each of them holds: the order
/// in which they were recorded or read changes nothing. They are sorted by their first entry that
/// differs in single precision, so that machines whose arithmetic differs in a last bit agree;
/// exact values decide where none does. A shuffle follows, by `seed` and by what decided the
/// sorting, so that the first few are a random sample and not always the same ranks. Of
/// demonstrations that are equal it does not matter which comes first. A NaN counts as infinite.
[[nodiscard]] std::vector<std::size_t> ContentOrder(std::span<const Trajectory> demonstrations,
                                                    std::uint64_t seed = 0);
/// The same of states or features alone.
[[nodiscard]] std::vector<std::size_t> ContentOrder(std::span<const Matrix> demonstrations,
                                                    std::uint64_t seed = 0);

/// The demonstrations themselves in ContentOrder(), so that whatever is fitted to them is the same
/// to the last bit for every order they may come in.
[[nodiscard]] std::vector<Trajectory> InContentOrder(std::span<const Trajectory> demonstrations,
                                                     std::uint64_t seed = 0);

/// Groups of demonstrations to be left out of a fit together, by their indices; each is in one.
using Folds = std::vector<std::vector<std::size_t>>;

/// `folds` groups whose sizes differ by one at most, dealt out in ContentOrder(). Where
/// demonstrations fall into clusters (ways, goals) of `folds` members and more, each cluster is
/// dealt out by itself, so that no fit misses one. Clusters are what single linkage has left once
/// the links beyond three times their median are cut; the distance of two demonstrations is that of
/// five states each, from the first to the last at equal shares of their length.
/// @param demonstrations  features, one row a time step, on comparable scales (whitened ones).
/// @throws std::invalid_argument if there are fewer demonstrations than folds, fewer than two
///   folds, widths differ, or a demonstration has no row.
[[nodiscard]] Folds StratifiedFolds(std::span<const Matrix> demonstrations, int folds,
                                    std::uint64_t seed = 0);

/// `folds` groups of demonstrations that were recorded one after the other. What a fit without one
/// of them makes of it shows how far conditions of recording drift.
/// @throws std::invalid_argument if there are fewer demonstrations than folds, or fewer than two
///   folds.
[[nodiscard]] Folds ContiguousFolds(std::size_t demonstrations, int folds);

/// The demonstrations of all folds but number `left_out`, in the order of `order`.
[[nodiscard]] std::vector<std::size_t> Others(const Folds& folds, std::size_t left_out,
                                              std::span<const std::size_t> order);

}  // namespace dfr::core
