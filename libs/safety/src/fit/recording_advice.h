#pragma once

#include <span>
#include <string>

#include "dfr/core/trajectory.h"
#include "dfr/safety/guard_model.h"

// Advice on recordings, for FitWarnings(). Each function returns "" if it finds nothing.
namespace dfr::safety::internal {

// Describes demonstrations that repeat another one: cross-validation leaves one out, and its copy
// remains.
std::string DescribeCopies(std::span<const core::Trajectory> demonstrations);

// Describes robots that rest under ordinary actions, as an arm against gravity does if actions are
// torques. A rest lasts five steps or more: a shorter one may be a delay. Entries of the state that
// advance uniformly without the robot, like a clock, do not count.
std::string DescribeRest(const GuardModel& model, std::span<const core::Trajectory> demonstrations);

// Describes the delay between actions and their effect. There is a delay if an action of another
// step explains more than the recorded action does. Only feature changes that the state does not
// determine count. The action one step later may also react to the change. Only the part that its
// own state does not explain counts, and only if the recorded action does not clearly explain any
// feature better.
std::string DescribeDelay(const GuardModel& model,
                          std::span<const core::Trajectory> demonstrations);

// Describes the entry of the features that changes most suddenly in one demonstration, compared
// with all others.
std::string DescribeJumps(const GuardModel& model,
                          std::span<const core::Trajectory> demonstrations);

// Describes the entry of the actions whose largest value occurs in one demonstration and far
// exceeds the values in all others. Default limits follow from this value.
std::string DescribeLargest(std::span<const core::Trajectory> demonstrations);

// Describes features that differ between demonstrations but hardly change within one, if the guard
// is too narrow for left-out demonstrations. Features relative to a goal help there. Without the
// goal the guard would be wider, but wrong.
std::string DescribeGoals(const GuardModel& model,
                          std::span<const core::Trajectory> demonstrations);

// Describes demonstrations that act oppositely in an entry of an action at the same place and near
// the same time step, because something that is not a feature decides: a gear, a latch. Only sides
// that last count, and only in a demonstration that takes both: a choice between two ways is no
// mode that changes. Opposite actions that a regression on the features explains do not count.
std::string DescribeOpposites(const GuardModel& model,
                              std::span<const core::Trajectory> demonstrations);

}  // namespace dfr::safety::internal
