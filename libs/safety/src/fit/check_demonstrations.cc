#include "fit/check_demonstrations.h"

#include <cstddef>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"

namespace dfr::safety::internal {

void CheckDemonstrations(const core::StateLayout& layout,
                         std::span<const core::Trajectory> demonstrations) {
  DFR_THROW_UNLESS(demonstrations.size() >= 3,
                   "a guard needs at least 3 demonstrations, not " << demonstrations.size());
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const core::Trajectory& demonstration = demonstrations[d];
    DFR_THROW_UNLESS(demonstration.states.cols() == layout.state_dim(),
                     "demonstration " << d << " has states of " << demonstration.states.cols()
                                      << " entries, but the layout has " << layout.state_dim());
    DFR_THROW_UNLESS(demonstration.controls.rows() >= 1 &&
                         demonstration.states.rows() == demonstration.controls.rows() + 1,
                     "demonstration " << d << " has " << demonstration.states.rows()
                                      << " states and " << demonstration.controls.rows()
                                      << " actions; one state more than actions is needed. Append "
                                         "the state after the last action, or drop that action");
    DFR_THROW_UNLESS(demonstration.controls.cols() >= 1,
                     "demonstration " << d << " has actions without entries");
    DFR_THROW_UNLESS(demonstration.controls.cols() == demonstrations[0].controls.cols(),
                     "demonstration " << d << " has actions of " << demonstration.controls.cols()
                                      << " entries, but demonstration 0 has "
                                      << demonstrations[0].controls.cols());
    for (const auto& [what, rows] : {std::pair("state", &demonstration.states),
                                     std::pair("action", &demonstration.controls)}) {
      for (Eigen::Index t = 0; t < rows->rows(); ++t) {
        DFR_THROW_UNLESS(rows->row(t).allFinite(), "demonstration "
                                                       << d << " has a non-finite entry in " << what
                                                       << ' ' << t);
        Eigen::Index k = 0;
        DFR_THROW_UNLESS(core::IsMeasurable(rows->row(t).cwiseAbs().maxCoeff(&k)),
                         "demonstration " << d << " has " << (*rows)(t, k) << " as entry " << k
                                          << " of " << what << ' ' << t << ", where +-"
                                          << core::kLargestEntry
                                          << " is the limit: correct it, or leave the "
                                             "demonstration out");
      }
    }
  }
}

}  // namespace dfr::safety::internal
