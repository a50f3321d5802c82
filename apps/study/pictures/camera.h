#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"
#include "dfr/sim/gallery/gallery.h"

namespace dfr::study {

/// Changes of a picture that do not change the task. All zero: no change.
struct Nuisances {
  double light = 0.0;       ///< Maximum relative change of the light, drawn per episode.
  double noise = 0.0;       ///< Standard deviation per pixel and picture, as a share of 255.
  bool distractor = false;  ///< A disc of random colour and position, drawn per episode.
  int shift = 0;            ///< Shift in pixels, in one of four directions, drawn per episode.
  bool occlusion = false;   ///< A dark square, a third of the picture wide, drawn per episode.

  bool operator==(const Nuisances&) const = default;
};

/// Takes pictures of the states of a gallery task. Belongs to one thread. Only the constructor
/// throws and allocates.
class Camera {
 public:
  /// Side of a picture in pixels, and its number of entries.
  static constexpr int kSide = sim::GalleryPlant::kPictureSide;
  static constexpr int kSize = kSide * kSide * 3;

  /// @throws std::invalid_argument if the plant has no pictures.
  Camera(std::shared_ptr<const sim::GalleryPlant> plant, const Nuisances& nuisances);

  /// Begins an episode: draws its nuisances.
  void Reset(std::uint64_t seed) noexcept;
  /// Writes the picture of an observed state: kSize values from 0 to 255.
  void See(std::span<const double> state, std::span<double> picture) noexcept;

 private:
  std::shared_ptr<const sim::GalleryPlant> plant_;
  Nuisances nuisances_;
  core::Random random_{0};
  double gain_ = 1.0;
  std::array<int, 2> shift_{};    // columns, rows
  std::array<double, 3> disc_{};  // column, row, radius
  sim::Colour colour_{};
  std::array<int, 2> hidden_{};  // first column and row of the occlusion
  std::vector<std::uint8_t> drawn_;
};

/// Returns true if the states of a task's plant can be drawn.
[[nodiscard]] bool HasPictures(const sim::GalleryPlant& plant);

/// Layout of the states of a guard on pictures: "image".
[[nodiscard]] core::StateLayout PictureLayout();

/// Returns the demonstrations with pictures as states. Their seeds determine the nuisances.
[[nodiscard]] std::vector<core::Trajectory> Pictures(
    const sim::GalleryTask& task, std::span<const core::Trajectory> demonstrations,
    const Nuisances& nuisances);

}  // namespace dfr::study
