#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "commands.h"
#include "dfr/experiment/intervals.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "replay.h"

namespace dfr::apps::guard {

void RunEvaluate(const EvaluateOptions& options) {
  const auto model = LoadGuard(options.guard);
  const auto reader = OpenEpisodes(*model, options.demonstrations, options.filter_key);
  safety::Guard guard(model);
  std::vector<double> micros;
  int alarms = 0;
  int untouched = 0;
  int actions = 0;
  int passed = 0;
  int changed = 0;
  int halted = 0;
  double change = 0.0;
  Print("%-24s %8s %9s %10s %8s  %s\n", "episode", "actions", "passed %", "lowest l", "alarm",
        "first action that would not pass");
  for (int i = 0; i < reader->num_episodes(); ++i) {
    const core::Trajectory episode = reader->Read(i);
    const std::vector<double> levels = model->Levels(episode.states);
    const auto alarm = std::find_if(levels.begin(), levels.end(),
                                    [&](double l) { return l < -model->settings().alarm_level; });
    alarms += alarm != levels.end() ? 1 : 0;
    const safety::Shadow shadow = safety::RunInShadow(guard, episode);
    micros.insert(micros.end(), shadow.micros.begin(), shadow.micros.end());
    untouched += shadow.first_changed < 0 ? 1 : 0;
    actions += shadow.actions;
    passed += shadow.passed;
    // Counts only actions before a halt.
    changed += static_cast<int>(shadow.micros.size()) - shadow.passed - (shadow.halted < 0 ? 0 : 1);
    halted += shadow.halted < 0 ? 0 : 1;
    change += shadow.change;
    const std::string first = shadow.first_changed < 0 ? "-"
                                                       : std::to_string(shadow.first_changed) +
                                                             " (" + shadow.reason + ")";
    Print("%-24s %8d %9.1f %10.3f %8s  %s\n", reader->name(i).c_str(), shadow.actions,
          100.0 * shadow.passed / std::max(1, shadow.actions),
          *std::min_element(levels.begin(), levels.end()),
          alarm == levels.end() ? "-" : std::to_string(alarm - levels.begin()).c_str(),
          first.c_str());
  }
  const int episodes = reader->num_episodes();
  const auto interval = experiment::ProportionInterval(alarms, episodes);
  Print(
      "%d of %d episodes raise an alarm (%.1f %%, 95 %% interval [%.1f, %.1f]); %d pass "
      "untouched\n",
      alarms, episodes, 100.0 * alarms / episodes, 100.0 * interval.low, 100.0 * interval.high,
      untouched);
  Print("%.1f %% of the %d actions pass unchanged", 100.0 * passed / std::max(1, actions), actions);
  if (changed > 0) {
    Print("; %d are changed, by %.2f ordinary actions on average", changed, change / changed);
  }
  if (halted > 0) Print("; %d episodes halt, and no later action counts as passed", halted);
  Print("\n");
  std::sort(micros.begin(), micros.end());
  Print("a call takes %.1f us (median), %.1f us (99th percentile)\n", micros[micros.size() / 2],
        micros[micros.size() * 99 / 100]);
}

}  // namespace dfr::apps::guard
