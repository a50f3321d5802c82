// LIBSVM's samples and models, and comma-separated values.
#include <cmath>
#include <cstdlib>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/kernel/libsvm_io.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(samples) {
  const std::string_view input = dfr::fuzz::AsText(data, size);
  try {
    const dfr::core::Matrix samples = dfr::kernel::LoadSamples(dfr::fuzz::InputFile(input));
    if (samples.rows() < 1 || !samples.allFinite()) std::abort();
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  try {
    std::istringstream in{std::string(input)};
    const auto svm = dfr::kernel::LoadLibsvmModel(in, "model");
    const std::vector<double> state(static_cast<std::size_t>(svm.state_dim()), 0.5);
    if (std::isnan(svm.Decision(state))) std::abort();
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
