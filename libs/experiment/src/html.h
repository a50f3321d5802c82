#pragma once

#include <string>
#include <string_view>

namespace dfr::experiment::internal {

/// `text` for element contents and quoted attributes.
[[nodiscard]] std::string Escape(std::string_view text);

/// Paragraphs of escaped text; blank lines separate them.
[[nodiscard]] std::string Paragraphs(std::string_view text);

/// Fixed-point with `digits` places and a typographic minus; a rounded zero has none.
[[nodiscard]] std::string Number(double value, int digits);

[[nodiscard]] std::string Base64(std::string_view bytes);

}  // namespace dfr::experiment::internal
