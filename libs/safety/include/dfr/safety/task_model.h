#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/control/published/recovery_strategy.h"
#include "dfr/control/published/switching_controller.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/features/feature_decision.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/features/features.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/method.h"

namespace dfr::safety {

/// Options for TaskModel.
struct TaskOptions {
  /// Entries of a state that guided recovery's support uses, in the syntax of
  /// core::FeatureSelection; "" for all.
  std::string guided_features = {};
  kernel::WhitenedSupportOptions guided = {};
  core::WhiteningOptions whitening = {};  ///< Whitening of guided_features.
  /// If set, replaces the whitened guided_features.
  std::optional<core::FeatureTransform> features = {};
  /// Entries for the published support, which uses unscaled features and one estimate per time
  /// step. Without `published`, Algorithm 1 runs on guided recovery's support.
  std::string published_features = {};
  std::optional<kernel::TimeVaryingSupportOptions> published = {};
  int horizon = 100;  ///< T: number of the learned policy's time steps in an episode, > 0.
};

/// Options of a controller for an episode.
struct ControllerOptions {
  int horizon = 0;               ///< T: number of the learned policy's time steps; 0: the model's.
  int first_step = 0;            ///< First time step of an episode, in [0, T).
  control::DfrOptions dfr = {};  ///< For "dfr"; "dfr-fine" has the constants of the paper.
  /// For "guard" and "controller". ControllerOptions::horizon and first_step replace its values.
  control::GuidedOptions guided = {};
};

/// The support of the paper, one estimate per time step, and the entries of a state that it uses.
struct PublishedSupport {
  core::FeatureSelection features;
  kernel::TimeVaryingSupport support;
};

/// Parts of a task model.
struct TaskParts {
  core::FeatureTransform features;  ///< Whitened features for guided recovery.
  kernel::WhitenedSupport support;  ///< Support of `features` at each time step.
  control::Levels levels;           ///< Levels of demonstrations, and the slack.
  control::Response response;       ///< Response of `features` to controls.
  std::optional<PublishedSupport> published = {};
  std::vector<double> lambda = {};  ///< See TaskModel::lambda().
  bool single_precision = false;    ///< See kernel::WhitenedSupportOptions.
  int horizon = 100;                ///< See TaskOptions::horizon.

  /// Return g_t and l_t for whole states: those of `support`, and those of the support that
  /// Algorithm 1 uses. The results borrow this object.
  [[nodiscard]] core::FeatureDecision GuidedDecision() const { return {features, support}; }
  [[nodiscard]] core::FeatureDecision PublishedDecision() const;
  /// Returns the parts that controllers borrow.
  [[nodiscard]] control::TaskView view() const noexcept {
    return {features, support, levels, response};
  }
};

/// Model fitted to one set of demonstrations (docs/recovery.md): whitened features, their support
/// at each time step, levels, the response to controls, and lambda. Creates all controllers. Each
/// guard and each program has one. Owns all its parts. The parts that guided recovery uses are
/// identical for any order of the demonstrations.
///
/// Immutable; controllers on several threads share it.
class TaskModel {
 public:
  /// Fits a model to demonstrations with states of this `layout`.
  /// @throws std::invalid_argument naming the cause: fewer than three demonstrations, different
  /// shapes, constant features, only zero controls, an option out of range, or an unknown feature.
  TaskModel(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations,
            const TaskOptions& options = {});
  /// @throws std::invalid_argument if the dimensions of `parts` differ.
  explicit TaskModel(TaskParts parts);
  TaskModel(TaskModel&&) noexcept;
  TaskModel& operator=(TaskModel&&) noexcept;
  ~TaskModel();

  /// Writes task.dfr and, if there is a published support, support.dfr into `folder`. Creates the
  /// folder if necessary. @throws std::runtime_error naming the file and the cause: the system's
  /// error, or features with a core::StateMap, which only a guard file can store.
  void Save(const std::filesystem::path& folder) const;
  /// Reads the files of Save() for states of this `layout`.
  /// @throws std::runtime_error naming the file and its defect.
  static TaskModel Load(const std::filesystem::path& folder, const core::StateLayout& layout);
  /// Appends all parts except the published support, the horizon and the selection of features to a
  /// file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save(archive) wrote. @throws std::runtime_error naming the file and its defect.
  static TaskModel Load(core::ArchiveReader& archive, core::FeatureSelection selection);

  /// Returns g_t for whole states, as used by Algorithm 1. Uses the published support if there is
  /// one, otherwise the support of guided recovery.
  [[nodiscard]] const core::DecisionFunction& support() const noexcept;
  /// Returns g_t and its logarithmic form l_t for whole states, from guided recovery's support.
  [[nodiscard]] const core::LogDecisionFunction& guided_support() const noexcept;
  /// Returns the map from a whole state to z of guided recovery.
  [[nodiscard]] const core::FeatureTransform& features() const noexcept;
  /// Returns the support of the features z.
  [[nodiscard]] const kernel::WhitenedSupport& feature_support() const noexcept;
  [[nodiscard]] const control::Levels& levels() const noexcept;
  [[nodiscard]] const control::Response& response() const noexcept;
  /// Returns the parts that controllers borrow.
  [[nodiscard]] control::TaskView view() const noexcept;
  /// Returns kernel::WhitenedSupportOptions::single_precision.
  [[nodiscard]] bool single_precision() const noexcept;
  /// Returns the published support; null if there is none.
  [[nodiscard]] const kernel::TimeVaryingSupport* published() const noexcept;
  /// Returns TaskOptions::published_features.
  [[nodiscard]] const std::string& published_features() const noexcept;
  /// Returns lambda_t, the demonstrated change of support() per unit of control.
  [[nodiscard]] const std::vector<double>& lambda() const noexcept;
  /// Returns TaskOptions::horizon.
  [[nodiscard]] int horizon() const noexcept;

  /// Creates a controller that borrows this model and `policy`.
  /// @throws std::invalid_argument if sizes differ, an option is out of range, or the method
  /// belongs to the caller (Method::Kind::kOther).
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const Method& method, const core::Policy& policy,
      const ControllerOptions& options = {}) const;
  /// Creates Algorithm 1 with the caller's recovery, which must not be null.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      std::unique_ptr<control::RecoveryStrategy> strategy, const core::Policy& policy,
      const ControllerOptions& options = {}) const;

 private:
  struct Data;
  // On the heap, because borrowed parts must keep their address when a model moves.
  std::unique_ptr<const Data> data_;
};

}  // namespace dfr::safety
