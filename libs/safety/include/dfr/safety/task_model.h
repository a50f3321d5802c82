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
#include "dfr/core/archive.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/feature_decision.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/features.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/method.h"

namespace dfr::safety {

/// Options for TaskModel.
struct TaskOptions {
  /// Which entries of a state guided recovery's support looks at, as core::FeatureSelection takes
  /// them; "" for all.
  std::string guided_features = {};
  kernel::WhitenedSupportOptions guided = {};
  core::WhiteningOptions whitening = {};  ///< How guided_features are whitened.
  /// Features of the caller's own, in place of the whitened guided_features.
  std::optional<core::FeatureTransform> features = {};
  /// The same for the published support: features as they are, one estimate per time step. Without
  /// `published`, Algorithm 1 runs on guided recovery's support.
  std::string published_features = {};
  std::optional<kernel::TimeVaryingSupportOptions> published = {};
  int horizon = 100;  ///< T: time steps of the learned policy in an episode, > 0.
};

/// What an episode asks of a controller.
struct ControllerOptions {
  int horizon = 0;               ///< T: time steps of the learned policy; 0: the model's.
  int first_step = 0;            ///< Time step that an episode begins with, in [0, T).
  control::DfrOptions dfr = {};  ///< Of "dfr"; "dfr-fine" has the constants of the paper.
  /// Of "guided"; its horizon and first step are those above.
  control::GuidedOptions guided = {};
};

/// The support of the paper, one estimate per time step, and the entries of a state it looks at.
struct PublishedSupport {
  core::FeatureSelection features;
  kernel::TimeVaryingSupport support;
};

/// What a task model is made of.
struct TaskParts {
  core::FeatureTransform features;  ///< Whitened, for guided recovery.
  kernel::WhitenedSupport support;  ///< Of `features`, at each time step.
  control::Levels levels;           ///< That demonstrations keep, and unseen ones need.
  control::Response response;       ///< How `features` answered controls.
  std::optional<PublishedSupport> published = {};
  std::vector<double> lambda = {};  ///< TaskModel::lambda()
  bool single_precision = false;    ///< kernel::WhitenedSupportOptions::single_precision
  int horizon = 100;                ///< TaskOptions::horizon

  /// g_t and l_t of whole states: of `support`, and as Algorithm 1 sees them. They borrow it.
  [[nodiscard]] core::FeatureDecision GuidedDecision() const { return {features, support}; }
  [[nodiscard]] core::FeatureDecision PublishedDecision() const;
};

/// All that is learned from one set of demonstrations besides the policy (docs/recovery.md):
/// whitened features, their support at each time step, the levels that demonstrations keep, how
/// features answered controls, and lambda; and every controller that can be made of it. Guards, the
/// programs and a new app hold one each. It owns all of it and borrows nothing. The order of the
/// demonstrations changes no bit of what guided recovery learns.
///
/// Immutable; controllers on several threads share it.
class TaskModel {
 public:
  /// Fits to demonstrations whose states are laid out as `layout` says.
  /// @throws std::invalid_argument if there are fewer than three, they do not fit each other, no
  ///   feature differs between them, no control differs from zero, an option is out of range or a
  ///   feature does not exist; the message names which.
  TaskModel(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations,
            const TaskOptions& options = {});
  /// @throws std::invalid_argument if `parts` do not fit each other.
  explicit TaskModel(TaskParts parts);
  TaskModel(TaskModel&&) noexcept;
  TaskModel& operator=(TaskModel&&) noexcept;
  ~TaskModel();

  /// Writes task.dfr and, if there is a published support, support.dfr into `folder`, which is made
  /// if need be. @throws std::runtime_error naming the file and what the system said.
  void Save(const std::filesystem::path& folder) const;
  /// Reads what Save() wrote for states laid out as `layout` says.
  ///
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static TaskModel Load(const std::filesystem::path& folder, const core::StateLayout& layout);
  /// Appends to a file all but the published support, the horizon and the selection of features.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what that wrote. @throws std::runtime_error naming the file and what is wrong with it.
  static TaskModel Load(core::ArchiveReader& archive, core::FeatureSelection selection);

  /// g_t of whole states, as Algorithm 1 sees it: the published support's, else guided recovery's.
  [[nodiscard]] const core::DecisionFunction& support() const noexcept;
  /// g_t of whole states and its log form l_t, guided recovery's.
  [[nodiscard]] const core::LogDecisionFunction& guided_support() const noexcept;
  /// z of a whole state, as guided recovery sees it.
  [[nodiscard]] const core::FeatureTransform& features() const noexcept;
  /// g_t of z.
  [[nodiscard]] const kernel::WhitenedSupport& feature_support() const noexcept;
  [[nodiscard]] const control::Levels& levels() const noexcept;
  [[nodiscard]] const control::Response& response() const noexcept;
  /// What controllers borrow of it.
  [[nodiscard]] control::TaskView view() const noexcept;
  /// kernel::WhitenedSupportOptions::single_precision
  [[nodiscard]] bool single_precision() const noexcept;
  /// Null where there is none.
  [[nodiscard]] const kernel::TimeVaryingSupport* published() const noexcept;
  /// What the published support looks at, as TaskOptions::published_features.
  [[nodiscard]] const std::string& published_features() const noexcept;
  /// lambda_t, the demonstrated change of support() per unit of control.
  [[nodiscard]] const std::vector<double>& lambda() const noexcept;
  /// TaskOptions::horizon
  [[nodiscard]] int horizon() const noexcept;

  /// A controller that borrows this model and `policy`.
  /// @throws std::invalid_argument if sizes differ, an option is out of range, or the method is the
  ///   caller's own (Method::Kind::kOther).
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const Method& method, const core::Policy& policy,
      const ControllerOptions& options = {}) const;
  /// Algorithm 1 with a recovery of the caller's own, which must not be null.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      std::unique_ptr<control::RecoveryStrategy> strategy, const core::Policy& policy,
      const ControllerOptions& options = {}) const;

 private:
  struct Data;
  // On the heap, so that what controllers borrow stays where it is when a model moves.
  std::unique_ptr<const Data> data_;
};

}  // namespace dfr::safety
