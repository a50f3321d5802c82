// Apache Parquet: every readable column of every row group.
#include <stdexcept>

#include "parquet/parquet_file.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(parquet) {
  try {
    const dfr::imitation::internal::ParquetFile file(
        dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size)));
    for (int group = 0; group < file.num_row_groups(); ++group) {
      for (const std::string& column : file.columns()) {
        try {
          static_cast<void>(file.Read(group, column));
        } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): the next may work
        }
      }
    }
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
