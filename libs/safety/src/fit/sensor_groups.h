#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/core/trajectory.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety::internal {

/// Returns true if an entry follows the clock: it varies between time steps, but barely between
/// demonstrations at the same time step.
bool FollowsClock(std::span<const core::Trajectory> demonstrations, Eigen::Index entry);

/// Returns true if a linear function of the actions explains an entry's changes almost entirely.
bool MovedByActions(std::span<const core::Trajectory> demonstrations, Eigen::Index entry);

/// Returns true if an entry advances uniformly, at one rate or over one distance, for any actions.
bool AdvancesUniformly(std::span<const core::Trajectory> demonstrations, Eigen::Index entry);

/// Returns the groups of entries that the model uses, with their longest demonstrated standstill.
/// @param demonstrations  with whole states.
std::vector<SensorGroup> FitSensorGroups(const GuardModel& model,
                                         std::span<const core::Trajectory> demonstrations);

}  // namespace dfr::safety::internal
