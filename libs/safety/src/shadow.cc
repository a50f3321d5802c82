#include <chrono>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/safety/guard_advice.h"

namespace dfr::safety {

Shadow RunInShadow(Guard& guard, const core::Trajectory& episode) {
  DFR_THROW_UNLESS(episode.states.cols() == guard.state_dim(),
                   "the states have " << episode.states.cols()
                                      << " entries, but the guard's states have "
                                      << guard.state_dim());
  DFR_THROW_UNLESS(episode.controls.cols() == guard.action_dim(),
                   "the actions have " << episode.controls.cols()
                                       << " entries, but the guard's actions have "
                                       << guard.action_dim());
  Shadow shadow{.actions = episode.num_steps(), .micros = {}};
  shadow.micros.reserve(static_cast<std::size_t>(shadow.actions));
  std::vector<double> safe(static_cast<std::size_t>(guard.action_dim()));
  guard.Reset();
  for (int t = 0; t < shadow.actions; ++t) {
    const std::span<const double> action = core::Row(episode.controls, t);
    const auto start = std::chrono::steady_clock::now();
    const Verdict verdict = guard.Filter(t, core::Row(episode.states, t), action, safe);
    const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - start;
    shadow.micros.push_back(took.count());
    const bool halts = verdict.mode == control::Mode::kHalt;
    if (!halts && !verdict.changed) {
      ++shadow.passed;
      continue;
    }
    if (shadow.first_changed < 0) {
      shadow.first_changed = t;
      shadow.reason = verdict.reason();
    }
    if (halts) {
      shadow.halted = t;
      break;
    }
    shadow.change += verdict.change;
    guard.Applied(action);
  }
  return shadow;
}

}  // namespace dfr::safety
