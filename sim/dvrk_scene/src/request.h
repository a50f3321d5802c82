#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace dfr::sim::internal {

/// The text before the first space, which is taken off `text` with all spaces behind it.
[[nodiscard]] std::string_view NextWord(std::string_view& text) noexcept;

/// @throws std::invalid_argument saying that `what` is no such number.
[[nodiscard]] double ParseNumber(std::string_view text, const char* what);
[[nodiscard]] std::uint64_t ParseCount(std::string_view text, const char* what);

/// The shortest text that reads back as `value`.
[[nodiscard]] std::string Shortest(double value);

}  // namespace dfr::sim::internal
