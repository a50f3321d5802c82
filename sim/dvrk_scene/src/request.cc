#include "request.h"

#include <array>
#include <charconv>
#include <system_error>

#include "dfr/core/contract.h"

namespace dfr::sim::internal {
namespace {

template <typename T>
T Parse(std::string_view text, const char* what, const char* kind) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  DFR_THROW_UNLESS(error == std::errc() && end == text.data() + text.size(),
                   what << " must be " << kind << ", not '" << text << "'");
  return value;
}

}  // namespace

std::string_view NextWord(std::string_view& text) noexcept {
  const std::string_view word = text.substr(0, text.find(' '));
  text.remove_prefix(word.size());
  while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
  return word;
}

double ParseNumber(std::string_view text, const char* what) {
  return Parse<double>(text, what, "a number");
}

std::uint64_t ParseCount(std::string_view text, const char* what) {
  return Parse<std::uint64_t>(text, what, "a whole number");
}

std::string Shortest(double value) {
  std::array<char, 32> text;
  const auto [end, error] = std::to_chars(text.data(), text.data() + text.size(), value);
  return {text.data(), end};
}

}  // namespace dfr::sim::internal
