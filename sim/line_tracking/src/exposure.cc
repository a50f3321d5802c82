#include "exposure.h"

#include <algorithm>

namespace dfr::sim::internal {

void LightRow(const Exposure& exposure, const float* u, const float* v, int width, float* gain,
              float* glare) noexcept {
  for (int i = 0; i < width; ++i) {
    const float r2 = u[i] * u[i] + v[i] * v[i];
    gain[i] = exposure.gain * (1.0f - exposure.vignette * r2) *
              (1.0f + exposure.gradient_x * u[i] + exposure.gradient_y * v[i]);
    const float gx = u[i] - exposure.glare_x;
    const float gy = v[i] - exposure.glare_y;
    const float spot = std::max(0.0f, 1.0f - 100.0f * (gx * gx + gy * gy));
    glare[i] = exposure.glare * spot * spot + 0.5f;
  }
}

void ExposeRow(const float* gain, const float* glare, const float* noise, float noise_level,
               int width, std::uint8_t* value) noexcept {
  for (int i = 0; i < width; ++i) {
    const float lit = static_cast<float>(value[i]) * gain[i] + glare[i] + noise_level * noise[i];
    value[i] = static_cast<std::uint8_t>(static_cast<int>(std::min(255.0f, std::max(0.0f, lit))));
  }
}

}  // namespace dfr::sim::internal
