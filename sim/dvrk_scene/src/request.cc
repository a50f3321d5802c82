#include "request.h"

#include <array>
#include <charconv>
#include <optional>

#include "dfr/core/contract.h"
#include "dfr/core/text/numbers.h"
#include "dfr/core/text/take_until.h"

namespace dfr::sim::internal {
std::string_view NextWord(std::string_view& text) noexcept {
  const std::string_view word = core::TakeUntil(text, ' ');
  while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
  return word;
}

double ParseNumber(std::string_view text, const char* what) {
  const std::optional<double> value = core::ParseNumber(text);
  DFR_THROW_UNLESS(value, what << " must be a number, not '" << text << "'");
  return *value;
}

std::uint64_t ParseCount(std::string_view text, const char* what) {
  const std::optional<std::uint64_t> value = core::ParseInteger<std::uint64_t>(text);
  DFR_THROW_UNLESS(value, what << " must be a whole number, not '" << text << "'");
  return *value;
}

std::string Shortest(double value) {
  std::array<char, 32> text;
  const auto [end, error] = std::to_chars(text.data(), text.data() + text.size(), value);
  return {text.data(), end};
}

}  // namespace dfr::sim::internal
