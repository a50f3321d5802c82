// Recordings (MCAP), finished or not.
#include <stdexcept>

#include "dfr/recording/read_recording.h"
#include "tests/fuzz/input_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    static_cast<void>(
        dfr::recording::ReadRecording(dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size))));
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
