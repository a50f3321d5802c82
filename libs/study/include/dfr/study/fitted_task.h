#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/control/guided/response.h"
#include "dfr/core/features.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/task_model.h"

namespace dfr::study {

/// A task's model and the units of controls in which guided recovery uses it: those of the guard it
/// belongs to, with a unit and a limit per entry, or one unit for all entries. Immutable, and cheap
/// to copy.
class FittedTask {
 public:
  /// A program's own fit. All entries of a control share one unit: metres, or radians.
  FittedTask(safety::TaskModel model);  // NOLINT(google-explicit-constructor)
  /// A guard's fit, as Fit() returns it. @throws std::invalid_argument if it reduces states.
  explicit FittedTask(std::shared_ptr<const safety::GuardModel> guard);
  /// Fits a guard with default settings, also one with warnings. Entries of a control may have
  /// different units. @throws std::invalid_argument as safety::GuardModel::Fit() does.
  static FittedTask Fit(const core::StateLayout& layout,
                        std::span<const core::Trajectory> demonstrations,
                        const std::string& features);

  [[nodiscard]] const safety::TaskModel& model() const noexcept { return *model_; }
  /// Null for a program's own fit.
  [[nodiscard]] const std::shared_ptr<const safety::GuardModel>& guard() const noexcept {
    return guard_;
  }

  /// T: time steps of the learned policy in an episode.
  [[nodiscard]] int horizon() const noexcept {
    return guard_ != nullptr ? guard_->settings().horizon : model_->horizon();
  }
  /// The demonstrations with controls in the model's units.
  [[nodiscard]] std::vector<core::Trajectory> Measured(
      std::span<const core::Trajectory> demonstrations) const;
  /// Response of these demonstrations' features to controls as they are recorded.
  [[nodiscard]] control::Response ResponseOf(
      std::span<const core::Trajectory> demonstrations) const;
  /// Distance of two controls, in ordinary demonstrated controls.
  [[nodiscard]] double Distance(std::span<const double> u,
                                std::span<const double> other) const noexcept;
  /// Multiplies a direction of length 1 so that its size is that of the largest demonstrated
  /// control.
  void Enlarge(std::span<double> direction) const noexcept;

  /// As TaskModel::MakeController(), for controls as they are recorded. Borrows this object's model
  /// and `policy`. @throws std::invalid_argument as that does.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const safety::Method& method, const core::Policy& policy,
      const safety::ControllerOptions& options = {}) const;
  /// Makes a controller around a policy whose controls are in the model's units, with these limits.
  using Maker = std::function<std::unique_ptr<control::Controller>(const core::Policy&,
                                                                   std::vector<double> limit)>;
  /// A controller for controls as they are recorded, from one in the model's units. Entries that a
  /// guard does not steer pass. A limit is the smaller of the guard's and that of `limit`, which
  /// has one for each entry or one for all.
  [[nodiscard]] std::unique_ptr<control::Controller> InUnits(const core::Policy& policy,
                                                             const std::vector<double>& limit,
                                                             const Maker& make) const;

 private:
  std::shared_ptr<const safety::GuardModel> guard_;
  std::shared_ptr<const safety::TaskModel> model_;
};

}  // namespace dfr::study
