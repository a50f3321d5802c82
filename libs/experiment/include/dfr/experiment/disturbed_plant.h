#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/core/random.h"

namespace dfr::experiment {

/// What DisturbedPlant does to a plant. All zero: nothing.
struct DisturbanceOptions {
  double rotation_sd = 0.0;     ///< rad: controls are turned by a normal angle, drawn per episode.
  double scale_sd = 0.0;        ///< Controls are scaled by exp(normal), drawn per episode.
  double bias = 0.0;            ///< Norm of a vector added to every control, drawn per episode.
  double actuator_noise = 0.0;  ///< Standard deviation of each control entry, at every control.
  /// Standard deviation of each state entry as observed; drawn anew at every control.
  double observation_noise = 0.0;
  int control_delay = 0;      ///< Controls come so many steps late; zeros come first.
  double dropped = 0.0;       ///< Probability that a control is lost: zero is applied instead.
  int observation_delay = 0;  ///< States are seen so many controls late.
  double missing = 0.0;       ///< Probability that a state is lost: the one before is seen again.

  bool operator==(const DisturbanceOptions&) const = default;
};

/// A plant that differs from the one that was demonstrated on: control turned, scaled, biased,
/// noisy, late or lost, observations noisy, late or lost. For studies of how methods degrade.
///
/// Controls of more than two entries are turned in a random plane. Collisions and completion are
/// those of the plant itself.
class DisturbedPlant final : public core::SimulatedPlant {
 public:
  /// @throws std::invalid_argument if an option is negative or not finite, or a probability > 1.
  DisturbedPlant(std::unique_ptr<core::SimulatedPlant> plant, const DisturbanceOptions& options);

  [[nodiscard]] const core::StateLayout& layout() const noexcept override {
    return plant_->layout();
  }
  [[nodiscard]] int control_dim() const noexcept override { return plant_->control_dim(); }
  /// The plant itself.
  [[nodiscard]] core::SimulatedPlant& undisturbed() noexcept { return *plant_; }
  void Reset(std::uint64_t seed) override;
  [[nodiscard]] core::PlantStatus Apply(std::span<const double> control) noexcept override;
  void Observe(std::span<double> state) const noexcept override;
  [[nodiscard]] bool completed() const noexcept override { return plant_->completed(); }
  [[nodiscard]] bool collided() const noexcept override { return plant_->collided(); }
  void Halt() noexcept override { plant_->Halt(); }
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const override;
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override;

 private:
  void DrawNoise() noexcept;
  void See() noexcept;

  std::unique_ptr<core::SimulatedPlant> plant_;
  DisturbanceOptions options_;
  core::Random random_{0};
  double cosine_ = 1.0;
  double sine_ = 0.0;
  double scale_ = 1.0;
  std::vector<double> first_;  ///< Orthonormal vectors that span the plane of rotation.
  std::vector<double> second_;
  std::vector<double> bias_;
  std::vector<double> noise_;
  std::vector<double> asked_;
  std::vector<double> control_;
  std::vector<double> given_;     ///< Controls that are under way, oldest first.
  std::vector<double> happened_;  ///< The last states, oldest first.
  std::vector<double> seen_;      ///< What Observe() says, without noise.
};

}  // namespace dfr::experiment
