#pragma once

#include <ctime>
#include <filesystem>

namespace dfr::dds::internal {

/// Removes the segments that killed processes left in `folder`, 8 MB of memory each: those whose
/// owner no longer holds the lock that Fast DDS has it hold for life. Never throws; what cannot be
/// removed stays.
/// @param now  lock files that were made within ten seconds of it stay.
void RemoveStaleSegments(const std::filesystem::path& folder = "/dev/shm",
                         std::time_t now = std::time(nullptr)) noexcept;

}  // namespace dfr::dds::internal
