// A policy that drifts off, and a guard that keeps it near the demonstrations.
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>

#include "dfr/safety/guard.h"

int main(int argc, char** argv) try {
  auto guard = dfr::safety::Guard::Load(argc > 1 ? argv[1] : "task.guard");  // from fit_a_guard
  guard.Reset(/*seed=*/1);
  std::array<double, 2> tip = {0.0, 0.0};
  for (int t = 0; t < 40 && tip[0] < 1.8; ++t) {
    const std::array<double, 2> wish = {0.09, 0.06};  // your policy
    std::array<double, 2> action{};
    const dfr::safety::Verdict verdict = guard.Filter(t, tip, wish, action);
    if (verdict.mode == dfr::control::Mode::kHalt) {
      std::printf("halted: %s\n", verdict.reason());
      return 1;
    }
    std::printf("%2d  g %6.3f  %-8s  (%.3f, %.3f)\n", t, verdict.g, verdict.reason(), action[0],
                action[1]);
    for (int k = 0; k < 2; ++k) tip[k] += action[k];  // your robot
  }
  return tip[0] >= 1.8 && std::abs(tip[1]) < 0.6 ? 0 : 1;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
