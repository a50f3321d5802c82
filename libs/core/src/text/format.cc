#include "dfr/core/text/format.h"

#include <cstdarg>
#include <cstdio>

namespace dfr::core {

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
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    const auto next = static_cast<unsigned char>(i + 1 < text.size() ? text[i + 1] : 0);
    // In UTF-8, U+0080 to U+009F also control terminals.
    const bool second = c == 0xC2 && next >= 0x80 && next < 0xA0;
    if (second || (c < 0x20 && c != '\n') || c == 0x7F) {
      printable += Format("\\x%02x", c);
      if (second) printable += Format("\\x%02x", static_cast<unsigned char>(text[++i]));
    } else {
      printable += text[i];
    }
  }
  return printable;
}

}  // namespace dfr::core
