#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/random.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor_guard.h"

namespace dfr::test {

/// The corridor seen by a camera: a blob at the tip in 12 x 8 grey pixels, x in [-.2, 2.2] and y in
/// [-.6, .6]. The light varies by 20 %.
inline constexpr int kWidth = 12;
inline constexpr int kHeight = 8;
inline constexpr int kPixels = kWidth * kHeight;
inline constexpr double kPixel = 0.2;

inline std::vector<double> Seen(double x, double y, core::Random& random) {
  std::vector<double> picture;
  const double light = random.Uniform(0.8, 1.2);
  for (int row = 0; row < kHeight; ++row) {
    for (int column = 0; column < kWidth; ++column) {
      const double dx = kPixel * column - 0.1 - x;
      const double dy = kPixel * (row - 3.5) - y;
      const double value = 40.0 + 150.0 * std::exp(-(dx * dx + dy * dy) / (2.0 * 0.25 * 0.25));
      picture.push_back(std::clamp(std::round(light * value + 2.0 * random.Normal()), 0.0, 255.0));
    }
  }
  return picture;
}

inline core::StateLayout PictureLayout() {
  core::StateLayout layout;
  layout.Add("camera", core::PictureShape{kHeight, kWidth, 1});
  layout.Add("clock", 1);
  return layout;
}

inline std::vector<core::Trajectory> PictureDemonstrations(std::uint64_t seed, int count) {
  core::Random random(seed);
  std::vector<core::Trajectory> demonstrations = CorridorDemonstrations(seed, count);
  for (core::Trajectory& d : demonstrations) {
    core::Matrix seen(d.states.rows(), kPixels + 1);
    for (Eigen::Index t = 0; t < seen.rows(); ++t) {
      const std::vector<double> picture = Seen(d.states(t, 1), d.states(t, 2), random);
      seen.row(t) << core::AsVector(picture).transpose(), d.states(t, 0);
    }
    d.states = seen;
  }
  return demonstrations;
}

/// Returns the model of a fit with default options.
inline std::shared_ptr<const safety::GuardModel> FittedModel() {
  static const std::shared_ptr<const safety::GuardModel> kModel = safety::GuardModel::Fit(
      PictureLayout(), PictureDemonstrations(1, 40), {.features = "pca:camera"});
  return kModel;
}

/// Returns the model with a correcting strategy.
inline std::shared_ptr<const safety::GuardModel> PictureModel() {
  static const auto kModel = As(safety::Strategy::kGuard, FittedModel());
  return kModel;
}

inline std::vector<double> StateAt(double x, double y, core::Random& random) {
  std::vector<double> state = Seen(x, y, random);
  state.push_back(0.0);
  return state;
}

inline std::shared_ptr<const safety::GuardModel> PointsModel() {
  static const std::shared_ptr<const safety::GuardModel> kModel = safety::GuardModel::Fit(
      PictureLayout(), PictureDemonstrations(1, 40), {.features = "points:camera"});
  return kModel;
}

}  // namespace dfr::test
