#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/reduction/image_features.h"

namespace dfr::reduction::internal {

/// Prefixes in the order of StateReduction::Kind.
inline constexpr std::array<std::string_view, 4> kPrefixes = {"", "pca:", "points:", "slow:"};

/// Rounds to bytes. @returns false if a value is out of range.
inline bool ToBytes(std::span<const double> values, std::vector<std::uint8_t>& bytes) noexcept {
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!(values[i] >= 0.0 && values[i] <= 255.0)) return false;
    const double above = values[i] + 0.5;  // lround() would dominate the time per picture.
    bytes[i] = static_cast<std::uint8_t>(above);
  }
  return true;
}

inline PictureView ViewOf(const ImageFeatures& picture,
                          const std::vector<std::uint8_t>& bytes) noexcept {
  const ImageFeaturesOptions& o = picture.options();
  return {bytes.data(), o.width, o.height, o.channels,
          static_cast<std::size_t>(o.width) * static_cast<std::size_t>(o.channels)};
}

/// Returns the shape of the features of a picture.
inline core::PictureShape ShapeOf(const ImageFeatures& picture) noexcept {
  const ImageFeaturesOptions& o = picture.options();
  return {o.out_height, o.out_width, o.grey ? 1 : o.channels};
}

}  // namespace dfr::reduction::internal
