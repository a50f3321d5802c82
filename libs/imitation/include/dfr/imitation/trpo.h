#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/plant.h"
#include "dfr/imitation/gaussian_policy.h"

namespace dfr::imitation {

/// A task to learn: a plant with a reward.
class Environment {
 public:
  struct StepResult {
    double reward = 0.0;
    bool terminal = false;  ///< True if the episode ends before its horizon.
  };

  virtual ~Environment() = default;

  /// Returns the plant. Trpo reads its layout, states, completed() and collided(), but drives it
  /// only through Reset() and Step().
  [[nodiscard]] virtual const core::Plant& plant() const noexcept = 0;

  /// Starts an episode. The same seed gives the same start state.
  virtual void Reset(std::uint64_t seed) = 0;

  /// Applies one control, already within Trpo's control limit.
  /// @throws std::runtime_error if the plant fails.
  virtual StepResult Step(std::span<const double> control) = 0;
};

/// Options of Trpo. The defaults are the values that the Pusher uses.
struct TrpoOptions {
  std::vector<int> hidden = {64, 64};         ///< Tanh units per hidden layer of the policy.
  std::vector<int> critic_hidden = {64, 64};  ///< Tanh units per hidden layer of the critic.
  std::string features = {};   ///< Inputs, in the format of core::FeatureSelection; empty: all.
  double control_limit = 1.0;  ///< Controls are clipped to +-this value, > 0.
  int horizon = 60;            ///< Maximum number of steps per episode, T.
  int batch_steps = 4000;      ///< Minimum number of steps per iteration; episodes stay whole.
  double discount = 0.98;      ///< gamma in [0, 1].
  double gae_lambda = 0.97;  ///< Trades bias (0) against variance (1) of the advantages, in [0, 1].
  double max_kl = 0.04;      ///< Bound on the mean KL divergence per iteration, > 0.
  int cg_iterations = 10;    ///< Number of conjugate gradient steps.
  double cg_damping = 0.1;   ///< Added to the diagonal of the Fisher matrix, >= 0.
  double initial_log_std = -0.7;  ///< Initial log standard deviation of the unclipped controls.
  double min_log_std = -1.2;      ///< Minimum log standard deviation, which keeps exploration.
  int critic_epochs = 5;          ///< Number of Adam passes over each batch.
  int critic_batch = 64;          ///< Samples per Adam step.
  double critic_learning_rate = 1e-3;
  std::uint64_t seed = 0;  ///< Seed of start states, noise, weights and shuffling.
  /// Description of the environment. The checkpoint stores the description: a caller can refuse to
  /// resume in another environment.
  std::string environment = {};
};

/// Statistics of one iteration.
struct TrpoProgress {
  int iteration = 0;            ///< Number of the iteration, from 1.
  std::int64_t steps = 0;       ///< Number of controls applied so far.
  int episodes = 0;             ///< Number of episodes in this iteration.
  double mean_return = 0.0;     ///< Undiscounted sum of rewards per episode.
  double mean_length = 0.0;     ///< Steps per episode.
  double completed = 0.0;       ///< Fraction of episodes completed without a collision.
  double collided = 0.0;        ///< Fraction of episodes with a collision.
  double kl = 0.0;              ///< KL divergence of the update; 0 if it was rejected.
  double surrogate_gain = 0.0;  ///< Gain in standard deviations of the advantage; 0 if rejected.
  double entropy = 0.0;         ///< Entropy of the unclipped controls, in nats.
  /// Fraction of the returns' variance that the critic explains before its fit; 1 is perfect.
  double explained_variance = 0.0;
  bool accepted = false;  ///< True if the line search improved the surrogate within the bound.
};

/// Trust Region Policy Optimization (Schulman et al., 2015). Each iteration moves a Gaussian policy
/// along the natural gradient of the surrogate return as far as a bound on the KL divergence
/// allows. Advantages are GAE(lambda) (Schulman et al., 2016). The critic's inputs include t/T,
/// because the value depends on the time left. Inputs are whitened by the statistics of all states
/// so far, which stay constant during an iteration. A quarter of a batch, collected before the
/// first iteration, initialises these statistics.
///
/// Deterministic: the same seed, environment and machine give the same policy. Each object belongs
/// to one thread.
class Trpo {
 public:
  /// Borrows `environment`, which must outlive this object.
  /// @throws std::invalid_argument naming the option out of range.
  explicit Trpo(Environment& environment, TrpoOptions options = {});

  /// Continues from a checkpoint, bit-identically to an uninterrupted run. The environment may
  /// differ but must have the same layout, for example to continue on a harder task.
  /// @throws std::runtime_error naming the file and the problem.
  static Trpo Resume(Environment& environment, const std::filesystem::path& checkpoint);

  Trpo(Trpo&&) noexcept;
  Trpo& operator=(Trpo&&) noexcept;
  ~Trpo();

  /// Collects a batch, updates the policy, and fits the critic. An exception leaves this object
  /// unchanged.
  /// @throws std::runtime_error if the environment throws or returns a state or reward that is not
  ///   finite, or if the critic diverges.
  TrpoProgress Iterate();

  /// Returns the current policy.
  [[nodiscard]] GaussianPolicy policy() const;

  [[nodiscard]] std::int64_t steps() const noexcept;  ///< Number of controls applied so far.
  [[nodiscard]] const TrpoOptions& options() const noexcept;

  /// Writes a checkpoint. @throws std::runtime_error naming the file.
  void Save(const std::filesystem::path& checkpoint) const;

 private:
  class Learner;
  explicit Trpo(std::unique_ptr<Learner> learner);
  std::unique_ptr<Learner> learner_;
};

/// Generalised advantage estimation for one episode that ends with its last reward:
///   A_t = sum_k (discount lambda)^k (r_{t+k} + discount V_{t+k+1} - V_{t+k}),  V_T = 0.
/// All three spans have one entry per step. Never allocates.
void GeneralizedAdvantages(std::span<const double> rewards, std::span<const double> values,
                           double discount, double lambda, std::span<double> advantages) noexcept;

}  // namespace dfr::imitation
