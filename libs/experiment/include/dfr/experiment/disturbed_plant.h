#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/core/random.h"

namespace dfr::experiment {

/// Disturbances of a DisturbedPlant. All zero: no disturbance.
struct DisturbanceOptions {
  /// Standard deviation, rad, of the angle by which the controls of an episode are rotated.
  double rotation_sd = 0.0;
  double scale_sd = 0.0;        ///< Standard deviation of log(scale of the controls), per episode.
  double bias = 0.0;            ///< Norm of a random vector added to all controls of an episode.
  double actuator_noise = 0.0;  ///< Standard deviation of the noise in each control entry.
  /// Standard deviation of the noise in each entry of an observed state.
  double observation_noise = 0.0;
  int control_delay = 0;      ///< Delay of a control, in controls; the plant first receives zeros.
  double dropped = 0.0;       ///< Probability that a control is lost and replaced by zero.
  int observation_delay = 0;  ///< Delay of observed states, in controls.
  double missing = 0.0;  ///< Probability that a state is lost and replaced by the previous one.

  bool operator==(const DisturbanceOptions&) const = default;
};

/// A plant that differs from the demonstrated one: controls are rotated, scaled, biased, noisy,
/// late or lost; observations are noisy, late or lost. Used to study the degradation of methods.
///
/// Controls of more than two entries are rotated in a random plane. The underlying plant determines
/// collisions and completion.
class DisturbedPlant final : public core::SimulatedPlant {
 public:
  /// @throws std::invalid_argument if an option is negative or not finite, or a probability > 1.
  DisturbedPlant(std::unique_ptr<core::SimulatedPlant> plant, const DisturbanceOptions& options);

  [[nodiscard]] const core::StateLayout& layout() const noexcept override {
    return plant_->layout();
  }
  [[nodiscard]] int control_dim() const noexcept override { return plant_->control_dim(); }
  /// Returns the underlying plant.
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
  std::vector<double> first_;  ///< Orthonormal basis of the rotation plane.
  std::vector<double> second_;
  std::vector<double> bias_;
  std::vector<double> noise_;
  std::vector<double> asked_;
  std::vector<double> control_;
  std::vector<double> given_;     ///< Pending controls, oldest first.
  std::vector<double> happened_;  ///< The last states, oldest first.
  std::vector<double> seen_;      ///< Observation without noise.
};

}  // namespace dfr::experiment
