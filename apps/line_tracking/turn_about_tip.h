#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "dfr/kinematics/psm.h"

namespace dfr::apps::line_tracking {

/// How far from the straight way the jaw tips may come, m.
inline constexpr double kMostAstray = 3e-4;

/// The way from `from` to `to` on which the jaw tips go straight from where they are to where they
/// end, which may be the same place, while the tool turns: joint values to move to one after the
/// other, the last one `to`. In one move through joint space the tips would swing by millimetres.
/// Nothing if the arm cannot hold the tool so somewhere on the way. @pre both finite
[[nodiscard]] std::optional<std::vector<kinematics::PsmJoints>> TurnAboutTip(
    const kinematics::PsmJoints& from, const kinematics::PsmJoints& to,
    kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic);

/// The joints that hold the tool as `joints` do, with its tips moved by `step_m` (the arm's base
/// frame). Nothing if the arm cannot.
[[nodiscard]] std::optional<kinematics::PsmJoints> Displaced(
    const kinematics::PsmJoints& joints, const Eigen::Vector3d& step_m,
    kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic);

}  // namespace dfr::apps::line_tracking
