#pragma once

#include <filesystem>
#include <vector>

#include "apps/planar/methods.h"
#include "apps/planar/picture.h"
#include "apps/planar/task.h"

namespace dfr::apps::planar {

/// Writes one page without any other file, to scrub through time and methods: support, stay-out
/// regions, demonstrations, and each method's way. The page holds the supports themselves.
/// @throws std::runtime_error naming the file that cannot be written.
void WritePage(const Task& task, const Methods& methods, const std::vector<Episode>& episodes,
               const std::filesystem::path& path);

}  // namespace dfr::apps::planar
