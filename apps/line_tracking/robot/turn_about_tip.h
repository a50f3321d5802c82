#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "dfr/kinematics/psm.h"

namespace dfr::apps::line_tracking {

/// Maximum deviation of the jaw tips from a straight line, m.
inline constexpr double kMostAstray = 3e-4;

/// Returns a path from `from` to `to` as successive joint values, ending with `to`. The tool turns
/// while the jaw tips move straight between their positions, which may coincide. In a single move
/// through joint space the tips would swing by millimetres. Empty if the arm cannot follow this
/// path. @pre both finite
[[nodiscard]] std::optional<std::vector<kinematics::PsmJoints>> TurnAboutTip(
    const kinematics::PsmJoints& from, const kinematics::PsmJoints& to,
    kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic);

/// Returns joint values with the tool orientation of `joints` and the tips moved by `step_m` (in
/// the arm's base frame). Empty if the arm cannot reach them.
[[nodiscard]] std::optional<kinematics::PsmJoints> Displaced(
    const kinematics::PsmJoints& joints, const Eigen::Vector3d& step_m,
    kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic);

}  // namespace dfr::apps::line_tracking
