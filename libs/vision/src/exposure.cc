#include "exposure.h"

#include <array>
#include <cstddef>

namespace dfr::vision::internal {

Exposure Measure(const ImageView& image) noexcept {
  std::array<int, 256> histogram{};
  Exposure exposure;
  exposure.hash = 1469598103934665603ULL;
  int count = 0;
  int saturated = 0;
  for (int y = 0; y < image.height; ++y) {
    const std::uint8_t* row = image.data + static_cast<std::size_t>(y) * image.stride;
    for (int x = (y * 5) % 13; x < image.width; x += 13) {
      const std::uint8_t* p = row + 3 * x;
      exposure.hash = (exposure.hash ^
                       (static_cast<std::uint64_t>(p[0]) | static_cast<std::uint64_t>(p[1]) << 8 |
                        static_cast<std::uint64_t>(p[2]) << 16)) *
                      1099511628211ULL;
      ++histogram[p[1]];
      if (p[0] >= 253 && p[1] >= 253 && p[2] >= 253) ++saturated;
      ++count;
    }
  }
  exposure.saturated = static_cast<double>(saturated) / count;
  int above = 0;
  int level = 255;
  while (level > 0 && above < count / 10) above += histogram[static_cast<std::size_t>(level--)];
  exposure.brightness = level;
  return exposure;
}

NotSeen Judge(const Exposure& exposure) noexcept {
  if (exposure.brightness < 25.0) return NotSeen::kDark;
  if (exposure.saturated > 0.3) return NotSeen::kOverexposed;
  return NotSeen::kNothing;
}

}  // namespace dfr::vision::internal
