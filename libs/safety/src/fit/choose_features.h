#pragma once

#include <span>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/features/rotations.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/action_space.h"
#include "fit/fit_task.h"

namespace dfr::safety::internal {

/// Returns the rotations in the states of `demonstrations` that `features` use.
std::vector<core::Rotation> Rotations(const core::FeatureSelection& features,
                                      const core::StateLayout& layout,
                                      std::span<const core::Trajectory> demonstrations);
/// Returns the features with a map that makes their rotations continuous, if they have any.
core::FeatureSelection Continuous(const core::FeatureSelection& features,
                                  const core::StateLayout& layout,
                                  std::span<const core::Trajectory> demonstrations);
/// Returns the entries among `features`, such as the opening of a gripper, that depend on unsteered
/// entries of an action but not on steered ones. A guard can neither predict nor correct them.
/// Empty if all features are of this kind. Samples the demonstrations WithoutJumps() in this order.
std::vector<int> MovedByPassed(const core::FeatureSelection& features, const ActionSpace& actions,
                               std::span<const core::Trajectory> demonstrations,
                               std::span<const std::size_t> order);

/// Returns the map from a state to the context on which controls depend in addition to features:
/// `entries`, made continuous, in units of fit::kContextUnit times their demonstrated range.
core::FeatureTransform Context(const core::StateLayout& layout, const std::vector<int>& entries,
                               std::span<const core::Trajectory> demonstrations);
/// Returns the entries among `features` that are constant up to rounding; none if all are constant.
std::vector<int> ConstantEntries(const core::FeatureSelection& features,
                                 std::span<const core::Trajectory> demonstrations);
/// Returns copies of the demonstrations without the constant entries of their states; empty if no
/// entry is constant. The order of the copies by content does not depend on constant entries.
std::vector<core::Trajectory> WithoutConstants(std::span<const core::Trajectory> demonstrations);
/// Returns copies of the demonstrations in which angles and quaternions do not jump between states
/// (core::RemoveJumps()), for analyses of changes.
std::vector<core::Trajectory> WithoutJumps(const core::StateLayout& layout,
                                           std::span<const core::Trajectory> demonstrations);
/// Lists entries for a message, at most eight by name.
std::string Names(const core::StateLayout& layout, std::span<const int> entries);
/// Returns these entries as features.
core::FeatureSelection Only(const core::StateLayout& layout, const std::vector<int>& entries);
/// Returns the features without these entries, in the same order.
core::FeatureSelection Without(const core::FeatureSelection& features,
                               const core::StateLayout& layout, std::span<const int> entries);
/// Returns the demonstrations with mapped states.
std::vector<core::Trajectory> Mapped(const core::StateMap& map,
                                     std::span<const core::Trajectory> demonstrations);

/// @throws std::invalid_argument if almost no state of left-out demonstrations is inside. The
/// message names better features: parts of the state, and entries that determine the others.
/// @returns false if a callback stopped the check.
bool RefuseUnlessInside(const core::StateLayout& layout, const Recorded& recorded,
                        const GuardFit& fit, const ActionSpace& actions, int folds,
                        const StageCallback& going_on);

}  // namespace dfr::safety::internal
