#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace dfr::core {

/// To be asked before toml++ parses `text`, which it trusts to be a text: control characters,
/// broken UTF-8, and characters beyond ASCII outside quotes and comments, which TOML does not
/// allow, lead version 3.3 astray. So do those in strings where a value is not well-formed.
/// @returns what to parse in place of `text`: it means the same, line by line, in ASCII.
/// @throws std::runtime_error naming `file`, the line and what is wrong; also if the text is longer
///   than a mebibyte.
[[nodiscard]] std::string CheckToml(const std::filesystem::path& file, std::string_view text);

}  // namespace dfr::core
