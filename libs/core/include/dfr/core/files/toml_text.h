#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::core {

/// Validates `text` before toml++ parses it. Version 3.3 of toml++ crashes on some invalid
/// input: broken UTF-8, unmatched brackets, missing values. This function therefore checks every
/// name, value, bracket and line. It also rejects dates, non-decimal numbers and brackets nested
/// more than 32 deep.
/// @returns the text to parse instead of `text`, in ASCII: each line has the same meaning.
/// @throws std::runtime_error naming `file`, the line and the problem; also if the text exceeds 1
///   MiB.
[[nodiscard]] std::string CheckToml(const std::filesystem::path& file, std::string_view text);

/// Returns the content of a configuration file, for CheckToml(). Rejects folders and devices,
/// because a device may have no end.
/// @throws std::runtime_error naming `file` and the problem.
[[nodiscard]] std::string ReadTomlText(const std::filesystem::path& file);

}  // namespace dfr::core
