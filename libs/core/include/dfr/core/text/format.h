#pragma once

#include <cstdarg>
#include <cstddef>
#include <span>
#include <string>
#include <string_view>

namespace dfr::core {

/// Returns the output of printf() as a string of any length. The compiler checks the arguments.
/// Allocates: not for the control loop.
[[nodiscard, gnu::format(printf, 1, 2)]] std::string Format(const char* format, ...);
/// Same as Format(), for arguments that another function received.
[[nodiscard, gnu::format(printf, 1, 0)]] std::string FormatList(const char* format,
                                                                std::va_list arguments);

/// Returns `text`, which may quote a file, with each byte that controls terminals or is not UTF-8
/// replaced by "\xNN". Keeps line breaks.
[[nodiscard]] std::string Printable(std::string_view text);
/// Replaces each byte that controls terminals by "?", including line breaks unless `keeps_lines`.
/// Neither allocates nor locks.
void MakePrintable(std::span<char> text, bool keeps_lines = false) noexcept;

/// Returns the number of bytes of the UTF-8 character at the beginning of `text`, 1 to 4; 0 if
/// there is none.
[[nodiscard]] std::size_t Utf8Size(std::string_view text) noexcept;
/// Returns true if `text` is UTF-8 throughout.
[[nodiscard]] bool IsUtf8(std::string_view text) noexcept;

}  // namespace dfr::core
