#pragma once

#include <ctime>
#include <filesystem>

namespace dfr::dds::internal {

/// Removes the shared memory segments of killed processes in `folder`, 8 MB each: the segments
/// whose lock, which Fast DDS holds for the process's lifetime, is free. Never throws; skips
/// segments that cannot be removed.
/// @param now  present time. Lock files less than ten seconds old are kept.
void RemoveStaleSegments(const std::filesystem::path& folder = "/dev/shm",
                         std::time_t now = std::time(nullptr)) noexcept;

}  // namespace dfr::dds::internal
