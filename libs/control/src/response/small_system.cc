#include "small_system.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace dfr::control::internal {
namespace {

// Eigen factors larger matrices by blocks, which changes the order of sums.
constexpr Eigen::Index kSmall = 32;
// Number of rows that Eigen solves together before it updates the others.
constexpr Eigen::Index kPanel = 4;

// Factors tiles of kMostOnStack rows and columns.
void FactorTiles(Eigen::MatrixXd& a) noexcept {
  const Eigen::Index n = a.rows();
  const auto tile = [&](Eigen::Index i, Eigen::Index j) {
    return a.block(i, j, std::min(kMostOnStack, n - i), std::min(kMostOnStack, n - j));
  };
  for (Eigen::Index k = 0; k < n; k += kMostOnStack) {
    for (Eigen::Index i = k; i < n; i += kMostOnStack) {
      for (Eigen::Index j = 0; j < k; j += kMostOnStack) {
        tile(i, k).noalias() -= tile(i, j) * tile(k, j).transpose();
      }
    }
    auto diagonal = tile(k, k);
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> in_place(diagonal);
    if (in_place.info() != Eigen::Success) return;
    for (Eigen::Index i = k + kMostOnStack; i < n; i += kMostOnStack) {
      auto below = tile(i, k);
      diagonal.triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(below);
    }
  }
}

}  // namespace

void Factor(Eigen::MatrixXd& a) noexcept {
  const Eigen::Index n = a.rows();
  if (n > kMostOnStack) return FactorTiles(a);
  if (n >= kSmall) {
    Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> in_place(a);
    return;
  }
  std::array<double, kSmall> row;
  for (Eigen::Index k = 0; k < n; ++k) {
    double square = 0.0;
    for (Eigen::Index j = 0; j < k; ++j) {
      const double entry = a(k, j);
      row[static_cast<std::size_t>(j)] = entry;
      square += entry * entry;
    }
    double pivot = a(k, k) - square;
    if (pivot <= 0.0) return;
    pivot = std::sqrt(pivot);
    a(k, k) = pivot;
    double* below = &a(k, k) + 1;
    const Eigen::Index rows = n - k - 1;
    if (k == 0) {
      Eigen::Map<Eigen::ArrayXd>(below, rows) /= pivot;
      continue;
    }
    ForSumsOfColumns(a.data() + k + 1, rows, n, row.data(), k,
                     [&](Eigen::Index i, const auto& sums) {
                       auto part = Part(below, i, sums);
                       part = (part - sums) / pivot;
                     });
  }
}

void SolveFactored(const Eigen::MatrixXd& l, Eigen::MatrixXd& x) noexcept {
  const Eigen::Index n = l.rows();
  if (n > kMostOnStack) {
    auto column = x.col(0);
    l.triangularView<Eigen::Lower>().solveInPlace(column);
    l.triangularView<Eigen::Lower>().adjoint().solveInPlace(column);
    return;
  }
  if (n >= kSmall) {
    l.triangularView<Eigen::Lower>().solveInPlace(x);
    l.triangularView<Eigen::Lower>().adjoint().solveInPlace(x);
    return;
  }
  double* b = x.data();
  for (Eigen::Index first = 0; first < n; first += kPanel) {
    const Eigen::Index end = std::min(first + kPanel, n);
    for (Eigen::Index i = first; i < end; ++i) {
      b[i] *= 1.0 / l(i, i);
      for (Eigen::Index k = i + 1; k < end; ++k) b[k] -= b[i] * l(k, i);
    }
    ForSumsOfColumns(&l(0, first) + end, n - end, n, b + first, end - first,
                     [&](Eigen::Index i, const auto& sums) { Part(b + end, i, sums) -= sums; });
  }
  for (Eigen::Index end = n; end > 0; end -= std::min(kPanel, end)) {
    const Eigen::Index first = std::max<Eigen::Index>(0, end - kPanel);
    for (Eigen::Index i = end - 1; i >= first; --i) {
      double sum = 0.0;
      for (Eigen::Index k = i + 1; k < end; ++k) sum += l(k, i) * b[k];
      b[i] = (b[i] - sum) * (1.0 / l(i, i));
    }
    for (Eigen::Index i = 0; i < first; ++i) {
      double sum = 0.0;
      for (Eigen::Index k = first; k < end; ++k) sum += l(k, i) * b[k];
      b[i] -= sum;
    }
  }
}

}  // namespace dfr::control::internal
