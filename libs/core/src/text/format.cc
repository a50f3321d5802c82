#include "dfr/core/text/format.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>

namespace dfr::core {
namespace {

// Returns the number of bytes at the beginning of a non-empty text that control terminals: 0, 1,
// or 2 for U+0080 to U+009F in UTF-8.
std::size_t ControlSize(std::string_view text) noexcept {
  const auto c = static_cast<unsigned char>(text[0]);
  if (c < 0x20 || c == 0x7F) return 1;
  const auto next = static_cast<unsigned char>(text.size() > 1 ? text[1] : 0);
  return c == 0xC2 && next >= 0x80 && next < 0xA0 ? 2 : 0;
}

}  // namespace

std::string Format(const char* format, ...) {
  std::va_list arguments;
  va_start(arguments, format);
  std::string text = FormatList(format, arguments);
  va_end(arguments);
  return text;
}

std::string FormatList(const char* format, std::va_list arguments) {
  std::va_list again;
  va_copy(again, arguments);
  const int size = std::vsnprintf(nullptr, 0, format, again);
  va_end(again);
  std::string text(static_cast<std::size_t>(size > 0 ? size : 0), '\0');
  std::vsnprintf(text.data(), text.size() + 1, format, arguments);
  return text;
}

std::string Printable(std::string_view text) {
  std::string printable;
  while (!text.empty()) {
    const std::size_t size = Utf8Size(text);
    const std::string_view whole = text.substr(0, std::max<std::size_t>(size, 1));
    if (size > 0 && (ControlSize(text) == 0 || text[0] == '\n')) {
      printable += whole;
    } else {
      for (const char c : whole) printable += Format("\\x%02x", static_cast<unsigned char>(c));
    }
    text.remove_prefix(whole.size());
  }
  return printable;
}

void MakePrintable(std::span<char> text, bool keeps_lines) noexcept {
  while (!text.empty()) {
    const std::size_t size = ControlSize({text.data(), text.size()});
    if (!(keeps_lines && text[0] == '\n')) std::ranges::fill(text.first(size), '?');
    text = text.subspan(std::max<std::size_t>(size, 1));
  }
}

std::size_t Utf8Size(std::string_view text) noexcept {
  if (text.empty()) return 0;
  const auto byte = [text](std::size_t k) { return static_cast<unsigned char>(text[k]); };
  const unsigned char first = byte(0);
  if (first < 0x80) return 1;
  const std::size_t size = first < 0xC2 ? 0 : first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
  if (size == 0 || first > 0xF4 || text.size() < size) return 0;
  // Excludes longer forms of shorter characters, surrogates, and numbers beyond U+10FFFF.
  const unsigned char least = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80;
  const unsigned char most = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;
  if (byte(1) < least || byte(1) > most) return 0;
  for (std::size_t k = 2; k < size; ++k) {
    if ((byte(k) & 0xC0U) != 0x80) return 0;
  }
  return size;
}

bool IsUtf8(std::string_view text) noexcept {
  while (!text.empty()) {
    const std::size_t size = Utf8Size(text);
    if (size == 0) return false;
    text.remove_prefix(size);
  }
  return true;
}

}  // namespace dfr::core
