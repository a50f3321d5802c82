#include "smo/active_set.h"

#include <algorithm>

namespace dfr::kernel::internal {

void ActiveSet::Choose(std::span<const double> alpha, std::span<const double> gradient,
                       double rho) {
  samples_.clear();
  empty_.clear();
  full_.clear();
  for (std::size_t i = 0; i < alpha.size(); ++i) {
    if (alpha[i] <= 0.0) {
      empty_.push_back({gradient[i] - rho, i});
    } else if (alpha[i] >= 1.0) {
      full_.push_back({rho - gradient[i], i});
    } else {
      samples_.push_back(i);
    }
  }
  const std::size_t free = samples_.size();
  AddNearest(empty_, free);
  AddNearest(full_, free);
  std::sort(samples_.begin(), samples_.end());
}

void ActiveSet::AddNearest(std::vector<Candidate>& candidates, std::size_t free) {
  const auto violators = static_cast<std::size_t>(std::count_if(
      candidates.begin(), candidates.end(), [](const Candidate& c) { return c.slack < 0.0; }));
  const std::size_t wanted =
      std::min(candidates.size(),
               std::min(violators, (most_violators_ + free) / 2) + (margin_ + free / 4) / 2);
  if (wanted < candidates.size()) {
    std::nth_element(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(wanted),
                     candidates.end(), [](const Candidate& a, const Candidate& b) {
                       return a.slack != b.slack ? a.slack < b.slack : a.sample < b.sample;
                     });
  }
  for (std::size_t i = 0; i < wanted; ++i) samples_.push_back(candidates[i].sample);
}

}  // namespace dfr::kernel::internal
