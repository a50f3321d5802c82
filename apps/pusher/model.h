#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dfr/control/switching_policy.h"
#include "dfr/core/features.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/kernel/time_varying_support.h"

namespace dfr::apps {

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
  std::uint64_t seed = 1;
};

/// All that is learned from one set of demonstrations: policy, support, and lambda.
class Model {
 public:
  /// Fits to the first `demonstrations` trajectories of the set.
  /// @throws std::invalid_argument if there are not as many, or they do not fit.
  static Model Fit(const imitation::DemonstrationSet& set, int demonstrations,
                   const ModelOptions& options);

  /// Writes policy.dfr, support.dfr and switching.dfr into `folder`, which is made if need be.
  void Save(const std::filesystem::path& folder) const;
  static Model Load(const std::filesystem::path& folder);

  [[nodiscard]] const imitation::MlpPolicy& policy() const noexcept { return *policy_; }
  /// g_t of a whole state.
  [[nodiscard]] const core::DecisionFunction& support() const noexcept { return *decision_; }
  [[nodiscard]] const kernel::TimeVaryingSupport& estimate() const noexcept { return *support_; }
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return lambda_; }
  [[nodiscard]] int horizon() const noexcept { return horizon_; }
  [[nodiscard]] int demonstrations() const noexcept { return demonstrations_; }

  /// Algorithm 1 with this model; `oracle_plant` is for Recovery::kFiniteDifference only.
  [[nodiscard]] control::SwitchingPolicy MakeController(
      control::Recovery recovery, const core::SimulatedPlant* oracle_plant = nullptr) const;

 private:
  Model(imitation::MlpPolicy policy, const core::FeatureSelection& features,
        kernel::TimeVaryingSupport support, std::vector<double> lambda, int horizon,
        int demonstrations);

  // On the heap, so that what borrows them stays valid when a Model moves.
  std::unique_ptr<const imitation::MlpPolicy> policy_;
  std::unique_ptr<const kernel::TimeVaryingSupport> support_;
  std::unique_ptr<const core::FeatureDecision> decision_;
  std::string feature_spec_;
  std::vector<double> lambda_;
  int horizon_;
  int demonstrations_;
};

}  // namespace dfr::apps
