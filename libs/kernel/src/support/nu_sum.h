#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <limits>

#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel::internal {

/// Sums of alpha in LIBSVM's scale.
struct NuSum {
  double samples;  ///< Sum for nu = 1.
  double solved;   ///< Sum for the problem to solve.
  double ratio;    ///< options.nu, divided by the nu of the problem to solve.
};

/// If nu sum w is below the smallest weight, a single alpha may be the whole sum. All such problems
/// have the same solution, up to a factor. The problem to solve has the smallest weight as its sum,
/// because tolerances cannot resolve smaller sums.
inline NuSum SumOf(const OneClassSvmOptions& options, Eigen::Index count) {
  double all = static_cast<double>(count);
  double smallest = 1.0;
  if (!options.weights.empty()) {
    all = 0.0;
    smallest = std::numeric_limits<double>::infinity();
    for (const double w : options.weights) {
      all += w;
      if (w > 0.0) smallest = std::min(smallest, w);
    }
  }
  const double asked = options.nu * all;
  return asked >= smallest ? NuSum{all, asked, 1.0} : NuSum{all, smallest, asked / smallest};
}

}  // namespace dfr::kernel::internal
