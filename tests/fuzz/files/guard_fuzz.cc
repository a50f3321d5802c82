// Guards with a valid checksum around arbitrary values: a guard that loads keeps its guarantees.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "dfr/safety/guard.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(guard) {
  const std::string_view input = dfr::fuzz::AsText(data, size);
  const std::int64_t version = 1 + (size > 0 ? data[0] % 6 : 0);
  const std::string_view values = input.substr(std::min<std::size_t>(1, size));
  try {
    auto guard = dfr::safety::Guard::Load(
        dfr::fuzz::InputFile(dfr::fuzz::Archive("guard", version, values)));
    std::vector<double> state(static_cast<std::size_t>(guard.state_dim()), 0.1);
    std::vector<double> action(static_cast<std::size_t>(guard.action_dim()), 0.2);
    std::vector<double> safe(action.size());
    guard.Reset(1);
    const std::vector<double>& limits = guard.model().settings().action_limit;
    for (int t = 0; t < 3; ++t) {
      static_cast<void>(guard.Filter(t, state, action, safe));
      for (std::size_t i = 0; i < safe.size(); ++i) {
        if (!(std::abs(safe[i]) <= limits[i])) std::abort();
      }
    }
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
