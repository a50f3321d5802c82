#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "dfr/imitation/demonstrations.h"

namespace dfr::imitation {

// LeRobot's format, versions 2.0 to 3.0: a folder with meta/info.json and Parquet files in data/.
// Each row is one frame: the observation, the action taken at that observation, and the episode's
// number.

/// Opens a dataset's folder.
/// - State: all numeric features whose names start with "observation", sorted by name, one block
///   each ("observation.state"). Images and videos are skipped, and note() reports it.
/// - Actions: the feature "action". The format does not record the state after the last action,
///   which is therefore dropped.
/// - An episode is completed if its last next.success is not zero. Without that feature, no episode
///   counts as completed.
/// @param filter_key  a split of meta/info.json, for example "train"; empty: all episodes.
/// @throws std::runtime_error with file, column or episode, and reason.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenLeRobot(const std::filesystem::path& folder,
                                                               const std::string& filter_key = "");

/// Returns whether the folder has a meta/info.json.
[[nodiscard]] bool IsLeRobot(const std::filesystem::path& folder);

}  // namespace dfr::imitation
