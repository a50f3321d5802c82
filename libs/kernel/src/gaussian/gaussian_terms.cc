#include "gaussian/gaussian_terms.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numbers>
#include <type_traits>

#include "gaussian/gaussian_sum.h"

namespace dfr::kernel::internal {
namespace {

// Writes a term of weight zero.
template <typename T>
void ClearLane(T* block, std::size_t dim, std::size_t lane) {
  constexpr std::size_t kLanes = GaussianTerms<T>::kLanes;
  block[lane] = -std::numeric_limits<T>::infinity();
  for (std::size_t k = 0; k < dim; ++k) block[(1 + k) * kLanes + lane] = T{0};
}

}  // namespace

Extent::Extent(const core::Matrix& points) : mean(static_cast<std::size_t>(points.cols())) {
  const auto count = static_cast<std::size_t>(points.rows());
  std::vector<double> most(mean.size());
  MeasureColumns(points.data(), count, mean.size(), mean.data(), most.data());
  for (std::size_t k = 0; k < mean.size(); ++k) {
    finite = finite && std::isfinite(mean[k]);
    mean[k] /= static_cast<double>(count);
    largest = std::max(largest, most[k]);
  }
}

std::vector<double> Center(const core::Matrix& points, const Extent& extent, double scale) {
  constexpr double kFar = 1e3;
  const auto dim = static_cast<std::size_t>(points.cols());
  const auto count = static_cast<std::size_t>(points.rows());
  std::vector<double> center = extent.mean;
  if (extent.finite) {
    // No distance from the mean exceeds twice the largest entry, up to rounding.
    if (scale * extent.largest < 0.4 * kFar) return center;
    double most = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t k = 0; k < dim; ++k) {
        most = std::max(most, std::abs(points.data()[i * dim + k] - center[k]));
      }
    }
    if (scale * most < kFar) return center;
  }
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
GaussianTerms<T>::GaussianTerms(const core::Matrix& points, const Extent& extent,
                                std::span<const double> weights, double gamma)
    : functions(BestFunctions<T>()),
      dim(static_cast<std::size_t>(points.cols())),
      count(static_cast<std::size_t>(points.rows())),
      num_blocks((count + kLanes - 1) / kLanes),
      scale(std::sqrt(gamma * std::numbers::log2e)),
      // Centred coordinates are about as large as the relevant differences, which keeps the
      // rounding error of x' below the error of the exponent.
      center(Center(points, extent, scale)),
      data(num_blocks * (dim + 1) * kLanes) {
  assert(weights.empty() || weights.size() == count);
  for (std::size_t b = 0; b < num_blocks; ++b) {
    T* block = data.data() + b * (dim + 1) * kLanes;
    const std::size_t lanes = std::min(kLanes, count - b * kLanes);
    for (std::size_t lane = 0; lane < lanes; ++lane) {
      block[lane] = weights.empty() ? T{0} : static_cast<T>(std::log2(weights[b * kLanes + lane]));
    }
    const double* rows = points.data() + b * kLanes * dim;
    // The compiler vectorises loops over a constant number of lanes.
    const auto fill = [&](auto number) {
      for (std::size_t k = 0; k < dim; ++k) {
        for (std::size_t lane = 0; lane < number; ++lane) {
          block[(1 + k) * kLanes + lane] =
              static_cast<T>(scale * (rows[lane * dim + k] - center[k]));
        }
      }
    };
    if (lanes == kLanes) {
      fill(std::integral_constant<std::size_t, kLanes>());
    } else {
      fill(lanes);
    }
    for (std::size_t lane = lanes; lane < kLanes; ++lane) ClearLane(block, dim, lane);
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
