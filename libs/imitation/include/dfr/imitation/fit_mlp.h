#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/mlp_policy.h"

namespace dfr::imitation {

enum class FitMethod {
  kAdam,                ///< Mini-batches for a fixed number of epochs, as the paper's authors did.
  kLbfgs,               ///< To a minimum, by Ceres; for networks of any size.
  kLevenbergMarquardt,  ///< To a minimum, by Ceres; few iterations, for small networks.
};

/// Options of FitMlp(). Defaults are the stronger learner of Sec. V-A, 64-64 tanh; the authors'
/// weak one has hidden = {8}.
struct FitMlpOptions {
  std::vector<int> hidden = {64, 64};  ///< Tanh units; none for a linear policy.
  FitMethod method = FitMethod::kAdam;
  std::string features = {};       ///< What the policy sees, as core::FeatureSelection; empty: all.
  double control_limit = 1.0;      ///< The policy clips controls to +-this, > 0.
  double weight_decay = 0.0;       ///< Weight of the squared weights in the loss, >= 0.
  bool skip_zero_controls = true;  ///< Leave out rows with u = 0, which pad finished episodes.
  int epochs = 10;                 ///< kAdam: passes over the data.
  int batch = 32;                  ///< kAdam: rows of a step.
  double learning_rate = 1e-3;     ///< kAdam.
  int max_iterations = 500;        ///< kLbfgs, kLevenbergMarquardt.
  std::uint64_t seed = 0;          ///< Seeds the initial weights and the shuffling.
};

/// How a fit went. Reaching `max_iterations` is no error: the caller decides.
struct FitReport {
  int rows = 0;          ///< Used.
  int skipped_rows = 0;  ///< Left out for u = 0.
  double initial_loss = 0.0;
  double final_loss = 0.0;
  int iterations = 0;      ///< Epochs of kAdam, else accepted steps.
  bool converged = false;  ///< A minimum was reached. Never with kAdam, which does not look.
  std::string message;     ///< Why it ended.
};

/// Learns u = pi(x) by least squares on standardised features: minimises
///   mean_i |mlp(whitening(features(x_i))) - u_i|^2 / 2 + weight_decay |W|^2 / 2
/// with W the weights without the biases. Deterministic for a seed and machine.
/// @param states  one state per row, of the given layout.
/// @param controls  one control per row.
/// @throws std::invalid_argument naming the option, the shape, or the first row with an entry that
///   is not finite; also if no row is left, or kLevenbergMarquardt would need a Jacobian of over 2
///   GB.
MlpPolicy FitMlp(const core::StateLayout& layout, const core::Matrix& states,
                 const core::Matrix& controls, const FitMlpOptions& options,
                 FitReport* report = nullptr);

/// The same from all state-control pairs of demonstrations.
MlpPolicy FitMlp(const DemonstrationSet& demonstrations, const FitMlpOptions& options,
                 FitReport* report = nullptr);

}  // namespace dfr::imitation
