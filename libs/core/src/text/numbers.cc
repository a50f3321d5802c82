#include "dfr/core/text/numbers.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstddef>

namespace dfr::core {
namespace {

bool IsDigit(char c) noexcept { return c >= '0' && c <= '9'; }

// Returns true if a decimal number outside the range of double is too small rather than too large:
// with the exponent applied, its first nonzero digit follows the decimal point.
bool IsTiny(std::string_view text) noexcept {
  const std::size_t e = std::min(text.find_first_of("eE"), text.size());
  const std::string_view digits = text.substr(0, e);
  const std::size_t point = std::min(digits.find('.'), digits.size());
  const std::size_t first = digits.find_first_of("123456789");
  if (first == std::string_view::npos) return true;
  // Saturates: an exponent beyond 64 bits outweighs the digits of any text.
  constexpr long long kFar = 1'000'000'000'000;
  long long exponent = 0;
  if (e < text.size()) {
    std::string_view power = text.substr(e + 1);
    if (power.starts_with('+')) power.remove_prefix(1);
    const auto [stop, error] = std::from_chars(power.data(), power.data() + power.size(), exponent);
    if (error == std::errc::result_out_of_range) exponent = power.starts_with('-') ? -kFar : kFar;
    exponent = std::clamp(exponent, -kFar, kFar);
  }
  const auto place = static_cast<long long>(point) - static_cast<long long>(first);
  return place + exponent <= 0;
}

}  // namespace

std::optional<double> ParseNumber(std::string_view text) noexcept {
  std::string_view number = text;
  const bool negative = number.starts_with('-');
  if (negative || number.starts_with('+')) number.remove_prefix(1);
  if (number.empty() || (!IsDigit(number[0]) && number[0] != '.')) return std::nullopt;
  double value = 0.0;
  const char* const end = number.data() + number.size();
  const auto [stop, error] = std::from_chars(number.data(), end, value);
  if (stop != end) return std::nullopt;
  if (error == std::errc::result_out_of_range) {
    if (!IsTiny(number)) return std::nullopt;
    value = 0.0;
  } else if (error != std::errc() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return negative ? -value : value;
}

bool LooksLikeNumber(std::string_view text) noexcept {
  if (text.starts_with('-') || text.starts_with('+')) text.remove_prefix(1);
  const auto is = [text](std::string_view word) {
    return std::equal(text.begin(), text.end(), word.begin(), word.end(), [](char a, char b) {
      return std::tolower(static_cast<unsigned char>(a)) == b;
    });
  };
  if (is("nan") || is("inf") || is("infinity")) return true;
  if (text.starts_with('.')) text.remove_prefix(1);
  return !text.empty() && IsDigit(text[0]);
}

}  // namespace dfr::core
