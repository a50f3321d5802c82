#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/sim/gallery/gallery.h"
#include "dfr/study/baselines.h"
#include "dfr/study/fitted_task.h"
#include "dfr/study/online_lwr.h"

namespace dfr::study {

/// Returns "good", "weak", "biased" and study::kPolicies.
[[nodiscard]] const std::vector<std::string>& PolicyNames();

/// The task's supervisor, for policies that query it while they learn.
[[nodiscard]] Expert SupervisorOf(const sim::GalleryTask& task);

/// A policy for one episode at a time. A delayed policy stores its previous controls. Never
/// allocates after construction.
class Imitator {
 public:
  Imitator(std::shared_ptr<const core::Policy> learned, const sim::PolicyBias& bias);
  /// Wraps a policy that learns from the applied controls.
  explicit Imitator(std::shared_ptr<OnlineLwrPolicy> online);
  /// Begins an episode; the seed determines the size of the bias.
  void Reset(std::uint64_t seed) noexcept;
  /// Same as core::Policy::Control(). Entries of `u` are within +-1.
  void Control(int t, std::span<const double> x, std::span<double> u) noexcept;
  /// Reports that `u` is applied in the state of the last Control().
  void Applied(std::span<const double> u) noexcept {
    if (online_ != nullptr) online_->Applied(u);
  }

 private:
  std::shared_ptr<const core::Policy> learned_;
  std::shared_ptr<OnlineLwrPolicy> online_;  // null: the policy does not learn
  sim::PolicyBias bias_;
  double share_ = 0.0;
  std::size_t late_ = 0;        // number of used entries of wanted_
  std::vector<double> wanted_;  // previous controls, oldest first
};

/// Learns policy `name` from `demonstrations` of `task`: by behaviour cloning "good", "weak" (few
/// units and epochs) or "biased" (the good policy with the task's bias); or one of
/// study::kPolicies, with the good policy as the learned policy. `fit` was made from these
/// demonstrations. `plant` is the controlled plant, for the adversaries only. Borrows everything
/// except the seed.
/// @throws std::invalid_argument listing the valid policies.
[[nodiscard]] Imitator Imitate(const sim::GalleryTask& task,
                               std::span<const core::Trajectory> demonstrations,
                               const FittedTask& fit, const core::SimulatedPlant& plant,
                               const std::string& name, std::uint64_t seed);

}  // namespace dfr::study
