#include <array>

#include "dfr/safety/guard.h"

// Fits a guard to demonstrations of a point that goes right, and passes their action.
int main() {
  std::vector<dfr::core::Trajectory> demonstrations(12);
  for (int i = 0; i < 12; ++i) {
    const Eigen::ArrayXd t = Eigen::ArrayXd::LinSpaced(11, 0, 10);
    demonstrations[i].states.resize(11, 2);
    demonstrations[i].states << 0.1 * t, 0.02 * i + 0.02 * (t + 0.1 * i * t).sin();
    demonstrations[i].controls =
        demonstrations[i].states.bottomRows(10) - demonstrations[i].states.topRows(10);
  }
  dfr::core::StateLayout layout;
  layout.Add("tip", 2);
  dfr::safety::Guard guard(dfr::safety::GuardModel::Fit(layout, demonstrations));
  guard.Reset(/*seed=*/1);
  std::array<double, 2> action = {0.1, 0.0};
  const auto verdict = guard.Filter(0, std::array{0.0, 0.1}, action, action);
  return verdict.mode != dfr::control::Mode::kHalt && action[0] > 0.05 ? 0 : 1;
}
