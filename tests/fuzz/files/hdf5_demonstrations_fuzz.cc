// Demonstrations in HDF5. libhdf5 reads in a separate process, which may crash. This process must
// not crash.
#include <algorithm>
#include <cstdlib>
#include <stdexcept>

#include "dfr/imitation/demonstrations.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(hdf5_demonstrations) {
  try {
    const auto reader =
        dfr::imitation::OpenDemonstrations(dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size)));
    for (int i = 0; i < std::min(reader->num_episodes(), 3); ++i) {
      const auto episode = reader->Read(i);
      if (!episode.states.allFinite() || !episode.controls.allFinite()) std::abort();
    }
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
