#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/trajectory.h"
#include "dfr/sim/gallery/gallery.h"

namespace dfr::study::planar {

/// A planar task with its supervisor and its learner.
struct Task {
  std::string name;
  std::shared_ptr<const sim::GalleryPlant>
      plant;  ///< Prototype of the plant, to be cloned; includes the supervisor.
  double supervisor_noise = 0.0;  ///< Standard deviation of the noise on each control entry.
  int degree = 1;                 ///< Degree of the learner's polynomial.
  int horizon = 100;
  double raw_gamma = 1.0;  ///< Gamma of the paper's support, in the units of the state.
};

/// Returns the task "corridor", "push" (a learner that imitates well) or "push-weak".
/// @throws std::invalid_argument listing the valid tasks.
[[nodiscard]] Task MakeTask(std::string_view name);
[[nodiscard]] const std::vector<std::string>& TaskNames();

/// Returns `count` demonstrations that complete the task without violating a constraint.
[[nodiscard]] std::vector<core::Trajectory> Demonstrate(const Task& task, int count,
                                                        std::uint64_t seed);

}  // namespace dfr::study::planar
