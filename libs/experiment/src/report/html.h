#pragma once

#include <string>
#include <string_view>

namespace dfr::experiment::internal {

/// Escapes `text` for element contents and quoted attributes.
[[nodiscard]] std::string Escape(std::string_view text);

/// Converts text to escaped paragraphs, separated at blank lines.
[[nodiscard]] std::string Paragraphs(std::string_view text);

/// Formats a number with `digits` decimal places and a typographic minus. A rounded zero has no
/// sign.
[[nodiscard]] std::string Number(double value, int digits);

[[nodiscard]] std::string Base64(std::string_view bytes);

}  // namespace dfr::experiment::internal
