#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::experiment::internal {

/// Replaces a file through a temporary one beside it, so that a reader never sees half of it.
/// @throws std::runtime_error naming the file and what the system said.
void ReplaceFile(const std::filesystem::path& path, std::string_view text);

/// @throws std::runtime_error naming the file.
[[nodiscard]] std::string ReadFile(const std::filesystem::path& path);

}  // namespace dfr::experiment::internal
