#include "support/states_at.h"

#include <algorithm>

#include "dfr/core/contract.h"

namespace dfr::kernel::internal {

bool AllFinite(const Eigen::Ref<const core::Matrix>& states) {
  // A product of zero and a non-finite entry is NaN, and so is the sum. Many times faster than a
  // test of each entry.
  const auto finite = [](const auto& entries) { return (0.0 * entries.array()).sum() == 0.0; };
  if (states.outerStride() != states.cols()) return finite(states);
  return finite(Eigen::Map<const Eigen::VectorXd>(states.data(), states.size()));
}

std::vector<StatesView> Views(std::span<const core::Matrix> demonstrations) {
  std::vector<StatesView> views;
  views.reserve(demonstrations.size());
  for (const core::Matrix& states : demonstrations) {
    views.emplace_back(states.data(), states.rows(), states.cols());
  }
  return views;
}

void CheckDemonstrations(std::span<const StatesView> demonstrations) {
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const StatesView& states = demonstrations[d];
    DFR_THROW_UNLESS(states.rows() >= 1, "demonstration " << d << " has no states");
    DFR_THROW_UNLESS(states.cols() == demonstrations[0].cols(),
                     "demonstration " << d << " has states of " << states.cols()
                                      << " entries, but demonstration 0 has "
                                      << demonstrations[0].cols());
    if (AllFinite(states)) continue;
    for (Eigen::Index i = 0; i < states.rows(); ++i) {
      DFR_THROW_UNLESS(states.row(i).allFinite(),
                       "demonstration " << d << ", state " << i << " has a non-finite entry");
    }
  }
}

int LongestLength(std::span<const StatesView> demonstrations) {
  Eigen::Index longest = 0;
  for (const StatesView& states : demonstrations) longest = std::max(longest, states.rows());
  return static_cast<int>(longest);
}

core::Matrix StatesAt(std::span<const StatesView> demonstrations, int t) {
  core::Matrix states(static_cast<Eigen::Index>(demonstrations.size()), demonstrations[0].cols());
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const StatesView& all = demonstrations[d];
    const Eigen::Index row = std::min<Eigen::Index>(t, all.rows() - 1);
    std::copy_n(all.data() + row * all.cols(), all.cols(),
                states.data() + static_cast<Eigen::Index>(d) * states.cols());
  }
  return states;
}

}  // namespace dfr::kernel::internal
