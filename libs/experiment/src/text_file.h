#pragma once

#include <filesystem>
#include <string>

namespace dfr::experiment::internal {

/// @throws std::runtime_error naming the file.
[[nodiscard]] std::string ReadFile(const std::filesystem::path& path);

}  // namespace dfr::experiment::internal
