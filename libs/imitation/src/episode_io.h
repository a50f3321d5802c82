#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "hdf5_file.h"

namespace dfr::imitation::internal {

/// What both formats of demonstrations share.

/// @throws std::invalid_argument unless the trajectory has these dimensions, finite states and
///   controls within [-1, 1]; the message names `episode`, step and entry.
void CheckTrajectory(const core::Trajectory& trajectory, int state_dim, int control_dim,
                     int episode);

/// @throws std::invalid_argument unless every block's name can name a dataset.
void CheckLayout(const core::StateLayout& layout, int control_dim);

/// The outcome that core::Name() gives this name, if any.
[[nodiscard]] std::optional<core::Outcome> ParseOutcome(std::string_view name);

/// Members of `group` that are named <prefix><number>, as paths in the order of the numbers.
/// Others are refused.
[[nodiscard]] std::vector<std::string> NumberedMembers(const Hdf5File& file,
                                                       const std::string& group,
                                                       std::string_view prefix);

/// A dataset of finite numbers with this many rows; `count` says in messages where that is from.
[[nodiscard]] core::Matrix ReadRows(const Hdf5File& file, const std::string& path,
                                    Eigen::Index rows, const char* count);

/// The vector-valued datasets of a group, groups below it included ("goal/position"), by their
/// attributes `offset` where all have one, else by name. Those of more than two dimensions (images)
/// are left out.
[[nodiscard]] core::StateLayout ReadLayout(const Hdf5File& file, const std::string& group);

/// The datasets of a layout side by side.
[[nodiscard]] core::Matrix ReadBlocks(const Hdf5File& file, const std::string& group,
                                      const core::StateLayout& layout, Eigen::Index rows,
                                      const char* count);

}  // namespace dfr::imitation::internal
