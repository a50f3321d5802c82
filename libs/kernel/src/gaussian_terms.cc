#include "gaussian_terms.h"

#include <cassert>
#include <cmath>
#include <limits>
#include <numbers>

#include "gaussian_sum.h"

namespace dfr::kernel::internal {

template <typename T>
GaussianTerms<T>::GaussianTerms(const core::Matrix& points, std::span<const double> weights,
                                double gamma)
    : functions(BestFunctions<T>()),
      dim(static_cast<std::size_t>(points.cols())),
      count(static_cast<std::size_t>(points.rows())),
      num_blocks((count + kLanes - 1) / kLanes),
      scale(std::sqrt(gamma * std::numbers::log2e)),
      center(dim),
      data(num_blocks * (dim + 1) * kLanes) {
  assert(weights.empty() || weights.size() == count);
  // Centred, coordinates are about as large as the differences that matter, which keeps the
  // rounding of x' below that of the exponent.
  for (std::size_t k = 0; k < dim; ++k) {
    center[k] = points.col(static_cast<Eigen::Index>(k)).mean();
  }
  for (std::size_t b = 0; b < num_blocks; ++b) {
    T* block = data.data() + b * (dim + 1) * kLanes;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::size_t i = b * kLanes + lane;
      if (i >= count) {
        block[lane] = -std::numeric_limits<T>::infinity();
        continue;
      }
      block[lane] = weights.empty() ? T{0} : static_cast<T>(std::log2(weights[i]));
      for (std::size_t k = 0; k < dim; ++k) {
        const double x = points(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k));
        block[(1 + k) * kLanes + lane] = static_cast<T>(scale * (x - center[k]));
      }
    }
  }
}

template struct GaussianTerms<double>;
template struct GaussianTerms<float>;

}  // namespace dfr::kernel::internal
