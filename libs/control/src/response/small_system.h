#pragma once

#include <Eigen/Core>

// Products and Cholesky factors of small matrices, computed in registers. The results equal Eigen's
// bit for bit, because every entry is one sum in ascending order. Eigen's general functions take
// several times as long for a few rows. Factors of matrices with more than kMostOnStack rows differ
// from Eigen's in rounding. Nothing allocates or throws.
namespace dfr::control::internal {

/// Maximum number of rows and columns for which Eigen keeps copies of blocks on the stack
/// (EIGEN_STACK_ALLOCATION_LIMIT, 128 kB). Eigen's general functions allocate for larger matrices.
inline constexpr Eigen::Index kMostOnStack = 128;
static_assert(sizeof(double) * kMostOnStack * kMostOnStack <= EIGEN_STACK_ALLOCATION_LIMIT);

/// Returns sum_k weights[k] column_k over `count` >= 1 columns, for kRows rows from `columns` on.
/// Consecutive columns are `stride` entries apart.
template <int kRows, typename T>
[[nodiscard]] Eigen::Array<double, kRows, 1> SumOfColumns(const T* columns, Eigen::Index stride,
                                                          const double* weights,
                                                          Eigen::Index count) noexcept {
  using Column = Eigen::Map<const Eigen::Array<T, kRows, 1>>;
  Eigen::Array<double, kRows, 1> sum = Column(columns).template cast<double>() * weights[0];
  for (Eigen::Index k = 1; k < count; ++k) {
    sum += Column(columns + k * stride).template cast<double>() * weights[k];
  }
  return sum;
}

/// Splits `rows` rows into groups and calls `use(first, sums)` for each group: `sums` is
/// SumOfColumns() of the rows from `first` on.
template <typename T, typename Use>
void ForSumsOfColumns(const T* columns, Eigen::Index rows, Eigen::Index stride,
                      const double* weights, Eigen::Index count, Use&& use) noexcept {
  Eigen::Index i = 0;
  for (; i + 8 <= rows; i += 8) use(i, SumOfColumns<8>(columns + i, stride, weights, count));
  if (i + 4 <= rows) {
    use(i, SumOfColumns<4>(columns + i, stride, weights, count));
    i += 4;
  }
  if (i + 2 <= rows) {
    use(i, SumOfColumns<2>(columns + i, stride, weights, count));
    i += 2;
  }
  if (i < rows) use(i, SumOfColumns<1>(columns + i, stride, weights, count));
}

/// Returns the entries of `x` from `first` on, as many as `sums` has.
template <typename Sums>
[[nodiscard]] Eigen::Map<Sums> Part(double* x, Eigen::Index first, const Sums& /*sums*/) noexcept {
  return Eigen::Map<Sums>(x + first);
}

/// Replaces the lower triangle of `a` by its Cholesky factor L, a = L L'. Stops at the first pivot
/// that is not positive.
void Factor(Eigen::MatrixXd& a) noexcept;
/// Sets x = (L L')^-1 x with the factor `l`, for one column.
void SolveFactored(const Eigen::MatrixXd& l, Eigen::MatrixXd& x) noexcept;

}  // namespace dfr::control::internal
