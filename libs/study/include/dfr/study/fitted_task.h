#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/control/response/response.h"
#include "dfr/core/features/features.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/task_model.h"

namespace dfr::study {

/// A task's model and the units of its controls in guided recovery. A guard has a unit and a limit
/// per entry; a program's model has one unit for all entries. Immutable, and cheap to copy.
class FittedTask {
 public:
  /// Uses a program's model. All entries of a control share one unit: metres or radians.
  FittedTask(safety::TaskModel model);  // NOLINT(google-explicit-constructor)
  /// Uses a guard's model, as returned by Fit(). @throws std::invalid_argument if it reduces
  /// states.
  explicit FittedTask(std::shared_ptr<const safety::GuardModel> guard);
  /// Fits a guard with default settings, even if the fit has warnings. Entries of a control may
  /// have different units. @throws std::invalid_argument as safety::GuardModel::Fit() does.
  static FittedTask Fit(const core::StateLayout& layout,
                        std::span<const core::Trajectory> demonstrations,
                        const std::string& features);

  [[nodiscard]] const safety::TaskModel& model() const noexcept { return *model_; }
  /// Returns the guard; null for a program's model.
  [[nodiscard]] const std::shared_ptr<const safety::GuardModel>& guard() const noexcept {
    return guard_;
  }

  /// Returns T: the number of time steps of the learned policy in an episode.
  [[nodiscard]] int horizon() const noexcept {
    return guard_ != nullptr ? guard_->settings().horizon : model_->horizon();
  }
  /// Returns the demonstrations with controls in the model's units.
  [[nodiscard]] std::vector<core::Trajectory> Measured(
      std::span<const core::Trajectory> demonstrations) const;
  /// Returns the response of the features to recorded controls: the response of a program's model,
  /// or for a guard's model a response fitted to `demonstrations`.
  [[nodiscard]] control::Response ResponseOf(
      std::span<const core::Trajectory> demonstrations) const;
  /// Returns the distance between two controls, in units of ordinary demonstrated controls.
  [[nodiscard]] double Distance(std::span<const double> u,
                                std::span<const double> other) const noexcept;
  /// Scales a direction of length 1 to the size of the largest demonstrated control.
  void Enlarge(std::span<double> direction) const noexcept;

  /// Same as TaskModel::MakeController(), for controls in recorded units. Borrows this object's
  /// model and `policy`. @throws std::invalid_argument as TaskModel::MakeController().
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const safety::Method& method, const core::Policy& policy,
      const safety::ControllerOptions& options = {}) const;
  /// Creates a controller around a policy whose controls are in the model's units, with these
  /// limits.
  using Maker = std::function<std::unique_ptr<control::Controller>(const core::Policy&,
                                                                   std::vector<double> limit)>;
  /// Returns a controller in recorded units from a controller in the model's units. Entries that a
  /// guard does not steer pass unchanged. Each limit is the smaller of the guard's limit and the
  /// value in `limit`, which has one value per entry or one for all.
  [[nodiscard]] std::unique_ptr<control::Controller> InUnits(const core::Policy& policy,
                                                             const std::vector<double>& limit,
                                                             const Maker& make) const;

 private:
  std::shared_ptr<const safety::GuardModel> guard_;
  std::shared_ptr<const safety::TaskModel> model_;
};

}  // namespace dfr::study
