#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/control/guided_policy.h"
#include "dfr/control/switching_policy.h"
#include "dfr/core/features.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guided_recovery.h"

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
  double guided_gamma = 0.35;  ///< Of guided recovery's support, in whitened units.
  int horizon = 55;            ///< T: controls of the learned policy in an episode.
  std::uint64_t seed = 1;      ///< Of the network's first weights.
};

/// Who is in control of an episode.
struct Method {
  std::string name;
  bool guided = false;
  control::SwitchingPolicyOptions switching = {};  ///< If not guided: Algorithm 1's.
  control::GuidedOptions recovery = {};            ///< If guided; its horizon is the model's.

  /// "baseline", "early-stopping", "dfr", "dfr-fine", "guided", "guided-without-drift", or
  /// "guided-without-<part>" with a part of control::GuidedPartNames(). "dfr" is Algorithm 1 with
  /// steps larger than the noise of images: probe g / (10 lambda), step g / (2 lambda); "dfr-fine"
  /// has the constants of the paper's simulations, g / (500 lambda) and g / (50 lambda).
  /// "guided-without-drift" takes what the platform does for the answer to controls.
  /// @throws std::invalid_argument naming what is unknown and what there is.
  static Method Parse(const std::string& name);
};

/// All that is learned from one set of demonstrations: policy, supports, lambda, and what guided
/// recovery needs.
class LineModel {
 public:
  /// @throws std::invalid_argument if there are fewer than 8 demonstrations, or they do not fit.
  static LineModel Fit(const imitation::DemonstrationSet& set, const LineModelOptions& options,
                       kernel::Selection* selection = nullptr);

  /// Writes policy.dfr, support.dfr, switching.dfr and demonstrations.hdf5, from which guided
  /// recovery is fitted, into `folder`, which is made if need be.
  void Save(const std::filesystem::path& folder) const;
  static LineModel Load(const std::filesystem::path& folder);

  [[nodiscard]] const imitation::MlpPolicy& policy() const noexcept { return *policy_; }
  /// g_t of a whole state.
  [[nodiscard]] const core::DecisionFunction& support() const noexcept { return *decision_; }
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return lambda_; }
  [[nodiscard]] double gamma() const noexcept { return gamma_; }
  [[nodiscard]] const imitation::DemonstrationSet& demonstrations() const noexcept { return set_; }

  /// Borrows this model.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(const Method& method) const;

 private:
  LineModel(imitation::MlpPolicy policy, const core::FeatureSelection& features,
            kernel::TimeVaryingSupport support, std::vector<double> lambda, double gamma,
            int horizon, double guided_gamma, imitation::DemonstrationSet set);

  // On the heap, so that what borrows them stays valid when a model moves.
  std::unique_ptr<const imitation::MlpPolicy> policy_;
  std::unique_ptr<const kernel::TimeVaryingSupport> support_;
  std::unique_ptr<const core::FeatureDecision> decision_;
  std::string feature_spec_;
  std::vector<double> lambda_;
  double gamma_;
  int horizon_;
  double guided_gamma_;
  imitation::DemonstrationSet set_;
  std::unique_ptr<const safety::GuidedRecovery> guided_;
};

}  // namespace dfr::apps::line_tracking
