#pragma once

#include <array>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/features/feature_transform.h"
#include "dfr/core/plant.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/locally_weighted_policy.h"
#include "dfr/study/baselines.h"
#include "dfr/study/fitted_task.h"
#include "dfr/study/shared_cache.h"

namespace dfr::study {

/// Nearest-neighbour regression on the demonstrations: the mean control of the demonstrated states
/// with the nearest features, among nearby time steps.
class NearestNeighbourPolicy final : public core::Policy {
 public:
  static constexpr int kNeighbours = 5;
  static constexpr int kWindow = 5;  ///< Uses time steps t - kWindow ... t + kWindow.
  static constexpr int kMostFeatures = 64;

  /// @throws std::invalid_argument if there are fewer than kNeighbours demonstrated controls or
  ///   more than kMostFeatures features.
  NearestNeighbourPolicy(core::FeatureTransform features,
                         std::span<const core::Trajectory> demonstrations);
  [[nodiscard]] int state_dim() const noexcept override { return features_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override {
    return static_cast<int>(controls_.cols());
  }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

 private:
  core::FeatureTransform features_;
  std::vector<int> begin_;  // entry t: first row of time step t; last entry: number of rows
  core::Matrix points_;
  core::Matrix controls_;
};

/// Policies for controllers, in addition to the learned one:
///   "lwr", "knn"      regression on the demonstrations themselves, locally weighted or by nearest
///                     neighbours
///   "lwr-cv"          "lwr" with imitation::CrossValidatedWidth()
///   "lwr-online"      OnlineLwrPolicy, which learns from the applied controls
///   "none"            no policy: the control is zero
///   "random"          a direction set by state and time step, of the largest demonstrated size
///   "negated"         the learned policy's control with opposite sign
///   "ensemble"        EnsemblePolicy: the mean of five policies
///   "dart"            TrainDart(): from demonstrations with injected noise
///   "dagger"          TrainDagger(): queries the supervisor, in ten rounds
///   "at-constraints"  an adversary: tries directions on a copy of the plant, and takes one that
///                     collides soonest; if none collides, the learned policy's control
///   "out-of-support"  an adversary: takes the tried direction with the smallest l
inline constexpr std::array<std::string_view, 12> kPolicies = {
    "lwr",     "lwr-cv",   "lwr-online", "knn",    "none",           "random",
    "negated", "ensemble", "dart",       "dagger", "at-constraints", "out-of-support"};
inline constexpr std::string_view kOnlineLwr = "lwr-online";

/// Returns the names, separated by commas.
template <typename Names>
[[nodiscard]] std::string Join(const Names& names) {
  std::string list;
  for (const std::string_view name : names) list.append(list.empty() ? "" : ", ").append(name);
  return list;
}

/// Creates one of "lwr", "lwr-cv", "knn" and "none", which need no learned policy. Returns null for
/// another name.
/// @throws std::invalid_argument as imitation::LocallyWeightedPolicy and NearestNeighbourPolicy do.
[[nodiscard]] std::shared_ptr<const core::Policy> MakeUnlearned(
    std::string_view name, const core::FeatureTransform& features,
    std::span<const core::Trajectory> demonstrations);

/// Creates the policies of kPolicies, except kOnlineLwr, for one task. Borrows all but `teaching`.
class PolicyFactory {
 public:
  PolicyFactory(const FittedTask& task, const core::Policy& learned,
                std::span<const core::Trajectory> demonstrations, Expert teaching = {})
      : task_(&task),
        learned_(&learned),
        demonstrations_(demonstrations),
        teaching_(std::move(teaching)) {}

  /// Creates a policy. `plant` is the driven plant, which only adversaries use. Each adversary
  /// belongs to one thread. Policies that need training are trained once for all threads.
  /// @throws std::invalid_argument naming an unknown policy and listing the valid ones, or if an
  ///   adversary has no plant, or a policy that needs training has no Expert.
  [[nodiscard]] std::shared_ptr<const core::Policy> Make(std::string_view name,
                                                         const core::SimulatedPlant* plant) const;
  /// Returns Make("ensemble"). @throws std::invalid_argument as Make() does.
  [[nodiscard]] std::shared_ptr<const EnsemblePolicy> Ensemble() const;

 private:
  const FittedTask* task_;
  const core::Policy* learned_;
  std::span<const core::Trajectory> demonstrations_;
  Expert teaching_;
  mutable SharedCache<std::string, std::shared_ptr<const core::Policy>> made_;
};

}  // namespace dfr::study
