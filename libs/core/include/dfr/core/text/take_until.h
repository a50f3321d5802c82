#pragma once

#include <algorithm>
#include <string_view>

namespace dfr::core {

/// Returns the text before the first `separator`, or all text. Removes it and the separator from
/// `text`.
[[nodiscard]] inline std::string_view TakeUntil(std::string_view& text, char separator) noexcept {
  const std::string_view item = text.substr(0, text.find(separator));
  text.remove_prefix(std::min(item.size() + 1, text.size()));
  return item;
}

}  // namespace dfr::core
