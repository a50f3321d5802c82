#include "dfr/core/numerics/folds.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <numeric>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/spanning_tree.h"
#include "dfr/core/random.h"

namespace dfr::core {
namespace {

// Number of states that represent a demonstration.
constexpr int kLandmarks = 5;

// Returns entry i of a demonstration: the numbers of rows, then states, then controls. NaN sorts
// last.
double Entry(std::span<const Matrix* const> parts, std::size_t i) {
  if (i < parts.size()) return static_cast<double>(parts[i]->rows());
  i -= parts.size();
  for (const Matrix* part : parts) {
    const auto size = static_cast<std::size_t>(part->size());
    if (i < size) {
      const double value = part->data()[i];
      return std::isnan(value) ? std::numeric_limits<double>::infinity() : value;
    }
    i -= size;
  }
  return 0.0;
}

std::size_t Entries(std::span<const Matrix* const> parts) {
  std::size_t count = parts.size();
  for (const Matrix* part : parts) count += static_cast<std::size_t>(part->size());
  return count;
}

template <typename Real>
Real Rounded(double value) {
  constexpr double kMost = std::numeric_limits<Real>::max();
  return static_cast<Real>(std::clamp(value, -kMost, kMost));
}

// Returns the index of the first entry that differs after conversion to `Real`; the smaller number
// of entries if none differs.
template <typename Real>
std::size_t FirstDifference(std::span<const Matrix* const> a, std::span<const Matrix* const> b) {
  const std::size_t count = std::min(Entries(a), Entries(b));
  std::size_t i = 0;
  while (i < count && Rounded<Real>(Entry(a, i)) == Rounded<Real>(Entry(b, i))) ++i;
  return i;
}

template <typename Real>
int Compare(std::span<const Matrix* const> a, std::span<const Matrix* const> b) {
  const std::size_t i = FirstDifference<Real>(a, b);
  const auto x = Rounded<Real>(Entry(a, i));
  const auto y = Rounded<Real>(Entry(b, i));
  return x < y ? -1 : static_cast<int>(x > y);
}

// Rounds to 12 binary digits: machines whose arithmetic differs in the last bits agree.
std::uint64_t CoarseBits(double value) {
  constexpr int kDigits = 12;
  int exponent = 0;
  const double fraction = std::frexp(value, &exponent);
  // Adding zero removes the sign of a negative zero.
  const double coarse =
      std::ldexp(std::round(std::ldexp(fraction, kDigits)), exponent - kDigits) + 0.0;
  std::uint64_t bits = 0;
  std::memcpy(&bits, &coarse, sizeof(bits));
  return bits;
}

// Sorts demonstrations by their contents `parts_of(d)`, then shuffles them, because neighbours in
// sorted order have similar first entries. The seed of the shuffle includes the entries that
// decided the sort: with `seed` alone, the first few demonstrations would always have the same
// ranks.
template <typename PartsOf>
std::vector<std::size_t> Order(std::size_t demonstrations, std::uint64_t seed,
                               const PartsOf& parts_of) {
  std::vector<std::size_t> order(demonstrations);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const auto left = parts_of(a);
    const auto right = parts_of(b);
    const int coarse = Compare<float>(left, right);
    return coarse != 0 ? coarse < 0 : Compare<double>(left, right) < 0;
  });
  for (std::size_t k = 1; k < demonstrations; ++k) {
    const auto before = parts_of(order[k - 1]);
    const auto here = parts_of(order[k]);
    const std::size_t i = FirstDifference<float>(before, here);
    seed = DeriveSeed(seed, {i, CoarseBits(Entry(before, i)), CoarseBits(Entry(here, i))});
  }
  Random(seed).Shuffle(std::span(order));
  return order;
}

void Check(std::size_t demonstrations, int folds) {
  DFR_THROW_UNLESS(folds >= 2, "folds must be at least 2, not " << folds);
  DFR_THROW_UNLESS(demonstrations >= static_cast<std::size_t>(folds),
                   folds << " folds need at least as many demonstrations, not " << demonstrations);
}

