#pragma once

#include <cstdint>

#include "dfr/vision/line_vision.h"

namespace dfr::vision::internal {

struct Exposure {
  double brightness = 0.0;  ///< 90 % quantile of the green channel: brightness of the gauze
  double saturated = 0.0;   ///< fraction of saturated pixels
  std::uint64_t hash = 0;
};

/// Measures every 13th pixel.
[[nodiscard]] Exposure Measure(const ImageView& image) noexcept;
/// Returns kDark, kOverexposed or kNothing.
[[nodiscard]] NotSeen Judge(const Exposure& exposure) noexcept;

}  // namespace dfr::vision::internal
