#pragma once

#include <cstdint>

namespace dfr::sim::internal {

/// Light over a picture, in coordinates of the normalised image.
struct Exposure {
  float gain;
  float gradient_x;
  float gradient_y;
  float vignette;  // fraction lost per squared unit from the optical axis
  float glare;
  float glare_x;
  float glare_y;
  float noise;
};

/// Computes the gain of each pixel of a row and the glare added to it.
/// @param u, v  x/z and y/z of each pixel's ray.
void LightRow(const Exposure& exposure, const float* u, const float* v, int width, float* gain,
              float* glare) noexcept;

/// Exposes one colour of a row in place: value * gain + glare + noise, within [0, 255].
/// @param noise  `width` standard normal numbers.
void ExposeRow(const float* gain, const float* glare, const float* noise, float noise_level,
               int width, std::uint8_t* value) noexcept;

}  // namespace dfr::sim::internal
