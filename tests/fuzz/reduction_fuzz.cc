// Reductions with a valid checksum around arbitrary values: a reduction that loads can be applied.
#include <stdexcept>
#include <vector>

#include "dfr/reduction/reduction.h"
#include "tests/fuzz/input_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto reduction = dfr::reduction::Reduction::Load(
        dfr::fuzz::InputFile(dfr::fuzz::Archive("reduction", 1, dfr::fuzz::AsText(data, size))));
    std::vector<double> x(static_cast<std::size_t>(reduction.input_dim()), 0.5);
    std::vector<double> z(static_cast<std::size_t>(reduction.num_components()));
    reduction.Apply(x, z);
    reduction.BackProject(z, x);
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
