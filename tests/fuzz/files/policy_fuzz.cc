// Policies with a valid checksum around arbitrary values.
#include <algorithm>
#include <stdexcept>
#include <vector>

#include "dfr/imitation/mlp_policy.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(policy) {
  const std::string_view values = dfr::fuzz::AsText(data, size);
  try {
    const auto policy = dfr::imitation::MlpPolicy::Load(
        dfr::fuzz::InputFile(dfr::fuzz::Archive("mlp-policy", 1, values)));
    const std::vector<double> state(static_cast<std::size_t>(policy.state_dim()), 0.1);
    std::vector<double> control(static_cast<std::size_t>(policy.control_dim()));
    policy.Control(0, state, control);
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
