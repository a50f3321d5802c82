#pragma once

#include <memory>
#include <vector>

#include "dfr/control/response/transition_store.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "tests/support/random_matrix.h"

namespace dfr::test {

struct Demonstrations {
  std::vector<core::Matrix> features;
  std::vector<core::Matrix> controls;
};

/// z' = z + J u exactly.
inline Demonstrations Linear(const core::Matrix& jacobian, int count, int length,
                             core::Random& random) {
  Demonstrations demonstrations;
  for (int d = 0; d < count; ++d) {
    core::Matrix u = RandomMatrix(random, length, jacobian.cols());
    core::Matrix z(length + 1, jacobian.rows());
    z.row(0).setZero();
    for (int t = 0; t < length; ++t) z.row(t + 1) = z.row(t) + u.row(t) * jacobian.transpose();
    demonstrations.features.push_back(z);
    demonstrations.controls.push_back(u);
  }
  return demonstrations;
}

inline std::shared_ptr<const control::TransitionStore> Store(
    const Demonstrations& d, const control::ResponseOptions& options = {}) {
  return std::make_shared<const control::TransitionStore>(d.features, d.controls, options);
}

}  // namespace dfr::test
