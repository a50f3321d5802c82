#pragma once

#include <cstdint>

namespace dfr::sim::internal {

/// One row of pixels on its way to a picture: colours in [0, 1], gauze coordinates in m.
struct Row {
  static constexpr int kMaxWidth = 2048;
  alignas(64) float x[kMaxWidth];
  alignas(64) float y[kMaxWidth];
  alignas(64) float b[kMaxWidth];
  alignas(64) float g[kMaxWidth];
  alignas(64) float r[kMaxWidth];
};

/// The gauze's plane and what is drawn on it, for the loops below.
struct Plane {
  float x_axis[3];  // numerators and denominator of the gauze coordinates of the ray (u, v, 1)
  float y_axis[3];
  float normal[3];
  float offset_x;
  float offset_y;
  float distance;
  float line[3];
  float line_half_length;
  float line_half_width;
  float line_slope_scale;  // 1 / sqrt(1 + c1^2)
  float edge;              // width of an edge's ramp, m
};

/// Gauze, its frame, the table below, and the line.
void DrawPlane(const Plane& plane, const float* u, const float* v, int width, Row& row) noexcept;

/// A disc on the gauze's plane in columns [x0, x1).
void DrawMark(float center_x, float center_y, float radius, float edge, int x0, int x1,
              Row& row) noexcept;

/// A tapered rod between two points of the normalised image, radii at both, in columns [x0, x1).
struct Rod {
  float ax, ay, bx, by;
  float radius_a, radius_b;
  float edge;
  float b, g, r;
  float shade;  // how much darker the sides are
};
void DrawRod(const Rod& rod, const float* u, const float* v, int x0, int x1, Row& row) noexcept;

/// Light, glare and noise, and conversion to 8 bits.
struct Light {
  float gain;
  float gradient_x;
  float gradient_y;
  float vignette;
  float glare;
  float glare_x;
  float glare_y;
  float noise;
};
void Expose(const Light& light, const float* u, const float* v, const float* noise_b,
            const float* noise_g, const float* noise_r, int width, Row& row,
            std::uint8_t* bgr) noexcept;

}  // namespace dfr::sim::internal
