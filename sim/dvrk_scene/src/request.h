#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace dfr::sim::internal {

/// Returns the text before the first space and removes it, with all spaces after it, from `text`.
[[nodiscard]] std::string_view NextWord(std::string_view& text) noexcept;

/// @throws std::invalid_argument if the text is not a number; the message names `what`.
[[nodiscard]] double ParseNumber(std::string_view text, const char* what);
[[nodiscard]] std::uint64_t ParseCount(std::string_view text, const char* what);

/// Returns the shortest text that reads back as `value`.
[[nodiscard]] std::string Shortest(double value);

}  // namespace dfr::sim::internal
