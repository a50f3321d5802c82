#include "dfr/kernel/cover_radius.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::kernel {
namespace {

// Number of equal parts into which CoverRadius() divides the largest possible result.
constexpr int kParts = 100;

}  // namespace

double CoverRadius(const OneClassSvm& svm, double level) {
  DFR_THROW_UNLESS(std::isfinite(level), "the level must be finite, not " << level);
  if (svm.rho() <= 0.0) return std::numeric_limits<double>::infinity();
  const double gamma = svm.gamma();
  const double square = (level - std::log(svm.rho())) / gamma;
  if (!(square > 0.0)) return 0.0;
  const double plain = std::sqrt(square);
  const double least = svm.rho() * std::exp(-level);
  const Eigen::MatrixXd vectors = svm.support_vectors();
  const Eigen::ArrayXd alpha = svm.alpha();
  const double width = plain / kParts;
  int parts = 0;
  for (Eigen::Index i = 0; i < vectors.rows() && parts < kParts; ++i) {
    const Eigen::ArrayXd apart = (vectors.rowwise() - vectors.row(i)).rowwise().norm().array();
    // Goes inwards from the radius `plain` until a part contains a possible distance. Parts below
    // the result for another support vector need no test.
    int part = kParts;
    for (; part > parts; --part) {
      const Eigen::ArrayXd nearest = (apart - part * width).max((part - 1) * width);
      const double most = (alpha * (-gamma * nearest.square()).exp()).sum();
      // All rounding errors are far below 1e-9.
      if (most >= least * (1.0 - 1e-9)) break;
    }
    parts = std::max(parts, part);
  }
  return parts * width;
}

}  // namespace dfr::kernel
