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
#include "dfr/core/plant.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/locally_weighted_policy.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guided_recovery.h"

namespace dfr::apps::pusher {

/// The learned policy's network and how it is trained (Sec. V-A and the authors' scripts).
struct Learner {
  std::vector<int> hidden = {8};
  int epochs = 10;              ///< Passes of Adam over the demonstrations.
  double learning_rate = 1e-3;  ///< Of Adam.

  /// "8", "64-64": the units of each hidden layer.
  /// @throws std::invalid_argument for anything else.
  static Learner Parse(const std::string& name);
  [[nodiscard]] std::string Name() const;
};

/// Options for Model::Fit(). Defaults are the settings of the paper's experiments.
struct ModelOptions {
  Learner learner;
  std::string support_features = "red,object,tip";
  double nu = 0.05;
  double gamma = 5.0;  ///< 1/m^2
  int horizon = 60;    ///< T
  double guided_gamma = kernel::WhitenedSupportOptions()
                            .svm.gamma;  ///< Of guided recovery's support, in whitened units.
  std::uint64_t seed = 1;
};

/// Who is in control of an episode.
struct Method {
  std::string name;
  bool guided = false;
  control::Recovery recovery = control::Recovery::kNone;  ///< If not guided: Algorithm 1's.
  control::GuidedParts parts = {};                        ///< If guided: its parts, and whether it
  bool locally_weighted = false;                          ///< falls back on the demonstrations.

  /// "baseline", "early-stopping", "dfr", "finite-difference", "guided", "guided-lwr", or
  /// "guided-without-<part>" with a part of control::GuidedPartNames().
  /// @throws std::invalid_argument naming what is unknown and what there is.
  static Method Parse(const std::string& name);
};

/// All that is learned from one set of demonstrations: policy, support, lambda, and, once a method
/// asks for it, what guided recovery needs.
class Model {
 public:
  /// Fits to the first `demonstrations` trajectories of the set.
  /// @throws std::invalid_argument if there are not as many, or they do not fit.
  static Model Fit(const imitation::DemonstrationSet& set, int demonstrations,
                   const ModelOptions& options);

  /// Writes policy.dfr, support.dfr, switching.dfr and demonstrations.hdf5, from which guided
  /// recovery is fitted, into `folder`, which is made if need be.
  void Save(const std::filesystem::path& folder) const;
  static Model Load(const std::filesystem::path& folder);

  [[nodiscard]] const imitation::MlpPolicy& policy() const noexcept { return *policy_; }
  /// g_t of a whole state.
  [[nodiscard]] const core::DecisionFunction& support() const noexcept { return *decision_; }
  [[nodiscard]] const kernel::TimeVaryingSupport& estimate() const noexcept { return *support_; }
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return lambda_; }
  [[nodiscard]] int horizon() const noexcept { return horizon_; }
  [[nodiscard]] int demonstrations() const noexcept {
    return static_cast<int>(set_->trajectories.size());
  }
  [[nodiscard]] const imitation::DemonstrationSet& demonstration_set() const noexcept {
    return *set_;
  }
  /// What the support looks at, as ModelOptions::support_features.
  [[nodiscard]] const std::string& support_features() const noexcept { return feature_spec_; }
  /// Fitted on the first call, in a fraction of a second; for one thread.
  [[nodiscard]] const safety::GuidedRecovery& guided();

  /// Borrows this model; `oracle_plant` is for Recovery::kFiniteDifference only. Episodes begin at
  /// time step `first_step`.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const Method& method, const core::SimulatedPlant* oracle_plant = nullptr, int first_step = 0);

 private:
  Model(imitation::MlpPolicy policy, const core::FeatureSelection& features,
        kernel::TimeVaryingSupport support, std::vector<double> lambda, int horizon,
        double guided_gamma, imitation::DemonstrationSet set);

  // On the heap, so that what borrows them stays valid when a Model moves.
  std::unique_ptr<const imitation::MlpPolicy> policy_;
  std::unique_ptr<const kernel::TimeVaryingSupport> support_;
  std::unique_ptr<const core::FeatureDecision> decision_;
  std::string feature_spec_;
  std::vector<double> lambda_;
  int horizon_;
  double guided_gamma_;
  std::unique_ptr<const imitation::DemonstrationSet> set_;
  std::unique_ptr<const safety::GuidedRecovery> guided_;
  std::unique_ptr<const imitation::LocallyWeightedPolicy> locally_weighted_;
};

}  // namespace dfr::apps::pusher
