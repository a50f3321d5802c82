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

/// `count` demonstrations of `length` controls. start(d, z) sets the first features of
/// demonstration d; step(t, z, v, next) sets the control `v` at features `z`, and the next
/// features.
template <typename Start, typename Step>
Demonstrations Simulate(int count, int length, Eigen::Index features, Eigen::Index controls,
                        Start start, Step step) {
  Demonstrations seen;
  for (int d = 0; d < count; ++d) {
    core::Matrix z(length + 1, features);
    core::Matrix v(length, controls);
    start(d, z.row(0));
    for (int t = 0; t < length; ++t) step(t, z.row(t), v.row(t), z.row(t + 1));
    seen.features.push_back(z);
    seen.controls.push_back(v);
  }
  return seen;
}

/// Demonstrations of z' = z + J u, exactly, with random u.
inline Demonstrations Linear(const core::Matrix& jacobian, int count, int length,
                             core::Random& random) {
  return Simulate(
      count, length, jacobian.rows(), jacobian.cols(), [](int, auto z) { z.setZero(); },
      [&](int, const auto& z, auto v, auto next) {
        v = RandomMatrix(random, 1, jacobian.cols());
        next = z + v * jacobian.transpose();
      });
}

inline std::shared_ptr<const control::TransitionStore> Store(
    const Demonstrations& d, const control::ResponseOptions& options = {}) {
  return std::make_shared<const control::TransitionStore>(d.features, d.controls, options);
}

}  // namespace dfr::test
