#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"

namespace dfr::test {

/// A disc that moves through a gap of random height in a wall, in noisy grey pictures of kSide x
/// kSide bytes. x goes from 0 to 1, the wall is at .5, y and the gap are in [.2, .8].
struct GapPictures {
  static constexpr int kSide = 32;
  static constexpr Eigen::Index kPixels = kSide * kSide;

  std::vector<core::Trajectory> truth;  ///< States [x, y, gap]; actions are changes of [x, y].
  /// One picture per state, one demonstration after the other.
  std::vector<std::uint8_t> pixels;

  /// Returns demonstrations whose states are rows of `scores`, one per picture.
  [[nodiscard]] std::vector<core::Trajectory> WithScores(const core::Matrix& scores) const {
    std::vector<core::Trajectory> demonstrations = truth;
    Eigen::Index row = 0;
    for (core::Trajectory& d : demonstrations) {
      const Eigen::Index count = d.states.rows();
      d.states = scores.middleRows(row, count);
      row += count;
    }
    return demonstrations;
  }
};

inline void DrawGap(double x, double y, double gap, core::Random& random, std::uint8_t* picture) {
  constexpr int kSide = GapPictures::kSide;
  constexpr double kRadius = 0.08;
  constexpr double kHalfGap = 0.13;
  const double light = random.Uniform(0.9, 1.1);
  for (int row = 0; row < kSide; ++row) {
    for (int column = 0; column < kSide; ++column) {
      const double px = (column + 0.5) / kSide;
      const double py = (row + 0.5) / kSide;
      // Edges are a pixel wide.
      const auto cover = [](double inside) { return std::clamp(inside * kSide + 0.5, 0.0, 1.0); };
      const double disc = cover(kRadius - std::hypot(px - x, py - y));
      const double wall =
          std::min(cover(0.03 - std::abs(px - 0.5)), cover(std::abs(py - gap) - kHalfGap));
      const double value = 60.0 + 120.0 * wall * (1.0 - disc) + 150.0 * disc;
      picture[row * kSide + column] =
          static_cast<std::uint8_t>(std::clamp(light * value + 6.0 * random.Normal(), 0.0, 255.0));
    }
  }
}

inline GapPictures MakeGapPictures(int demonstrations, std::uint64_t seed) {
  core::Random random(seed);
  GapPictures all;
  for (int d = 0; d < demonstrations; ++d) {
    const double gap = random.Uniform(0.25, 0.75);
    double x = random.Uniform(0.08, 0.12);
    double y = random.Uniform(0.2, 0.8);
    const double goal = random.Uniform(0.45, 0.55);
    std::vector<double> states;
    std::vector<double> actions;
    const auto record = [&] {
      states.insert(states.end(), {x, y, gap});
      all.pixels.resize(all.pixels.size() + GapPictures::kPixels);
      DrawGap(x, y, gap, random, all.pixels.data() + all.pixels.size() - GapPictures::kPixels);
    };
    record();
    while (x < 0.9) {
      const double aim = x < 0.55 ? gap : goal;
      const double dx = 0.025 * random.Uniform(0.9, 1.1);
      const double dy = std::clamp(0.25 * (aim - y), -0.03, 0.03) + 0.002 * random.Normal();
      x += dx;
      y += dy;
      actions.insert(actions.end(), {dx, dy});
      record();
    }
    core::Trajectory one;
    one.states = Eigen::Map<const core::Matrix>(states.data(),
                                                static_cast<Eigen::Index>(states.size()) / 3, 3);
    one.controls = Eigen::Map<const core::Matrix>(actions.data(),
                                                  static_cast<Eigen::Index>(actions.size()) / 2, 2);
    all.truth.push_back(std::move(one));
  }
  return all;
}

}  // namespace dfr::test
