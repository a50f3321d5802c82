#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/guard.h"

namespace {

// Demonstrations of a point that goes right, one unit in ten steps.
std::vector<dfr::core::Trajectory> Demonstrations() {
  dfr::core::Random random(1);
  std::vector<dfr::core::Trajectory> demonstrations(12);
  for (auto& demonstration : demonstrations) {
    demonstration.states.resize(11, 2);
    demonstration.controls.resize(10, 2);
    demonstration.states.row(0) << 0.02 * random.Normal(), 0.1 * random.Normal();
    for (int t = 0; t < 10; ++t) {
      demonstration.controls.row(t) << 0.1, 0.02 * random.Normal();
      demonstration.states.row(t + 1) = demonstration.states.row(t) + demonstration.controls.row(t);
    }
  }
  return demonstrations;
}

}  // namespace

// A guard from demonstrations, through its file: passes demonstrated actions, halts on invalid
// input.
int main() {
  dfr::core::StateLayout layout;
  layout.Add("tip", 2);
  const auto path = std::filesystem::temp_directory_path() / "dfr_consumer.guard";
  dfr::safety::GuardModel::Fit(layout, Demonstrations())->Save(path);
  auto guard = dfr::safety::Guard::Load(path);
  std::filesystem::remove(path);

  guard.Reset(/*seed=*/1);
  std::array<double, 2> action = {0.1, 0.0};
  const auto verdict = guard.Filter(0, std::array{0.0, 0.0}, action, action);
  const bool passed = verdict.mode == dfr::control::Mode::kPolicy && action[0] > 0.05;
  const std::array broken = {std::numeric_limits<double>::quiet_NaN(), 0.0};
  const auto held = guard.Filter(1, broken, action, action);
  return passed && held.mode == dfr::control::Mode::kHalt && action[0] == 0.0 ? 0 : 1;
}
