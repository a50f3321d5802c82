#pragma once

#include <array>
#include <cstdint>

#include "dfr/core/trajectory.h"

namespace dfr::experiment {

/// Credit of an episode, in [0, 1].
struct EpisodeCredit {
  double completed = 1.0;
  double halted = 0.5;  ///< Credit of a halted episode at full progress.
  double collided = 0.0;

  /// @param progress  completed fraction of the task before the episode ended, in [0, 1]. A halted
  ///   episode receives that fraction of `halted`.
  [[nodiscard]] double operator()(core::Outcome outcome, double progress) const noexcept;
};

/// Sequential test for a difference between two methods, from pairs of episodes. The test may be
/// evaluated after every pair: the error bound holds for any stopping time (Ville, 1939).
///
/// The test bets that the mean difference of credits d in [-1, 1] is not zero (Waudby-Smith and
/// Ramdas, JRSS B 2024). Its wealth is the mean, over the stakes +-.1, ..., +-.9, of the product of
/// 1 + stake d over all pairs. If the mean of each d, given all earlier ones, is zero, wealth is a
/// martingale that starts at 1, and reaches 1 / alpha with probability at most alpha. Start states
/// are independent, so the condition holds for methods that do not differ in any trial.
class SequentialTest {
 public:
  /// @throws std::invalid_argument unless alpha lies in (0, 1).
  explicit SequentialTest(double alpha = 0.05);

  /// Adds a pair: the credit of the first method minus the credit of the second.
  /// @throws std::invalid_argument unless `difference` lies in [-1, 1].
  void Add(double difference);

  /// True once a difference is established; remains true.
  [[nodiscard]] bool settled() const noexcept { return settled_; }
  [[nodiscard]] std::int64_t pairs() const noexcept { return pairs_; }
  /// Mean difference so far.
  [[nodiscard]] double mean() const noexcept;
  /// Returns the logarithm of the wealth.
  [[nodiscard]] double log_wealth() const noexcept;
  /// Returns the smallest alpha at which this run would have established a difference, at most 1:
  /// an anytime-valid p-value.
  [[nodiscard]] double p_value() const noexcept;

 private:
  static constexpr int kStakes = 18;

  double alpha_;
  std::array<double, kStakes> log_wealth_{};  // by stake
  double most_ = 0.0;                         // largest log_wealth() so far
  double sum_ = 0.0;
  std::int64_t pairs_ = 0;
  bool settled_ = false;
};

}  // namespace dfr::experiment
