#pragma once

#include <array>
#include <cstdint>

#include "dfr/core/trajectory.h"

namespace dfr::experiment {

/// What an episode is worth, in [0, 1].
struct EpisodeCredit {
  double completed = 1.0;
  double halted = 0.5;  ///< Safe, and all but done.
  double collided = 0.0;

  /// @param progress  share of the task that was done before the episode ended, in [0, 1]. A halted
  ///   episode has that share of `halted`.
  [[nodiscard]] double operator()(core::Outcome outcome, double progress) const noexcept;
};

/// Whether two methods differ, from pairs of episodes that may be looked at after every one: the
/// test stays right however often one looks and whenever one stops (Ville, 1939).
///
/// It bets that the mean difference of credits d in [-1, 1] is not zero (Waudby-Smith and Ramdas,
/// JRSS B 2024). Its wealth is the mean over the stakes +-.1, +-.2, ..., +-.9 of the products of 1
/// + stake d. As long as the mean of each d, given all before it, is zero, wealth is a martingale
/// that begins at 1, so that it ever reaches 1 / alpha with probability at most alpha. Start states
/// are drawn independently, so that this holds of methods that do not differ in any trial.
class SequentialTest {
 public:
  /// @throws std::invalid_argument unless alpha lies in (0, 1).
  explicit SequentialTest(double alpha = 0.05);

  /// One more pair: the credit of the first method less that of the second.
  /// @throws std::invalid_argument unless it lies in [-1, 1].
  void Add(double difference);

  /// That they differ is settled, and stays so.
  [[nodiscard]] bool settled() const noexcept { return settled_at_ > 0; }
  /// The pair that settled it; 0 where none has.
  [[nodiscard]] std::int64_t settled_at() const noexcept { return settled_at_; }
  [[nodiscard]] std::int64_t pairs() const noexcept { return pairs_; }
  /// Mean difference so far.
  [[nodiscard]] double mean() const noexcept;
  /// log of the wealth.
  [[nodiscard]] double log_wealth() const noexcept;
  /// The least alpha at which this run would have settled it, at most 1: a p-value that holds at
  /// all times.
  [[nodiscard]] double p_value() const noexcept;

 private:
  static constexpr int kStakes = 18;

  double alpha_;
  std::array<double, kStakes> log_wealth_{};  // by stake
  double most_ = 0.0;                         // the largest log_wealth() so far
  double sum_ = 0.0;
  std::int64_t pairs_ = 0;
  std::int64_t settled_at_ = 0;
};

}  // namespace dfr::experiment
