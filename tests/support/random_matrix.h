#pragma once

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"

namespace dfr::test {

/// Returns a matrix of standard normal entries.
inline core::Matrix RandomMatrix(core::Random& random, Eigen::Index rows, Eigen::Index cols) {
  core::Matrix m(rows, cols);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = random.Normal();
  return m;
}

}  // namespace dfr::test
