#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "apps/study/study.h"

namespace dfr::study {

/// Writes a page with one plot for the demonstrations and one per method: paths in the plane of two
/// entries of the state. `entries` names them as core::FeatureSelection does; "": the first two.
/// @throws std::invalid_argument unless `entries` has two entries; std::runtime_error naming the
///   file.
void SavePicture(const std::vector<experiment::FilmedEpisode>& recordings,
                 const sim::GalleryTask& task, const std::string& entries,
                 const std::filesystem::path& path);

}  // namespace dfr::study
