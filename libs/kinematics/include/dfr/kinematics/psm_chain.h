#pragma once

#include <array>
#include <cmath>

namespace dfr::kinematics {

/// One row of the PSM's modified Denavit-Hartenberg table: Rx(alpha) Tx(a) Rz(theta) Tz(d). The
/// joint value is added to d if `prismatic`, else to theta. Metres and radians.
struct PsmLink {
  double alpha;
  double a;
  double d;
  double theta;
  bool prismatic;
};

inline constexpr std::array<PsmLink, 6> kPsmLinks = {{
    {1.5707963267948966, 0.0, 0.0, 1.5707963267948966, false},
    {-1.5707963267948966, 0.0, 0.0, -1.5707963267948966, false},
    {1.5707963267948966, 0.0, -0.4318, 0.0, true},
    {0.0, 0.0, 0.4162, 0.0, false},
    {-1.5707963267948966, 0.0, 0.0, -1.5707963267948966, false},
    {-1.5707963267948966, 0.0091, 0.0, -1.5707963267948966, false},
}};

/// Psm::Tip() for any number type, including types for automatic differentiation.
/// @param q  six joint values.
/// @param tip  three coordinates in the base frame, overwritten.
template <typename T>
void PsmTip(const T* q, double jaw_length, T* tip) {
  using std::cos;
  using std::sin;
  // In the last link's frame the tool points along y: the console's tool frame is rotated.
  T x = T(0.0);
  T y = T(jaw_length);
  T z = T(0.0);
  for (int i = 5; i >= 0; --i) {
    const PsmLink& link = kPsmLinks[static_cast<std::size_t>(i)];
    T theta = T(link.theta);
    T d = T(link.d);
    (link.prismatic ? d : theta) += q[i];
    z += d;
    const T turned_x = cos(theta) * x - sin(theta) * y + link.a;
    const T turned_y = sin(theta) * x + cos(theta) * y;
    const double c = std::cos(link.alpha);
    const double s = std::sin(link.alpha);
    x = turned_x;
    y = c * turned_y - s * z;
    z = s * turned_y + c * z;
  }
  tip[0] = x;
  tip[1] = y;
  tip[2] = z;
}

}  // namespace dfr::kinematics