// Returns one row per demonstration: its concatenated landmarks.
Matrix Landmarks(std::span<const Matrix> demonstrations) {
  const Eigen::Index n = demonstrations[0].cols();
  Matrix landmarks(std::ssize(demonstrations), kLandmarks * n);
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const Matrix& states = demonstrations[d];
    DFR_THROW_UNLESS(states.rows() >= 1 && states.cols() == n,
                     "demonstration " << d << " is " << states.rows() << " x " << states.cols()
                                      << ", but demonstration 0 has " << n << " columns");
    for (int i = 0; i < kLandmarks; ++i) {
      // Interpolates between rows. Rounding to a row would separate demonstrations of different
      // lengths.
      const double at = static_cast<double>(states.rows() - 1) * i / (kLandmarks - 1);
      const auto row = std::min(static_cast<Eigen::Index>(at), states.rows() - 1);
      const Eigen::Index next = std::min(row + 1, states.rows() - 1);
      landmarks.row(static_cast<Eigen::Index>(d)).segment(i * n, n) =
          states.row(row) + (at - static_cast<double>(row)) * (states.row(next) - states.row(row));
    }
  }
  return landmarks;
}

// Returns the cluster of each row.
std::vector<std::size_t> Clusters(const Matrix& points) {
  const std::vector<Link> links = SpanningTree(points);
  const double longest = kClusterGap * LinkMedian(links);
  std::vector<std::size_t> cluster(static_cast<std::size_t>(points.rows()), 0);
  std::size_t count = 1;
  for (const Link& link : links) {
    cluster[link.to] = link.length > longest ? count++ : cluster[link.from];
  }
  return cluster;
}

}  // namespace

std::vector<std::size_t> DeterministicOrder(std::span<const Trajectory> demonstrations,
                                            std::uint64_t seed) {
  return Order(demonstrations.size(), seed, [&](std::size_t d) {
    return std::array{&demonstrations[d].states, &demonstrations[d].controls};
  });
}

std::vector<std::size_t> DeterministicOrder(std::span<const Matrix> demonstrations,
                                            std::uint64_t seed) {
  return Order(demonstrations.size(), seed,
               [&](std::size_t d) { return std::array{&demonstrations[d]}; });
}

std::vector<Trajectory> InDeterministicOrder(std::span<const Trajectory> demonstrations,
                                             std::uint64_t seed) {
  std::vector<Trajectory> ordered;
  ordered.reserve(demonstrations.size());
  for (const std::size_t d : DeterministicOrder(demonstrations, seed)) {
    ordered.push_back(demonstrations[d]);
  }
  return ordered;
}

Folds StratifiedFolds(std::span<const Matrix> demonstrations, int folds, std::uint64_t seed) {
  Check(demonstrations.size(), folds);
  const std::vector<std::size_t> cluster = Clusters(Landmarks(demonstrations));
  const std::vector<std::size_t> order = DeterministicOrder(demonstrations, seed);
  std::vector<std::size_t> size(demonstrations.size(), 0);
  for (const std::size_t c : cluster) ++size[c];
  // Strata in the order of their first members in `order`. Clusters that are too small share a
  // stratum.
  std::vector<std::size_t> strata;
  std::vector<std::size_t> dealt;
  const std::size_t rest = demonstrations.size();
  const auto stratum = [&](std::size_t d) {
    return size[cluster[d]] >= static_cast<std::size_t>(folds) ? cluster[d] : rest;
  };
  for (const std::size_t d : order) {
    if (std::find(strata.begin(), strata.end(), stratum(d)) == strata.end()) {
      strata.push_back(stratum(d));
    }
  }
  for (const std::size_t s : strata) {
    for (const std::size_t d : order) {
      if (stratum(d) == s) dealt.push_back(d);
    }
  }
  Folds groups(static_cast<std::size_t>(folds));
  for (std::size_t i = 0; i < dealt.size(); ++i) groups[i % groups.size()].push_back(dealt[i]);
  return groups;
}

Folds ContiguousFolds(std::size_t demonstrations, int folds) {
  Check(demonstrations, folds);
  Folds groups(static_cast<std::size_t>(folds));
  for (std::size_t d = 0; d < demonstrations; ++d) {
    groups[d * groups.size() / demonstrations].push_back(d);
  }
  return groups;
}

std::vector<std::size_t> Others(const Folds& folds, std::size_t left_out,
                                std::span<const std::size_t> order) {
  const std::vector<std::size_t>& without = folds[left_out];
  std::vector<std::size_t> others;
  others.reserve(order.size());
  for (const std::size_t d : order) {
    if (std::find(without.begin(), without.end(), d) == without.end()) others.push_back(d);
  }
  return others;
}

}  // namespace dfr::core
