#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/plant.h"
#include "dfr/imitation/gaussian_policy.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/method.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "dfr/study/learned_model.h"

namespace dfr::apps::pusher {

/// Network and training of the learned policy (Sec. V-A and the authors' scripts).
struct Learner {
  std::vector<int> hidden = {8};
  /// Number of passes of Adam over the demonstrations; absent: ModelOptions::epochs.
  std::optional<int> epochs = {};
  double learning_rate = 1e-3;  ///< Learning rate of Adam.

  /// Parses "8" or "64-64", the units of each hidden layer; "8x100" is trained for 100 epochs.
  /// @throws std::invalid_argument for anything else.
  static Learner Parse(const std::string& name);
  [[nodiscard]] std::string Name() const;
};

/// Options for Model::Fit(). Defaults are the settings of the paper's experiments.
struct ModelOptions {
  Learner learner;
  int epochs = 10;  ///< Used if the learner has no number of epochs.
  std::string support_features = "red,object,tip";
  double nu = 0.05;
  double gamma = 5.0;  ///< 1/m^2
  int horizon = 60;    ///< T
  double whitened_gamma =
      kernel::WhitenedSupportOptions()
          .svm.gamma;  ///< Gamma of the whitened support of guard and controller.
  std::uint64_t seed = 1;
};

/// LearnedModel of the Pusher.
class Model : public study::LearnedModel {
 public:
  /// Fits to the first `demonstrations` trajectories of the set. Baselines that query the
  /// supervisor need `supervisor` and its scene, and are rejected without them.
  /// @throws std::invalid_argument if `demonstrations` is below 3 or above the set's size, or if
  /// the set is invalid.
  static Model Fit(const imitation::DemonstrationSet& set, int demonstrations,
                   const ModelOptions& options,
                   const imitation::GaussianPolicy* supervisor = nullptr,
                   const sim::PusherOptions& scene = {});

  static Model Load(const std::filesystem::path& folder);

  /// Returns a controller that borrows this model. Only oracles and adversaries need `plant`.
  /// Episodes begin at time step `first_step`.
  [[nodiscard]] std::unique_ptr<control::Controller> MakeController(
      const safety::Method& method, const core::SimulatedPlant* plant = nullptr,
      int first_step = 0) const;

 private:
  // NOLINTNEXTLINE(google-explicit-constructor): constructed only here
  Model(study::LearnedModel learned) : study::LearnedModel(std::move(learned)) {}
};

}  // namespace dfr::apps::pusher
