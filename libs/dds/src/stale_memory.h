#pragma once

#include <filesystem>

namespace dfr::dds::internal {

/// Removes the segments that killed processes left in `folder`, 8 MB of memory each: those whose
/// owner no longer holds the lock that Fast DDS has it hold for life. Never throws; what cannot be
/// removed stays.
void RemoveStaleSegments(const std::filesystem::path& folder = "/dev/shm") noexcept;

}  // namespace dfr::dds::internal
