#pragma once

#include <charconv>
#include <concepts>
#include <optional>
#include <string_view>
#include <system_error>

namespace dfr::core {

/// The one reading of numbers that users write: on command lines, in tables, in configurations.
/// The whole text is the number; there is no white space, no hexadecimal, no locale.

/// A decimal number, "-1.5e-3" or "+7". One too small for a double is rounded to zero; one too
/// large, NaN and infinity are refused.
[[nodiscard]] std::optional<double> ParseNumber(std::string_view text) noexcept;

/// A decimal whole number within the range of T; a sign before an unsigned one is refused.
template <std::integral T>
[[nodiscard]] std::optional<T> ParseInteger(std::string_view text) noexcept {
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  T value{};
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || stop != end) return std::nullopt;
  return value;
}

/// Whether the text is meant as a number, well written or not: it begins with a digit, behind a
/// sign and a point perhaps, or is NaN or an infinity. A heading of a table is none.
[[nodiscard]] bool LooksLikeNumber(std::string_view text) noexcept;

}  // namespace dfr::core
