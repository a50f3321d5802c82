#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/safety/task_model.h"

namespace dfr::apps::line_tracking {

/// Options for LineModel::Fit().
struct LineModelOptions {
  std::vector<int> hidden = {64, 64};  ///< Tanh units of the policy's layers.
  std::string support_features = "tip[0:1],distance";
  double nu = 0.05;  ///< The quantile of the demonstrated states that may be outside.
  /// Candidates for the kernel's width, 1/mm^2. Where there are several, kernel::SelectModel()
  /// chooses by held-out demonstrations (Sec. V-B): the tightest support that accepts `acceptance`
  /// of their states; where none does, the one that accepts most.
  std::vector<double> gammas = {0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0};
  /// What nu promises, 1 - nu. A tighter support has its gate's threshold lambda |u| beyond the
  /// largest g at some time step, and DFR halts there.
  double acceptance = 0.95;
  double guided_gamma = kernel::WhitenedSupportOptions()
                            .svm.gamma;  ///< Of guided recovery's support, in whitened units.
  int horizon = 55;                      ///< T: controls of the learned policy in an episode.
  std::uint64_t seed = 1;                ///< Of the network's first weights.
};

/// The constants of this task's controllers. "dfr" is Algorithm 1 with steps larger than the noise
/// of images, probe g / (10 lambda), step g / (2 lambda); "dfr-fine" has the paper's. "guided"
/// knows that the platform moves on during a control; "guided-without-drift" takes what the
/// platform does for the answer to controls.
[[nodiscard]] safety::ControllerOptions Controllers();

/// What is learned from one set of demonstrations: the policy, and the task's model.
class LineModel {
 public:
  /// @throws std::invalid_argument if there are fewer than 8 demonstrations, or they do not fit.
  static LineModel Fit(const imitation::DemonstrationSet& set, const LineModelOptions& options,
                       kernel::Selection* selection = nullptr);

  /// Writes policy.dfr, demonstrations.hdf5 and the task's files into `folder`, which is made if
  /// need be.
  void Save(const std::filesystem::path& folder) const;
  static LineModel Load(const std::filesystem::path& folder);

  [[nodiscard]] const imitation::MlpPolicy& policy() const noexcept { return *policy_; }
  [[nodiscard]] const safety::TaskModel& task() const noexcept { return task_; }
  [[nodiscard]] const imitation::DemonstrationSet& demonstrations() const noexcept { return set_; }

  /// Borrows this model. `method` is one of safety::ParseMethod()'s.
  /// @throws std::invalid_argument naming what is unknown and what there is.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const std::string& method) const;

 private:
  LineModel(imitation::MlpPolicy policy, safety::TaskModel task, imitation::DemonstrationSet set);

  // On the heap, so that what borrows it stays valid when a model moves.
  std::unique_ptr<const imitation::MlpPolicy> policy_;
  safety::TaskModel task_;
  imitation::DemonstrationSet set_;
};

}  // namespace dfr::apps::line_tracking
