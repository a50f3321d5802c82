#pragma once

#include <filesystem>
#include <memory>
#include <utility>

#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/safety/task_model.h"
#include "dfr/study/controller_factory.h"
#include "dfr/study/fitted_task.h"

namespace dfr::study {

/// Models learned from one set of demonstrations: the policy and the task model.
class LearnedModel {
 public:
  /// Without `teaching`, methods that train new policies are rejected.
  LearnedModel(imitation::MlpPolicy policy, FittedTask fit, imitation::DemonstrationSet set,
               Expert teaching = {});

  /// Writes policy.dfr, demonstrations.hdf5 and the task's files into `folder`; creates it if
  /// needed. @throws std::invalid_argument for a guard's model, which has a separate file.
  void Save(const std::filesystem::path& folder) const;
  /// Reads the files of Save(). @throws std::runtime_error naming the file and its defect.
  static LearnedModel Load(const std::filesystem::path& folder);

  [[nodiscard]] const imitation::MlpPolicy& policy() const noexcept { return parts_->policy; }
  [[nodiscard]] const safety::TaskModel& task() const noexcept { return parts_->fit.model(); }
  [[nodiscard]] const FittedTask& fit() const noexcept { return parts_->fit; }
  [[nodiscard]] const imitation::DemonstrationSet& demonstrations() const noexcept {
    return parts_->set;
  }
  /// Returns the controllers, which borrow this model.
  [[nodiscard]] const ControllerFactory& controllers() const noexcept {
    return parts_->controllers;
  }

 private:
  struct Parts {
    Parts(imitation::MlpPolicy p, FittedTask f, imitation::DemonstrationSet s, Expert teaching)
        : policy(std::move(p)),
          fit(std::move(f)),
          set(std::move(s)),
          controllers(fit, policy, set.layout, set.trajectories, std::move(teaching)) {}
    imitation::MlpPolicy policy;
    FittedTask fit;
    imitation::DemonstrationSet set;
    ControllerFactory controllers;
  };
  // On the heap: pointers to the parts stay valid when the model moves.
  std::unique_ptr<const Parts> parts_;
};

}  // namespace dfr::study
