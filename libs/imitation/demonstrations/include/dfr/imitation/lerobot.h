#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "dfr/imitation/demonstrations.h"

namespace dfr::imitation {

// LeRobot's format, versions 2.0 to 3.0: a folder with meta/info.json and Parquet files below
// data/. Each row is one frame: the observation, the action taken in it, and the episode's number.

/// Opens a dataset's folder. A state is all numeric features whose names begin with "observation",
/// by name, each a block of that name ("observation.state"); images and videos are left alone,
/// which note() says. Actions are the feature "action". The state after the last action is not
/// recorded, so that each episode's last action is left out. An episode completed if its last
/// next.success is not zero; where the dataset has no such feature, none is said to have.
/// @param filter_key  a split of meta/info.json, "train" say; empty: all episodes.
/// @throws std::runtime_error naming file, column or episode, and reason.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenLeRobot(const std::filesystem::path& folder,
                                                               const std::string& filter_key = "");

/// Whether there is a meta/info.json below the folder.
[[nodiscard]] bool IsLeRobot(const std::filesystem::path& folder);

}  // namespace dfr::imitation
