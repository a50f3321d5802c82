#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/imitation/demonstrations.h"

namespace dfr::imitation {

// LeRobot's format, versions 2.0 to 3.0: a folder with meta/info.json, Parquet files in data/ and
// videos in videos/. Each row is one frame: the observation, the action taken at that observation,
// and the episode's number. A video has one frame per row of its episode. Version 2 stores one file
// per episode. Version 3 stores several episodes per file and their start times in meta/episodes.

/// Opens a dataset's folder.
/// - State: all numeric features whose names start with "observation", sorted by name, one block
///   each ("observation.state"), and the videos among `pictures`. Images in Parquet files and other
///   videos are skipped, and note() lists them.
/// - Videos: each frame is averaged to the size of its request, by default to 32 pixels along the
///   longer side, and becomes an RGB or grey block of the state. Read() starts the program
///   video_frames (apps) to decode them, which keeps video libraries out of this process. Read()
///   looks for video_frames beside this program, then in PATH. Memory holds one full frame at a
///   time.
/// - Actions: the feature "action". The last action is dropped, because the format does not record
///   the state after it.
/// - An episode is completed if its last next.success is not zero. Without that feature, no episode
///   counts as completed.
/// @param filter_key  a split of meta/info.json, for example "train"; empty: all episodes.
/// @param pictures  features that must exist. Videos among them become parts of the state.
/// @throws RequestError as OpenDemonstrations(); std::runtime_error naming the file, the column or
///   episode, and the reason; Read() also if a video is missing, does not decode, is shorter than
///   its episode or differs from meta/info.json.
[[nodiscard]] std::unique_ptr<DemonstrationReader> OpenLeRobot(
    const std::filesystem::path& folder, const std::string& filter_key = "",
    const std::vector<core::BlockRequest>& pictures = {});

/// Returns true if the folder has a meta/info.json.
[[nodiscard]] bool IsLeRobot(const std::filesystem::path& folder);

}  // namespace dfr::imitation
