#include "support/states_at.h"

#include <algorithm>

#include "dfr/core/contract.h"

namespace dfr::kernel::internal {

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
    if (core::AllFinite({states.data(), static_cast<std::size_t>(states.size())})) continue;
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
