#include "apps/study/pictures/camera.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::study {

bool HasPictures(const sim::GalleryPlant& plant) {
  std::vector<std::uint8_t> picture(Camera::kSize);
  return plant.Draw(std::vector<double>(static_cast<std::size_t>(plant.state_dim())), picture);
}

Camera::Camera(std::shared_ptr<const sim::GalleryPlant> plant, const Nuisances& nuisances)
    : plant_(std::move(plant)), nuisances_(nuisances), drawn_(kSize) {
  DFR_THROW_UNLESS(HasPictures(*plant_), "the plant has no pictures");
}

void Camera::Reset(std::uint64_t seed) noexcept {
  random_ = core::Random(core::DeriveSeed(seed, {7}));
  gain_ = 1.0 + nuisances_.light * random_.Uniform(-1.0, 1.0);
  constexpr std::array<std::array<int, 2>, 4> kDirections{{{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
  for (std::size_t i = 0; const int step : kDirections[random_.Below(kDirections.size())]) {
    shift_[i++] = nuisances_.shift * step;
  }
  disc_ = {random_.Uniform(0.0, kSide), random_.Uniform(0.0, kSide), random_.Uniform(2.0, 4.0)};
  for (std::uint8_t& channel : colour_) channel = static_cast<std::uint8_t>(random_.Below(256));
  for (int& first : hidden_) first = static_cast<int>(random_.Below(kSide - kSide / 3));
}

void Camera::See(std::span<const double> state, std::span<double> picture) noexcept {
  static_cast<void>(plant_->Draw(state, drawn_));
  if (nuisances_.distractor) {
    sim::Canvas(drawn_, kSide, 0.0, 0.0, kSide).Disc(disc_[0], disc_[1], disc_[2], colour_);
  }
  if (nuisances_.occlusion) {
    constexpr int kHidden = kSide / 3;
    constexpr double kHalf = 0.5 * kHidden;
    sim::Canvas(drawn_, kSide, 0.0, 0.0, kSide)
        .Box(hidden_[0] + kHalf, hidden_[1] + kHalf, kHalf, kHalf, 0.0, {16, 16, 16});
  }
  for (int row = 0; row < kSide; ++row) {
    for (int column = 0; column < kSide; ++column) {
      // The edge pixels continue beyond the picture.
      const int from_row = std::clamp(row - shift_[1], 0, kSide - 1);
      const int from_column = std::clamp(column - shift_[0], 0, kSide - 1);
      const auto from =
          static_cast<std::size_t>(3) * static_cast<std::size_t>(kSide * from_row + from_column);
      const auto to = static_cast<std::size_t>(3) * static_cast<std::size_t>(kSide * row + column);
      for (std::size_t channel = 0; channel < 3; ++channel) {
        double value = gain_ * drawn_[from + channel];
        if (nuisances_.noise > 0.0) value += 255.0 * nuisances_.noise * random_.Normal();
        picture[to + channel] = std::clamp(std::round(value), 0.0, 255.0);
      }
    }
  }
}

core::StateLayout PictureLayout() {
  core::StateLayout layout;
  layout.Add("image", {.height = Camera::kSide, .width = Camera::kSide, .channels = 3});
  return layout;
}

std::vector<core::Trajectory> Pictures(const sim::GalleryTask& task,
                                       std::span<const core::Trajectory> demonstrations,
                                       const Nuisances& nuisances) {
  Camera camera(task.plant, nuisances);
  std::vector<core::Trajectory> seen(demonstrations.begin(), demonstrations.end());
  for (core::Trajectory& demonstration : seen) {
    core::Matrix pictures(demonstration.states.rows(), Camera::kSize);
    camera.Reset(demonstration.seed);
    for (Eigen::Index t = 0; t < pictures.rows(); ++t) {
      camera.See(core::Row(std::as_const(demonstration.states), t), core::Row(pictures, t));
    }
    demonstration.states = std::move(pictures);
  }
  return seen;
}

}  // namespace dfr::study
