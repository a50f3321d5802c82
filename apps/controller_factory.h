#pragma once

#include <array>
#include <memory>
#include <span>
#include <string_view>

#include "dfr/core/plant.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/locally_weighted_policy.h"
#include "dfr/safety/task_model.h"

namespace dfr::apps {

/// The methods besides those of safety::ParseMethod() that every program has: the finite-difference
/// oracle of Sec. V-A, which tries controls on a copy of the simulation, and the demonstrations'
/// own locally weighted regression, without any support.
inline constexpr std::array<std::string_view, 2> kOtherMethods = {"finite-difference", "lwr"};

/// safety::ParseMethod() with these.
[[nodiscard]] inline safety::Method ParseMethod(std::string_view name) {
  return safety::ParseMethod(name, kOtherMethods);
}

/// Makes the controllers of one task by the names of their methods.
class ControllerFactory {
 public:
  /// Borrows all, which must outlive this and its controllers.
  ControllerFactory(const safety::TaskModel& task, const core::Policy& policy,
                    std::span<const core::Trajectory> demonstrations)
      : task_(&task), policy_(&policy), lwr_(task.guided().features(), demonstrations) {}

  /// `plant` is the one that is driven, for the oracle only.
  /// @throws std::invalid_argument naming an unknown method and those there are, or if the oracle
  ///   lacks its plant.
  [[nodiscard]] std::unique_ptr<control::Controller> Make(
      std::string_view method, const core::SimulatedPlant* plant,
      const safety::ControllerOptions& options = {}) const;

 private:
  const safety::TaskModel* task_;
  const core::Policy* policy_;
  imitation::LocallyWeightedPolicy lwr_;
};

}  // namespace dfr::apps
