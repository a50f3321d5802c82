#include "dfr/experiment/sequential_test.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::experiment {

double EpisodeCredit::operator()(core::Outcome outcome, double progress) const noexcept {
  switch (outcome) {
    case core::Outcome::kCompleted:
      return completed;
    case core::Outcome::kHalted:
      return halted * progress;
    case core::Outcome::kCollided:
      break;
  }
  return collided;
}

SequentialTest::SequentialTest(double alpha) : alpha_(alpha) {
  DFR_THROW_UNLESS(alpha > 0.0 && alpha < 1.0, "alpha must lie in (0, 1), not " << alpha);
}

void SequentialTest::Add(double difference) {
  DFR_THROW_UNLESS(difference >= -1.0 && difference <= 1.0,
                   "a difference of credits must lie in [-1, 1], not " << difference);
  for (int i = 0; i < kStakes; ++i) {
    const int tenths = i < kStakes / 2 ? i - kStakes / 2 : i - kStakes / 2 + 1;
    log_wealth_[static_cast<std::size_t>(i)] += std::log1p(0.1 * tenths * difference);
  }
  sum_ += difference;
  ++pairs_;
  most_ = std::max(most_, log_wealth());
  settled_ = settled_ || most_ >= -std::log(alpha_);
}

double SequentialTest::mean() const noexcept {
  return pairs_ > 0 ? sum_ / static_cast<double>(pairs_) : 0.0;
}

double SequentialTest::log_wealth() const noexcept {
  const double largest = *std::max_element(log_wealth_.begin(), log_wealth_.end());
  double sum = 0.0;
  for (const double wealth : log_wealth_) sum += std::exp(wealth - largest);
  return largest + std::log(sum / kStakes);
}

double SequentialTest::p_value() const noexcept { return std::min(1.0, std::exp(-most_)); }

}  // namespace dfr::experiment
