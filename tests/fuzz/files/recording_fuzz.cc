// Complete and incomplete recordings (MCAP).
#include <stdexcept>

#include "dfr/recording/read_recording.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(recording) {
  try {
    static_cast<void>(
        dfr::recording::ReadRecording(dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size))));
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
