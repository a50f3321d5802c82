#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/feature_transform.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/sim/gallery/gallery.h"

namespace dfr::apps::gallery {

/// "good", "weak", "biased", "lwr", "knn".
[[nodiscard]] const std::vector<std::string>& PolicyNames();

/// A policy of one episode at a time: a late one remembers what it wanted before. Never allocates
/// once made.
class Imitator {
 public:
  Imitator(std::shared_ptr<const core::Policy> learned, const sim::Flaw& flaw);
  /// Begins an episode; the seed decides how large the flaw is.
  void Reset(std::uint64_t seed) noexcept;
  /// As core::Policy::Control(); entries of `u` lie within +-1.
  void Control(int t, std::span<const double> x, std::span<double> u) noexcept;

 private:
  std::shared_ptr<const core::Policy> learned_;
  sim::Flaw flaw_;
  double share_ = 0.0;
  std::size_t late_ = 0;        // entries of wanted_ that are in use
  std::vector<double> wanted_;  // the last controls, oldest first
};

/// Imitates `demonstrations` of `task` by behaviour cloning as well as `name` says: "good",
/// "weak" (few units and epochs) or "biased" (the good one with the task's flaw); "lwr" and "knn"
/// are apps::kPolicies' regressions in `features`.
/// @throws std::invalid_argument naming the policies there are.
[[nodiscard]] Imitator Imitate(const sim::GalleryTask& task,
                               std::span<const core::Trajectory> demonstrations,
                               const core::FeatureTransform& features, const std::string& name,
                               std::uint64_t seed);

}  // namespace dfr::apps::gallery
