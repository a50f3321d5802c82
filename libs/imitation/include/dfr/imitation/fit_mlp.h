#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/mlp_policy.h"

namespace dfr::imitation {

enum class FitMethod {
  kAdam,                ///< Mini-batches for a fixed number of epochs, as in the paper.
  kLbfgs,               ///< Ceres's L-BFGS, run to a minimum; for networks of any size.
  kLevenbergMarquardt,  ///< Ceres, run to a minimum in few iterations; for small networks.
};

/// Options of FitMlp(). The defaults are the stronger learner of the paper's Sec. V-A, with two
/// hidden layers of 64 tanh units. The paper's weak learner has hidden = {8}.
struct FitMlpOptions {
  std::vector<int> hidden = {64, 64};  ///< Tanh units per hidden layer; empty: a linear policy.
  FitMethod method = FitMethod::kAdam;
  std::string features = {};       ///< Inputs, in the format of core::FeatureSelection; empty: all.
  double control_limit = 1.0;      ///< The policy clips controls to +-this value, > 0.
  double weight_decay = 0.0;       ///< Weight of the squared network weights in the loss, >= 0.
  bool skip_zero_controls = true;  ///< Leave out rows with u = 0, which pad finished episodes.
  int epochs = 10;                 ///< kAdam: passes over the data.
  int batch = 32;                  ///< kAdam: rows per step.
  double learning_rate = 1e-3;     ///< kAdam: step size.
  int max_iterations = 500;        ///< Limit for kLbfgs and kLevenbergMarquardt.
  std::uint64_t seed = 0;          ///< Seeds the initial weights and the shuffling.
};

/// Result of a fit. Reaching `max_iterations` is not an error; see `converged`.
struct FitReport {
  int rows = 0;          ///< Number of rows used.
  int skipped_rows = 0;  ///< Number of rows left out because u = 0.
  double initial_loss = 0.0;
  double final_loss = 0.0;
  int iterations = 0;      ///< kAdam: epochs; otherwise Ceres's iterations.
  bool converged = false;  ///< True if a minimum was reached; never for kAdam.
  std::string message;     ///< Reason for the end.
};

/// Learns u = pi(x) by least squares on standardised features: minimises
///   mean_i |mlp(whitening(features(x_i))) - u_i|^2 / 2 + weight_decay |W|^2 / 2
/// with W the weights without the biases. Deterministic for a given seed and machine.
/// @param states  one state per row, of the given layout.
/// @param controls  one control per row.
/// @throws std::invalid_argument naming the option, the shape, or the first row with an entry that
///   is not finite; also if no row is left, or kLevenbergMarquardt would need a Jacobian of over 2
///   GB.
MlpPolicy FitMlp(const core::StateLayout& layout, const core::Matrix& states,
                 const core::Matrix& controls, const FitMlpOptions& options,
                 FitReport* report = nullptr);

/// Overload for all state-control pairs of demonstrations.
MlpPolicy FitMlp(const DemonstrationSet& demonstrations, const FitMlpOptions& options,
                 FitReport* report = nullptr);

}  // namespace dfr::imitation
