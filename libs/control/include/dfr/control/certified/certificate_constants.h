#pragma once

#include <span>

#include "dfr/control/guided/response.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/folds.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// A constant of a certificate as demonstrations tell it.
///
/// The largest ratio of each demonstration is one independent sample; `value` is the largest of
/// all. With `confidence`, a share of at least `coverage` = (1 - confidence)^(1/demonstrations) of
/// further demonstrations stays below it throughout (the distribution-free tolerance bound of
/// Wilks). That holds for demonstrations that neither features nor J were fitted to. Otherwise the
/// samples are not of what is used in the end, and the promise holds
/// approximately; docs/certificates.md has measurements. It says nothing of controls that no
/// demonstration would have made: a factor on top, and the watch that controllers keep at run time,
/// are for those.
struct EstimatedConstant {
  double value = 0.0;
  double confidence = 0.95;
  double coverage = 0.0;
  int demonstrations = 0;
};

/// K of |dz| <= K |u|, over demonstrated transitions with u != 0.
/// @throws std::invalid_argument if there is none, or confidence is not in (0, 1).
[[nodiscard]] EstimatedConstant EstimateGain(const FeatureTrajectories& demonstrations,
                                             double confidence = 0.95);

/// eps of |dz - J u| <= eps |u|, with the J that guided recovery has at that moment. Each of
/// `folds` is predicted from the others, in the order in which demonstrations are given, and its
/// own past, so that the J of each is not the one of all: the promise holds approximately.
/// @throws std::invalid_argument as EstimateGain(), and if there are fewer than two demonstrations.
[[nodiscard]] EstimatedConstant EstimateDirectionError(const FeatureTrajectories& demonstrations,
                                                       const core::Folds& folds,
                                                       const ResponseOptions& options = {},
                                                       double confidence = 0.95);

/// The same in fifths of the demonstrations (core::StratifiedFolds()). Their order changes no bit.
[[nodiscard]] EstimatedConstant EstimateDirectionError(
    const core::FeatureTransform& features, std::span<const core::Trajectory> demonstrations,
    const ResponseOptions& options = {}, double confidence = 0.95);

/// The same with the J of a response, on demonstrations that it was not fitted to: the promise
/// holds. @throws std::invalid_argument as EstimateGain().
[[nodiscard]] EstimatedConstant EstimateDirectionError(const Response& response,
                                                       const FeatureTrajectories& held_out,
                                                       double confidence = 0.95);

}  // namespace dfr::control
