// Fits a guard to demonstrations in memory. For files, use the program `guard`: guard fit --help.
#include <cstdio>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/guard_model.h"

int main(int argc, char** argv) {
  // A tip moves to the right for 20 steps; its sideways motion varies slightly.
  dfr::core::StateLayout layout;
  layout.Add("tip", 2);
  dfr::core::Random random(/*seed=*/1);
  std::vector<dfr::core::Trajectory> demonstrations(30);
  for (auto& demonstration : demonstrations) {
    demonstration.states.resize(21, 2);    // one row more than actions
    demonstration.controls.resize(20, 2);  // a zero action must hold the robot still
    demonstration.states.row(0) << 0.0, 0.1 * random.Normal();
    for (int t = 0; t < 20; ++t) {
      const double correction = -0.3 * demonstration.states(t, 1) + 0.05 * random.Normal();
      demonstration.controls.row(t) << 0.1, correction;
      demonstration.states.row(t + 1) = demonstration.states.row(t) + demonstration.controls.row(t);
    }
  }
  const auto model = dfr::safety::GuardModel::Fit(layout, demonstrations, {.features = "tip"});
  model->Save(argc > 1 ? argv[1] : "task.guard");
  std::printf("%.0f %% of held-out states are inside; alarm at l < %.2f\n",
              100.0 * model->summary().acceptance, -model->settings().alarm_level);
  return 0;
}
