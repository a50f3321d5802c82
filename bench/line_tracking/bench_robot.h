#pragma once

#include <filesystem>
#include <string>

#include "dfr/dds/participant.h"

namespace dfr::apps::line_tracking {

/// The robot's program: runs episodes until a reason to hold occurs, then waits for "go" on its
/// input.
void RunRobot(const std::filesystem::path& folder, int domain, double image_age_s,
              dds::Discovery discovery, const std::string& platform);

/// Makes the policy return NaN until the next "go". Async-signal-safe.
void BreakPolicy() noexcept;

}  // namespace dfr::apps::line_tracking
