#pragma once

#include <span>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/rotations.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/action_space.h"
#include "fit_task.h"

namespace dfr::safety::internal {

/// The rotations in these states that `features` look at.
std::vector<core::Rotation> Rotations(const core::FeatureSelection& features,
                                      const core::StateLayout& layout,
                                      std::span<const core::Trajectory> demonstrations);
/// The features with the map that makes these continuous where one does.
core::FeatureSelection Continuous(const core::FeatureSelection& features,
                                  const core::StateLayout& layout,
                                  std::span<const core::Trajectory> demonstrations);
/// Entries of a state among `features` that passed entries of an action move and steered ones do
/// not, such as the opening of a gripper: a guard can neither predict nor correct them. Empty if
/// that holds for all features.
std::vector<int> MovedByPassed(const core::FeatureSelection& features, const ActionSpace& actions,
                               std::span<const core::Trajectory> demonstrations);
/// The features but for these entries.
core::FeatureSelection Without(const core::FeatureSelection& features,
                               const core::StateLayout& layout, std::span<const int> entries);
/// The demonstrations with mapped states.
std::vector<core::Trajectory> Mapped(const core::StateMap& map,
                                     std::span<const core::Trajectory> demonstrations);

/// @throws std::invalid_argument if next to no state of left-out demonstrations is inside. The
///   message names features that would do better: parts of the state, and entries that the others
///   follow from.
void RefuseUnlessInside(const core::StateLayout& layout, const Recorded& recorded,
                        const GuardFit& fit, const ActionSpace& actions, int folds);

}  // namespace dfr::safety::internal
