#pragma once

#include <span>

#include "dfr/control/response/response.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// A constant of a certificate, estimated from demonstrations.
///
/// Each demonstration with a control gives one independent sample: the largest ratio over its
/// transitions. `demonstrations` is the number of samples, and `value` the largest one. With
/// `confidence`, a fraction of at least `coverage` = (1 - confidence)^(1/demonstrations) of further
/// demonstrations never exceeds `value` (the distribution-free tolerance bound of Wilks). The bound
/// is exact for demonstrations to which neither features nor J were fitted. Otherwise it is
/// approximate; docs/certificates.md has measurements. It does not cover controls that no
/// demonstration would contain: use a safety factor for such controls. Controllers check the
/// assumption at run time.
struct EstimatedConstant {
  double value = 0.0;
  double confidence = 0.95;
  double coverage = 0.0;
  int demonstrations = 0;
};

/// Estimates K in |dz| <= K |u| over demonstrated transitions with u != 0.
/// @throws std::invalid_argument if no control changes a feature or confidence is not in (0, 1).
[[nodiscard]] EstimatedConstant EstimateGain(const FeatureTrajectories& demonstrations,
                                             double confidence = 0.95);

/// Estimates eps in |dz - J u| <= eps |u| with the J that guided recovery computes at each step.
/// Predicts each demonstration from the demonstrations of the other `folds`, in the given order,
/// and from its own past. The J of a fold therefore differs from the J of all demonstrations, and
/// the bound is approximate.
/// @throws std::invalid_argument as EstimateGain() does, and for fewer than two demonstrations.
[[nodiscard]] EstimatedConstant EstimateDirectionError(const FeatureTrajectories& demonstrations,
                                                       const core::Folds& folds,
                                                       const ResponseOptions& options = {},
                                                       double confidence = 0.95);

/// Overload with at most five core::StratifiedFolds(). The result does not depend on the order of
/// the demonstrations.
[[nodiscard]] EstimatedConstant EstimateDirectionError(
    const core::FeatureTransform& features, std::span<const core::Trajectory> demonstrations,
    const ResponseOptions& options = {}, double confidence = 0.95);

/// Overload with the J of `response`, which must not have been fitted to `held_out`: the bound is
/// then exact. @throws std::invalid_argument as EstimateGain() does.
[[nodiscard]] EstimatedConstant EstimateDirectionError(const Response& response,
                                                       const FeatureTrajectories& held_out,
                                                       double confidence = 0.95);

/// Returns the largest |dz| over demonstrated transitions with u = 0. The assumption implies 0.
[[nodiscard]] double LargestChangeAtRest(const FeatureTrajectories& demonstrations);

}  // namespace dfr::control
