#pragma once

#include <charconv>
#include <concepts>
#include <optional>
#include <string_view>
#include <system_error>

namespace dfr::core {

// Parsers for all numbers that users write: on command lines, in tables, in configurations. The
// whole text must be the number. White space, hexadecimal and locales are not supported.

/// Parses a decimal number, "-1.5e-3" or "+7". Rounds a number too small for a double to zero.
/// Rejects a number that is too large, NaN and infinity.
[[nodiscard]] std::optional<double> ParseNumber(std::string_view text) noexcept;

/// Parses a decimal whole number in the range of T. Rejects a minus before an unsigned number.
template <std::integral T>
[[nodiscard]] std::optional<T> ParseInteger(std::string_view text) noexcept {
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  T value{};
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || stop != end) return std::nullopt;
  return value;
}

/// Returns true if the text is meant as a number, valid or not: if it starts with a digit after an
/// optional sign and point, or is NaN or infinity. Distinguishes samples from column headings.
[[nodiscard]] bool LooksLikeNumber(std::string_view text) noexcept;

}  // namespace dfr::core
