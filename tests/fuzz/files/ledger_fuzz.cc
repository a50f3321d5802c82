// Ledgers of experiments.
#include <stdexcept>

#include "dfr/experiment/ledger.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(ledger) {
  try {
    static_cast<void>(
        dfr::experiment::ReadLedger(dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size))));
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
