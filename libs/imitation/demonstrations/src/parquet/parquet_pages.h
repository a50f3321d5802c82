#pragma once

#include <cstdint>
#include <string_view>

#include "dfr/core/files/read_budget.h"
#include "parquet/parquet_file.h"

namespace dfr::imitation::internal {

/// Decodes the pages of one column in one row group.
/// @throws Malformed with the reason, without the file and the column.
[[nodiscard]] ParquetColumn DecodeChunk(const ParquetFile::Leaf& leaf,
                                        const ParquetFile::Chunk& chunk, std::int64_t num_rows,
                                        const core::ReadBudget& budget, std::string_view data);

}  // namespace dfr::imitation::internal
