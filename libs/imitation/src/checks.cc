#include "checks.h"

#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::imitation::internal {

void CheckFinite(const core::Matrix& rows, std::string_view name) {
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    for (Eigen::Index j = 0; j < rows.cols(); ++j) {
      DFR_THROW_UNLESS(std::isfinite(rows(i, j)),
                       name << ": row " << i << ", column " << j << " is " << rows(i, j));
    }
  }
}

}  // namespace dfr::imitation::internal
