#pragma once

#include <ctime>
#include <filesystem>

namespace dfr::dds::internal {

/// Removes the segments of killed processes in `folder`, 8 MB of memory each: those whose owner no
/// longer holds the lock that Fast DDS keeps for the process's lifetime. Never throws; skips
/// segments that cannot be removed.
/// @param now  lock files created within ten seconds of it are kept.
void RemoveStaleSegments(const std::filesystem::path& folder = "/dev/shm",
                         std::time_t now = std::time(nullptr)) noexcept;

}  // namespace dfr::dds::internal
