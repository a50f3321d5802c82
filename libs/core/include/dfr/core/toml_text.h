#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::core {

/// To be asked before toml++ parses `text`: version 3.3 is undone by what is not as TOML has it, by
/// broken UTF-8, by brackets that do not match, by a value that is missing. So the whole is checked
/// here: every name, value, bracket and line. Dates, numbers that are not decimal and brackets
/// nested more than 32 deep are refused, too.
/// @returns what to parse in place of `text`: it means the same, line by line, in ASCII.
/// @throws std::runtime_error naming `file`, the line and what is wrong; also if the text is longer
///   than a mebibyte.
[[nodiscard]] std::string CheckToml(const std::filesystem::path& file, std::string_view text);

}  // namespace dfr::core
