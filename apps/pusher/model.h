#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/plant.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/locally_weighted_policy.h"
#include "dfr/imitation/mlp_policy.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/method.h"
#include "dfr/safety/task_model.h"

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

/// The methods besides those of safety::ParseMethod(): the finite-difference oracle of Sec. V-A,
/// which tries controls on a copy of the simulation, and the demonstrations' own locally weighted
/// regression, without any support.
inline constexpr std::array<std::string_view, 2> kOtherMethods = {"finite-difference", "lwr"};

/// safety::ParseMethod() with these.
[[nodiscard]] safety::Method ParseMethod(const std::string& name);

/// What is learned from one set of demonstrations: the policy, and the task's model.
class Model {
 public:
  /// Fits to the first `demonstrations` trajectories of the set.
  /// @throws std::invalid_argument if there are not as many, or they do not fit.
  static Model Fit(const imitation::DemonstrationSet& set, int demonstrations,
                   const ModelOptions& options);

  /// Writes policy.dfr, demonstrations.hdf5 and the task's files into `folder`, which is made if
  /// need be.
  void Save(const std::filesystem::path& folder) const;
  static Model Load(const std::filesystem::path& folder);

  [[nodiscard]] const imitation::MlpPolicy& policy() const noexcept { return *policy_; }
  [[nodiscard]] const safety::TaskModel& task() const noexcept { return task_; }
  [[nodiscard]] const imitation::DemonstrationSet& demonstrations() const noexcept { return *set_; }

  /// Borrows this model; `plant`, the plant that is driven, is for "finite-difference" only.
  /// Episodes begin at time step `first_step`.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const safety::Method& method, const core::SimulatedPlant* plant = nullptr,
      int first_step = 0) const;

 private:
  Model(imitation::MlpPolicy policy, safety::TaskModel task, imitation::DemonstrationSet set);

  // On the heap, so that what borrows them stays valid when a Model moves.
  std::unique_ptr<const imitation::MlpPolicy> policy_;
  safety::TaskModel task_;
  std::unique_ptr<const imitation::DemonstrationSet> set_;
  std::unique_ptr<const imitation::LocallyWeightedPolicy> locally_weighted_;
};

}  // namespace dfr::apps::pusher
