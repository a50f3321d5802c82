#include "dfr/core/trajectory.h"

#include <algorithm>

namespace dfr::core {

ControlSelection SelectControls(std::span<const Matrix* const> controls, int max_per_step) {
  Eigen::Index longest = 0;
  for (const Matrix* matrix : controls) longest = std::max(longest, matrix->rows());
  ControlSelection selection;
  std::vector<std::size_t> moving;
  for (Eigen::Index t = 0; t < longest; ++t) {
    selection.begin.push_back(static_cast<int>(selection.rows.size()));
    moving.clear();
    for (std::size_t d = 0; d < controls.size(); ++d) {
      const Matrix& matrix = *controls[d];
      if (t < matrix.rows() && matrix.row(t).squaredNorm() > 0.0) moving.push_back(d);
    }
    const std::size_t most =
        std::min<std::size_t>(moving.size(), static_cast<std::size_t>(max_per_step));
    for (std::size_t i = 0; i < most; ++i) {
      const std::size_t first = i * moving.size() / most;
      selection.rows.emplace_back(moving[(first + static_cast<std::size_t>(t)) % moving.size()], t);
    }
  }
  selection.begin.push_back(static_cast<int>(selection.rows.size()));
  return selection;
}

}  // namespace dfr::core
