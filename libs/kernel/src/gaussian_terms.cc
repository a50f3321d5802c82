#include "gaussian_terms.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numbers>

#include "gaussian_sum.h"

namespace dfr::kernel::internal {
namespace {

// A term of weight zero.
template <typename T>
void ClearLane(T* block, std::size_t dim, std::size_t lane) {
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  block[lane] = -std::numeric_limits<T>::infinity();
  for (std::size_t k = 0; k < dim; ++k) block[(1 + k) * kLanes + lane] = T{0};
}

// Mean of `kWidth` successive columns, and the largest distance from it in any of them.
template <std::size_t kWidth>
double MeanOf(const double* first, std::size_t count, std::size_t dim, double* mean) {
  double sum[kWidth] = {};
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < kWidth; ++k) sum[k] += first[i * dim + k];
  }
  for (std::size_t k = 0; k < kWidth; ++k) mean[k] = sum[k] / static_cast<double>(count);
  double most[kWidth] = {};
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < kWidth; ++k) {
      most[k] = std::max(most[k], std::abs(first[i * dim + k] - mean[k]));
    }
  }
  return *std::max_element(most, most + kWidth);
}

// MeanOf() of all columns, in registers. If their number is no multiple of kWidth, some are visited
// twice.
template <std::size_t kWidth>
double Mean(const core::Matrix& points, std::vector<double>& mean) {
  const auto dim = static_cast<std::size_t>(points.cols());
  if constexpr (kWidth > 1) {
    if (dim < kWidth) return Mean<kWidth / 2>(points, mean);
  }
  double most = 0.0;
  for (std::size_t k = 0; k < dim; k += kWidth) {
    const std::size_t first = std::min(k, dim - kWidth);
    most = std::max(
        most, MeanOf<kWidth>(points.data() + first, static_cast<std::size_t>(points.rows()), dim,
                             mean.data() + first));
  }
  return most;
}

}  // namespace

std::vector<double> Center(const core::Matrix& points, double scale) {
  constexpr double kFar = 1e3;
  const auto dim = static_cast<std::size_t>(points.cols());
  const auto count = static_cast<std::size_t>(points.rows());
  std::vector<double> center(dim);
  const double most = Mean<8>(points, center);
  // Detects overflow of a sum.
  const bool finite =
      std::all_of(center.begin(), center.end(), [](double c) { return std::isfinite(c); });
  if (finite && scale * most < kFar) return center;
  std::vector<double> column(count);
  for (std::size_t k = 0; k < dim; ++k) {
    for (std::size_t i = 0; i < count; ++i) column[i] = points.data()[i * dim + k];
    const auto middle = column.begin() + static_cast<std::ptrdiff_t>(count / 2);
    std::nth_element(column.begin(), middle, column.end());
    center[k] = *middle;
  }
  return center;
}

template <typename T>
GaussianTerms<T>::GaussianTerms(const core::Matrix& points, std::span<const double> weights,
                                double gamma)
    : functions(BestFunctions<T>()),
      dim(static_cast<std::size_t>(points.cols())),
      count(static_cast<std::size_t>(points.rows())),
      num_blocks((count + kLanes - 1) / kLanes),
      scale(std::sqrt(gamma * std::numbers::log2e)),
      // Centred coordinates are about as large as the relevant differences, which keeps the
      // rounding of x' below that of the exponent.
      center(Center(points, scale)),
      data(num_blocks * (dim + 1) * kLanes) {
  assert(weights.empty() || weights.size() == count);
  for (std::size_t b = 0; b < num_blocks; ++b) {
    T* block = data.data() + b * (dim + 1) * kLanes;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::size_t i = b * kLanes + lane;
      if (i >= count) {
        ClearLane(block, dim, lane);
        continue;
      }
      block[lane] = weights.empty() ? T{0} : static_cast<T>(std::log2(weights[i]));
      const double* row = points.data() + i * dim;
      for (std::size_t k = 0; k < dim; ++k) {
        block[(1 + k) * kLanes + lane] = static_cast<T>(scale * (row[k] - center[k]));
      }
    }
  }
}

template <typename T>
GaussianTerms<T> GaussianTerms<T>::Subset(std::span<const std::size_t> indices,
                                          std::size_t whole) const {
  GaussianTerms subset;
  subset.functions = functions;
  subset.dim = dim;
  subset.count = indices.size();
  subset.num_blocks = (subset.count + whole - 1) / whole * (whole / kLanes);
  subset.scale = scale;
  subset.center = center;
  subset.data.resize(subset.num_blocks * (dim + 1) * kLanes);
  const std::size_t stride = (dim + 1) * kLanes;
  for (std::size_t b = 0; b < subset.num_blocks; ++b) {
    T* block = subset.data.data() + b * stride;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::size_t to = b * kLanes + lane;
      if (to >= subset.count) {
        ClearLane(block, dim, lane);
        continue;
      }
      const std::size_t from = indices[to];
      const T* column = data.data() + from / kLanes * stride + from % kLanes;
      for (std::size_t row = 0; row <= dim; ++row) {
        block[row * kLanes + lane] = column[row * kLanes];
      }
    }
  }
  return subset;
}

template <typename T>
GroupBoxes<T>::GroupBoxes(const GaussianTerms<T>& terms)
    : dim(terms.dim), count(terms.row_size() / kGroup) {
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  assert(terms.row_size() % kGroup == 0);
  // Lanes without a group are out of reach of every query.
  constexpr T kFar = std::numeric_limits<T>::infinity();
  data.assign((count + kLanes - 1) / kLanes * 2 * dim * kLanes, kFar);
  for (std::size_t i = 0; i < terms.count; ++i) {
    const std::size_t group = i / kGroup;
    const T* column = terms.data.data() + i / kLanes * (dim + 1) * kLanes + i % kLanes;
    T* corner = data.data() + group / kLanes * 2 * dim * kLanes + group % kLanes;
    for (std::size_t k = 0; k < dim; ++k) {
      const T value = column[(1 + k) * kLanes];
      T& low = corner[2 * k * kLanes];
      T& high = corner[(2 * k + 1) * kLanes];
      low = i % kGroup == 0 ? value : std::min(low, value);
      high = i % kGroup == 0 ? value : std::max(high, value);
    }
  }
}

template struct GroupBoxes<double>;
template struct GroupBoxes<float>;
template struct GaussianTerms<double>;
template struct GaussianTerms<float>;

}  // namespace dfr::kernel::internal
