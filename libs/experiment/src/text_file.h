#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::experiment::internal {

/// Replaces a file by renaming a temporary one beside it: a reader never sees an incomplete file.
/// @throws std::runtime_error naming the file and the system's error.
void ReplaceFile(const std::filesystem::path& path, std::string_view text);

/// @throws std::runtime_error naming the file.
[[nodiscard]] std::string ReadFile(const std::filesystem::path& path);

}  // namespace dfr::experiment::internal
