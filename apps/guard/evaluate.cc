#include <algorithm>
#include <chrono>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <vector>

#include "commands.h"
#include "dfr/experiment/intervals.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/safety/guard.h"

namespace dfr::apps::guard {

void RunEvaluate(const EvaluateOptions& options) {
  const auto model = safety::GuardModel::Load(options.guard);
  const auto reader = imitation::OpenDemonstrations(options.demonstrations, options.filter_key);
  if (reader->layout() != model->layout()) {
    throw std::runtime_error(options.demonstrations.string() +
                             ": its states have different parts than those of " +
                             options.guard.string());
  }
  safety::Guard guard(model);
  std::vector<double> safe(static_cast<std::size_t>(model->action_dim()));
  std::vector<double> micros;
  int alarms = 0;
  int untouched = 0;
  std::printf("%-24s %8s %10s %8s  %s\n", "episode", "actions", "lowest l", "alarm",
              "first action that would not pass");
  for (int i = 0; i < reader->num_episodes(); ++i) {
    const core::Trajectory episode = reader->Read(i);
    const std::vector<double> levels = model->Levels(episode.states);
    const auto alarm = std::find_if(levels.begin(), levels.end(),
                                    [&](double l) { return l < -model->settings().alarm_level; });
    alarms += alarm != levels.end() ? 1 : 0;
    // After the guard has changed an action, the recorded states no longer follow from its actions.
    std::string first = "-";
    guard.Reset();
    for (int t = 0; t < episode.num_steps(); ++t) {
      const auto start = std::chrono::steady_clock::now();
      const safety::Verdict verdict =
          guard.Filter(t, core::Row(episode.states, t), core::Row(episode.controls, t), safe);
      micros.push_back(
          std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start)
              .count());
      if (verdict.changed) {
        first = std::to_string(t) + " (" + verdict.reason() + ")";
        break;
      }
    }
    untouched += first == "-" ? 1 : 0;
    std::printf("%-24s %8d %10.3f %8s  %s\n", reader->name(i).c_str(), episode.num_steps(),
                *std::min_element(levels.begin(), levels.end()),
                alarm == levels.end() ? "-" : std::to_string(alarm - levels.begin()).c_str(),
                first.c_str());
  }
  const int episodes = reader->num_episodes();
  const auto interval = experiment::ProportionInterval(alarms, episodes);
  std::printf(
      "%d of %d episodes raise an alarm (%.1f %%, 95 %% interval [%.1f, %.1f]); %d pass "
      "untouched\n",
      alarms, episodes, 100.0 * alarms / episodes, 100.0 * interval.low, 100.0 * interval.high,
      untouched);
  std::sort(micros.begin(), micros.end());
  std::printf("a call takes %.1f us (median), %.1f us (99th of 100)\n", micros[micros.size() / 2],
              micros[micros.size() * 99 / 100]);
}

}  // namespace dfr::apps::guard
