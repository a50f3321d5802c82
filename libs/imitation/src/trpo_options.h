#pragma once

#include "dfr/core/files/archive.h"
#include "dfr/imitation/trpo.h"

namespace dfr::imitation::internal {

/// @throws std::invalid_argument naming an option that is out of range.
[[nodiscard]] TrpoOptions CheckedTrpoOptions(TrpoOptions o);

void SaveTrpoOptions(const TrpoOptions& o, core::ArchiveWriter& archive);
[[nodiscard]] TrpoOptions LoadTrpoOptions(core::ArchiveReader& archive);

}  // namespace dfr::imitation::internal
