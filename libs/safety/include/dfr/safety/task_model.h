#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dfr/control/guided/guided_policy.h"
#include "dfr/control/published/recovery_strategy.h"
#include "dfr/control/published/switching_policy.h"
#include "dfr/core/archive.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/features.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guided_recovery.h"
#include "dfr/safety/method.h"

namespace dfr::safety {

/// Options for TaskModel.
struct TaskOptions {
  /// Which entries of a state guided recovery's support looks at, as core::FeatureSelection takes
  /// them; "" for all.
  std::string guided_features = {};
  kernel::WhitenedSupportOptions guided = {};
  core::WhiteningOptions whitening = {};  ///< How guided_features are whitened.
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

/// All that is learned from one set of demonstrations besides the policy: the support of the
/// demonstrated states, lambda, and how features answer controls; and every controller that can be
/// made of it. Guards, the programs and a new app hold one each.
///
/// Immutable; controllers on several threads share it.
class TaskModel {
 public:
  /// Fits to demonstrations whose states are laid out as `layout` says.
  /// @throws std::invalid_argument if there are fewer than three, they do not fit each other, an
  ///   option is out of range or a feature does not exist; the message names which.
  TaskModel(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations,
            const TaskOptions& options = {});
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
  /// A model of parts: guided recovery, and the published support with its features, if there is
  /// one. @throws std::invalid_argument if they do not fit each other.
  TaskModel(std::shared_ptr<const GuidedRecovery> guided, std::vector<double> lambda,
            std::optional<kernel::TimeVaryingSupport> published = std::nullopt,
            std::optional<core::FeatureSelection> published_features = std::nullopt,
            int horizon = 100);

  [[nodiscard]] const GuidedRecovery& guided() const noexcept { return *guided_; }
  /// g_t of whole states, as Algorithm 1 sees it: the published support's, else guided recovery's.
  [[nodiscard]] const core::DecisionFunction& support() const noexcept { return *decision_; }
  /// g_t of whole states and its log form l_t, guided recovery's.
  [[nodiscard]] const core::LogDecisionFunction& guided_support() const noexcept {
    return *guided_decision_;
  }
  /// Null where there is none.
  [[nodiscard]] const kernel::TimeVaryingSupport* published() const noexcept {
    return published_.get();
  }
  /// What the published support looks at, as TaskOptions::published_features.
  [[nodiscard]] const std::string& published_features() const noexcept { return features_; }
  /// lambda_t, the demonstrated change of support() per unit of control.
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return lambda_; }

  /// TaskOptions::horizon
  [[nodiscard]] int horizon() const noexcept { return horizon_; }

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
  // On the heap, so that what borrows them stays valid when a model moves.
  std::shared_ptr<const GuidedRecovery> guided_;
  std::unique_ptr<const core::LogDecisionFunction> guided_decision_;
  std::unique_ptr<const kernel::TimeVaryingSupport> published_;
  std::unique_ptr<const core::DecisionFunction> published_decision_;
  const core::DecisionFunction* decision_ = nullptr;
  std::string features_;
  std::vector<double> lambda_;
  int horizon_ = 0;
};

}  // namespace dfr::safety
