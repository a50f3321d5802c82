#include <algorithm>
#include <cmath>
#include <utility>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim {

GalleryPlant::GalleryPlant(std::vector<core::StateLayout::Block> blocks, int hidden,
                           int control_dim) {
  for (core::StateLayout::Block& block : blocks) layout_.Add(std::move(block.name), block.size);
  state_.resize(static_cast<std::size_t>(layout_.state_dim() + hidden));
  control_.resize(static_cast<std::size_t>(control_dim));
}

void GalleryPlant::Reset(std::uint64_t seed) {
  core::Random random(seed);
  std::fill(state_.begin(), state_.end(), 0.0);
  failed_ = false;
  Start(random);
  completed_ = Done();
}

core::PlantStatus GalleryPlant::Apply(std::span<const double> control) noexcept {
  if (control.size() != control_.size() ||
      !std::all_of(control.begin(), control.end(), [](double u) { return std::isfinite(u); })) {
    return core::PlantStatus::kRefused;
  }
  std::transform(control.begin(), control.end(), control_.begin(),
                 [](double u) { return std::clamp(u, -1.0, 1.0); });
  Step(control_);
  completed_ = Done();
  return core::PlantStatus::kOk;
}

void GalleryPlant::Observe(std::span<double> state) const noexcept {
  std::copy_n(state_.begin(), layout_.state_dim(), state.begin());
}

void GalleryPlant::CopyStateFrom(const core::SimulatedPlant& other) noexcept {
  const auto& from = static_cast<const GalleryPlant&>(other);
  std::copy(from.state_.begin(), from.state_.end(), state_.begin());
  failed_ = from.failed_;
  completed_ = from.completed_;
}

}  // namespace dfr::sim
