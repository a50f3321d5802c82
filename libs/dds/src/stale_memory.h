#pragma once

#include <ctime>
#include <filesystem>

namespace dfr::dds::internal {

/// Removes the shared memory segments (8 MB each) that killed processes left in `folder`. Fast DDS
/// locks each segment for the lifetime of its process, so a free lock marks a stale segment. Never
/// throws; skips segments that cannot be removed.
/// @param now  current time. Lock files less than ten seconds old are kept.
void RemoveStaleSegments(const std::filesystem::path& folder = "/dev/shm",
                         std::time_t now = std::time(nullptr)) noexcept;

}  // namespace dfr::dds::internal
