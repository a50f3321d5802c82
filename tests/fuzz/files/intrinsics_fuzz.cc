// Calibrations of cameras.
#include <stdexcept>

#include "dfr/hardware/intrinsics_file.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(intrinsics) {
  try {
    dfr::hardware::ReadIntrinsics(dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size))).Check();
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
