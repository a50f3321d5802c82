#pragma once

#include <cstdarg>
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

/// Returns `text`, which may quote a file, with the bytes that control terminals as "\xNN". Keeps
/// line breaks.
[[nodiscard]] std::string Printable(std::string_view text);
/// Replaces each byte that controls terminals by "?", also line breaks unless `keeps_lines`.
/// Neither allocates nor locks.
void MakePrintable(std::span<char> text, bool keeps_lines = false) noexcept;

}  // namespace dfr::core
