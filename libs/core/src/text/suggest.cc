#include "dfr/core/text/suggest.h"

#include <algorithm>
#include <cstddef>

namespace dfr::core {
namespace {

// Returns the optimal string alignment distance: Levenshtein's, with a swap of neighbours as one
// change.
std::size_t Distance(std::string_view a, std::string_view b) {
  std::vector<std::vector<std::size_t>> rows(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i) {
    for (std::size_t j = 0; j <= b.size(); ++j) {
      if (i == 0 || j == 0) {
        rows[i][j] = i + j;
        continue;
      }
      const std::size_t change = a[i - 1] == b[j - 1] ? 0 : 1;
      rows[i][j] = std::min({rows[i - 1][j] + 1, rows[i][j - 1] + 1, rows[i - 1][j - 1] + change});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
        rows[i][j] = std::min(rows[i][j], rows[i - 2][j - 2] + 1);
      }
    }
  }
  return rows[a.size()][b.size()];
}

}  // namespace

std::string Closest(std::string_view name, std::span<const std::string> known) {
  // Longer names get no suggestion: the time is proportional to the product of both lengths.
  constexpr std::size_t kLongest = 64;
  if (name.size() > kLongest) return "";
  std::string closest;
  std::size_t least = std::max<std::size_t>(name.size() / 3, 1) + 1;
  for (const std::string& other : known) {
    if (other.size() > kLongest) continue;
    const std::size_t distance = Distance(name, other);
    if (distance < least) {
      least = distance;
      closest = other;
    }
  }
  return closest;
}

}  // namespace dfr::core
