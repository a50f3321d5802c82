#include "endoscope_raster.h"

#include <algorithm>
#include <cmath>

namespace dfr::sim::internal {
namespace {

// Share of a pixel that is inside an edge: `inside` > 0 by distance, ramp of width `edge`.
inline float Cover(float inside, float inverse_edge) noexcept {
  const float c = 0.5f + inside * inverse_edge;
  return c < 0.0f ? 0.0f : (c > 1.0f ? 1.0f : c);
}

inline float Blend(float below, float above, float cover) noexcept {
  return below + cover * (above - below);
}

// A triangle wave between -1 and 1 with period 1. Rays here stay within thousands of periods.
inline float Triangle(float t) noexcept {
  const float shifted = t + 65536.0f;
  const float fraction = shifted - static_cast<float>(static_cast<int>(shifted));
  return 4.0f * std::fabs(fraction - 0.5f) - 1.0f;
}

}  // namespace

void DrawPlane(const Plane& plane, const float* u, const float* v, int width, Row& row) noexcept {
  const float inverse_edge = 1.0f / plane.edge;
  for (int i = 0; i < width; ++i) {
    const float scale =
        plane.distance / (plane.normal[0] * u[i] + plane.normal[1] * v[i] + plane.normal[2]);
    const float x = scale * (plane.x_axis[0] * u[i] + plane.x_axis[1] * v[i] + plane.x_axis[2]) -
                    plane.offset_x;
    const float y = scale * (plane.y_axis[0] * u[i] + plane.y_axis[1] * v[i] + plane.y_axis[2]) -
                    plane.offset_y;
    row.x[i] = x;
    row.y[i] = y;
    const float ax = std::fabs(x);
    const float ay = std::fabs(y);
    // The frame around the gauze, 84 x 62 mm outside, 68 x 44 mm inside.
    const float frame =
        std::min(Cover(0.042f - ax, inverse_edge), Cover(0.031f - ay, inverse_edge));
    const float gauze =
        std::min(Cover(0.034f - ax, inverse_edge), Cover(0.022f - ay, inverse_edge));
    // The weave: threads every millimetre, both ways.
    const float weave = 1.0f + 0.03f * Triangle(x * 1000.0f) + 0.03f * Triangle(y * 1000.0f);
    const float curve = plane.line[0] + x * (plane.line[1] + x * plane.line[2]);
    const float slope = plane.line[1] + 2.0f * x * plane.line[2];
    // Distance to a gentle curve: 1/sqrt(1 + s^2) about the mean slope, to second order.
    const float s2 = slope * slope;
    const float away = std::fabs(y - curve) * (1.0f - 0.5f * s2 + 0.375f * s2 * s2);
    const float line = std::min(Cover(plane.line_half_width - away, inverse_edge),
                                Cover(plane.line_half_length - ax, inverse_edge));
    const float white = gauze * weave;
    row.b[i] = Blend(Blend(Blend(0.06f, 0.50f, frame), 0.76f * white, gauze), 0.12f * weave, line);
    row.g[i] = Blend(Blend(Blend(0.06f, 0.50f, frame), 0.79f * white, gauze), 0.10f * weave, line);
    row.r[i] = Blend(Blend(Blend(0.07f, 0.50f, frame), 0.81f * white, gauze), 0.70f * weave, line);
  }
}

void DrawMark(float center_x, float center_y, float radius, float edge, int x0, int x1,
              Row& row) noexcept {
  const float inverse_edge = 1.0f / edge;
  for (int i = x0; i < x1; ++i) {
    const float dx = row.x[i] - center_x;
    const float dy = row.y[i] - center_y;
    const float cover = Cover(radius - std::sqrt(dx * dx + dy * dy), inverse_edge);
    row.b[i] = Blend(row.b[i], 0.62f, cover);
    row.g[i] = Blend(row.g[i], 0.18f, cover);
    row.r[i] = Blend(row.r[i], 0.10f, cover);
  }
}

void DrawRod(const Rod& rod, const float* u, const float* v, int x0, int x1, Row& row) noexcept {
  const float inverse_edge = 1.0f / rod.edge;
  const float dx = rod.bx - rod.ax;
  const float dy = rod.by - rod.ay;
  const float inverse_square = 1.0f / std::max(dx * dx + dy * dy, 1e-12f);
  for (int i = x0; i < x1; ++i) {
    const float px = u[i] - rod.ax;
    const float py = v[i] - rod.ay;
    const float t = std::min(1.0f, std::max(0.0f, (px * dx + py * dy) * inverse_square));
    const float ex = px - t * dx;
    const float ey = py - t * dy;
    const float away = std::sqrt(ex * ex + ey * ey);
    const float radius = rod.radius_a + t * (rod.radius_b - rod.radius_a);
    const float cover = Cover(radius - away, inverse_edge);
    const float side = away / radius;
    const float shade = 1.0f - rod.shade * side * side;
    row.b[i] = Blend(row.b[i], rod.b * shade, cover);
    row.g[i] = Blend(row.g[i], rod.g * shade, cover);
    row.r[i] = Blend(row.r[i], rod.r * shade, cover);
  }
}

void Expose(const Light& light, const float* u, const float* v, const float* noise_b,
            const float* noise_g, const float* noise_r, int width, Row& row,
            std::uint8_t* bgr) noexcept {
  for (int i = 0; i < width; ++i) {
    const float r2 = u[i] * u[i] + v[i] * v[i];
    const float lit = 255.0f * light.gain * (1.0f - light.vignette * r2) *
                      (1.0f + light.gradient_x * u[i] + light.gradient_y * v[i]);
    const float gx = u[i] - light.glare_x;
    const float gy = v[i] - light.glare_y;
    const float spot = std::max(0.0f, 1.0f - 100.0f * (gx * gx + gy * gy));
    const float glare = light.glare * spot * spot + 0.5f;
    row.b[i] = std::min(255.0f, std::max(0.0f, row.b[i] * lit + glare + light.noise * noise_b[i]));
    row.g[i] = std::min(255.0f, std::max(0.0f, row.g[i] * lit + glare + light.noise * noise_g[i]));
    row.r[i] = std::min(255.0f, std::max(0.0f, row.r[i] * lit + glare + light.noise * noise_r[i]));
  }
  for (int i = 0; i < width; ++i) {
    bgr[3 * i] = static_cast<std::uint8_t>(static_cast<int>(row.b[i]));
    bgr[3 * i + 1] = static_cast<std::uint8_t>(static_cast<int>(row.g[i]));
    bgr[3 * i + 2] = static_cast<std::uint8_t>(static_cast<int>(row.r[i]));
  }
}

}  // namespace dfr::sim::internal
