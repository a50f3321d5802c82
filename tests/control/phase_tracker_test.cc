#include "dfr/control/phase_tracker.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/control/analytic.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr int kLineSteps = 40;

// l_t(x) = log 2 - (x - speed t)^2: B_t is |x - speed t| <= 0.8326.
test::GaussianSupport Line(double speed) { return {{{0.0}}, 1.0, 0.5, {speed}, kLineSteps}; }

// In phase 5, phase q fits a state x with -(x - q)^2, minus .05 per phase of distance from the next
// phase, 6: x = 7.3 is best at 7, x = 5.4 at 5. Earlier phases and those more than three ahead
// are ignored.
TEST(PhaseTrackerTest, AMissedSupportAdvancesToTheBestPhaseAhead) {
  const auto support = Line(1.0);
  const auto advanced = [&](double x, bool may_wait) {
    PhaseTracker tracker(support);
    tracker.Reset(5);
    tracker.Wait();
    const std::vector<double> z = {x};
    tracker.Advance(z, support.LogDecision(6, z, {}), may_wait);
    EXPECT_EQ(tracker.waited(), tracker.phase() == 5 ? 2 : 0);
    return tracker.phase();
  };
  EXPECT_EQ(advanced(7.3, true), 7);
  EXPECT_EQ(advanced(5.4, true), 5);
  EXPECT_EQ(advanced(5.47, true), 5);
  EXPECT_EQ(advanced(5.48, true), 6) << "the present phase fits better by .04, too little to wait";
  EXPECT_EQ(advanced(6.52, true), 6) << "the same ahead";
  EXPECT_EQ(advanced(6.53, true), 7);
  EXPECT_EQ(advanced(2.0, true), 5);
  EXPECT_EQ(advanced(30.0, true), 8);
  EXPECT_EQ(advanced(5.4, false), 6);
  EXPECT_EQ(advanced(2.0, false), 6);
  EXPECT_EQ(advanced(7.3, false), 7);
  EXPECT_EQ(advanced(30.0, false), 8);
}

TEST(PhaseTrackerTest, ThePhaseWaitsIfItFitsBest) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  for (int i = 1; i <= 20; ++i) {
    tracker.Advance(std::vector{-1.0}, std::log(2.0) - 4.0, true);
    EXPECT_EQ(tracker.waited(), i);
  }
  EXPECT_EQ(tracker.phase(), 0);
}

TEST(PhaseTrackerTest, BeyondTheLastSupportThePhaseWaitsOrAdvancesByOne) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  for (const int phase : {kLineSteps - 1, kLineSteps + 2}) {
    tracker.Reset(phase);
    tracker.Advance(std::vector{1.0 * kLineSteps}, -1.0, true);
    EXPECT_EQ(tracker.phase(), phase) << "there is nothing ahead";
    EXPECT_EQ(tracker.waited(), 1);
    tracker.Advance(std::vector{1.0 * kLineSteps}, -1.0, false);
    EXPECT_EQ(tracker.phase(), phase + 1);
    EXPECT_EQ(tracker.waited(), 0);
  }
}

TEST(PhaseTrackerTest, ANonFinitePredictionWaitsOrAdvancesByOne) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  tracker.Reset(5);
  tracker.Advance(std::vector{std::nan("")}, std::nan(""), true);
  EXPECT_EQ(tracker.phase(), 5);
  EXPECT_EQ(tracker.waited(), 1);
  tracker.Advance(std::vector{std::nan("")}, std::nan(""), false);
  EXPECT_EQ(tracker.phase(), 6);
}

TEST(PhaseTrackerTest, ResetStartsAnEpisode) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  tracker.Wait();
  tracker.Reset(7);
  EXPECT_EQ(tracker.phase(), 7);
  EXPECT_EQ(tracker.waited(), 0);
  EXPECT_NEAR(tracker.Follow(std::vector{7.0}), std::log(2.0), 1e-15);
  EXPECT_EQ(tracker.phase(), 7) << "the first state is that of the first phase";
  tracker.Reset();
  EXPECT_EQ(tracker.phase(), 0);
  (void)tracker.Follow(std::vector{0.0});
  EXPECT_EQ(tracker.phase(), 0);
}

TEST(PhaseTrackerTest, RelocatesToTheSupportThatContainsTheStateMostDeeply) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  tracker.Reset(30);
  tracker.Wait();
  EXPECT_FALSE(tracker.Relocate(std::vector{-1.0})) << "0.83 is the half width";
  EXPECT_FALSE(tracker.Relocate(std::vector{std::nan("")}));
  EXPECT_EQ(tracker.phase(), 30);
  EXPECT_EQ(tracker.waited(), 1);
  EXPECT_TRUE(tracker.Relocate(std::vector{5.4}));
  EXPECT_EQ(tracker.phase(), 5);
  EXPECT_EQ(tracker.waited(), 0);
  EXPECT_TRUE(tracker.Relocate(std::vector{39.2}));
  EXPECT_EQ(tracker.phase(), 39);
}

// The episode advances by `pace` phases per step.
TEST(PhaseTrackerTest, FollowsAnyPace) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  for (const double pace : {1.0, 2.0, 0.5, 3.0}) {
    SCOPED_TRACE(pace);
    tracker.Reset();
    for (int i = 0; pace * i < kLineSteps - 1; ++i) {
      const double l = tracker.Follow(std::vector{pace * i});
      EXPECT_NEAR(tracker.phase(), pace * i, 0.5 + 1e-12) << i;
      EXPECT_GE(l, std::log(2.0) - 0.25 - 1e-12) << "no support fits better";
    }
  }
}

TEST(PhaseTrackerTest, FollowsAPauseAndContinuesAfterIt) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  tracker.Reset();
  for (int i = 0; i <= 5; ++i) (void)tracker.Follow(std::vector{1.0 * i});
  for (int i = 0; i < 10; ++i) {
    EXPECT_NEAR(tracker.Follow(std::vector{5.0}), std::log(2.0), 1e-15);
    EXPECT_EQ(tracker.phase(), 5) << i;
  }
  (void)tracker.Follow(std::vector{6.0});
  EXPECT_EQ(tracker.phase(), 6);
}

// The support is the same at all times: the phase advances by one per state, up to the last.
TEST(PhaseTrackerTest, ATieAdvancesThePhaseByOne) {
  const auto support = Line(0.0);
  PhaseTracker tracker(support);
  tracker.Reset();
  for (int i = 0; i < kLineSteps + 5; ++i) {
    (void)tracker.Follow(std::vector{0.1});
    EXPECT_EQ(tracker.phase(), std::min(i, kLineSteps - 1));
  }
}

// Phases gain 0.1 each in the direction of time. A phase to the side costs 0.05, so the farthest
// phase of the window wins. With a gain of 0.04 none wins.
TEST(PhaseTrackerTest, MovesWithinItsWindowAndOnlyForABetterFit) {
  class Slope final : public core::LogDecisionFunction {
   public:
    explicit Slope(double gain) : gain_(gain) {}
    int state_dim() const noexcept override { return 1; }
    int num_steps() const noexcept override { return kLineSteps; }
    double Decision(int, std::span<const double>) const noexcept override { return 1.0; }
    double Gradient(int, std::span<const double>, std::span<double>) const noexcept override {
      return 1.0;
    }
    double LogDecision(int t, std::span<const double> x,
                       std::span<double>) const noexcept override {
      return x[0] + gain_ * t;
    }
    double FromLog(int, double l) const noexcept override { return l; }
    double lipschitz_bound(int) const noexcept override { return 1.0; }
    double curvature_bound(int) const noexcept override { return 1.0; }

   private:
    double gain_;
  };
  const std::vector<double> inside = {5.0};
  const auto followed = [&](double gain) {
    const Slope support(gain);
    PhaseTracker tracker(support);
    tracker.Reset(10);
    const double l = tracker.Follow(inside);
    EXPECT_NEAR(l, 5.0 + gain * tracker.phase(), 1e-12);
    return tracker.phase();
  };
  EXPECT_EQ(followed(0.1), 10 + PhaseTracker::kWindow);
  EXPECT_EQ(followed(-0.1), 10 - PhaseTracker::kWindow);
  EXPECT_EQ(followed(0.04), 10);
  EXPECT_EQ(followed(-0.04), 10);
  const auto entered = [&](double gain) {
    const Slope support(gain);
    PhaseTracker tracker(support);
    tracker.Reset(10);
    const double l = tracker.Enter(inside);
    EXPECT_NEAR(l, 5.0 + gain * tracker.phase(), 1e-12);
    return tracker.phase();
  };
  EXPECT_EQ(entered(0.1), 10 + PhaseTracker::kWindow);
  // One phase earlier: the phase may have advanced with the previous control.
  EXPECT_EQ(entered(-0.1), 10 - PhaseTracker::kWindow - 1);
  EXPECT_EQ(entered(0.04), 10);
}

TEST(PhaseTrackerTest, ANonFiniteStateAdvancesThePhaseByOne) {
  // Returns -infinity for a nonfinite entry, as every support of the library does.
  class Strict final : public core::LogDecisionFunction {
   public:
    int state_dim() const noexcept override { return 1; }
    int num_steps() const noexcept override { return line_.num_steps(); }
    double Decision(int t, std::span<const double> x) const noexcept override {
      return std::isfinite(x[0]) ? line_.Decision(t, x) : -kInfinity;
    }
    double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
      return line_.Gradient(t, x, g);
    }
    double LogDecision(int t, std::span<const double> x,
                       std::span<double> g) const noexcept override {
      return std::isfinite(x[0]) ? line_.LogDecision(t, x, g) : -kInfinity;
    }
    double FromLog(int t, double l) const noexcept override { return line_.FromLog(t, l); }
    double lipschitz_bound(int t) const noexcept override { return line_.lipschitz_bound(t); }
    double curvature_bound(int t) const noexcept override { return line_.curvature_bound(t); }

   private:
    test::GaussianSupport line_ = Line(1.0);
  };
  const Strict support;
  PhaseTracker tracker(support);
  tracker.Reset(3);
  (void)tracker.Follow(std::vector{3.0});
  EXPECT_EQ(tracker.Follow(std::vector{std::nan("")}), -kInfinity);
  EXPECT_EQ(tracker.phase(), 4);
  EXPECT_EQ(tracker.Follow(std::vector{kInfinity}), -kInfinity);
  EXPECT_EQ(tracker.phase(), 5);
  EXPECT_NEAR(tracker.Follow(std::vector{6.0}), std::log(2.0), 1e-15);
  EXPECT_EQ(tracker.phase(), 6);
  EXPECT_EQ(tracker.Enter(std::vector{std::nan("")}), -kInfinity);
  EXPECT_EQ(tracker.phase(), 6);
}

TEST(PhaseTrackerTest, EntersTheBestPhaseThatContainsTheState) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  for (const double x : {6.0, 7.4, 8.0, 10.0, 12.0, 13.0}) {
    SCOPED_TRACE(x);
    tracker.Reset(10);
    const double l = tracker.Enter(std::vector{x});
    EXPECT_EQ(tracker.phase(), std::lround(x));
    EXPECT_NEAR(l, std::log(2.0) - std::pow(x - std::lround(x), 2), 1e-12);
  }
}

TEST(PhaseTrackerTest, StaysIfNoNearbyPhaseContainsTheState) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  for (const double x : {5.1, 13.9, 30.0}) {
    SCOPED_TRACE(x);
    tracker.Reset(10);
    EXPECT_NEAR(tracker.Enter(std::vector{x}), std::log(2.0) - (x - 10.0) * (x - 10.0), 1e-9);
    EXPECT_LT(tracker.Enter(std::vector{x}), 0.0);
    EXPECT_EQ(tracker.phase(), 10);
  }
  // The window starts at phase 0.
  tracker.Reset(1);
  EXPECT_GE(tracker.Enter(std::vector{-0.5}), 0.0);
  EXPECT_EQ(tracker.phase(), 0);
}

TEST(PhaseTrackerTest, NeverAllocates) {
  const auto support = Line(1.0);
  PhaseTracker tracker(support);
  std::vector<double> x = {0.0};
  const test::NoAlloc guard;
  for (int i = 0; i < 100; ++i) {
    x[0] = 0.7 * i;
    (void)tracker.Follow(x);
    (void)tracker.Enter(x);
    tracker.Advance(x, -1.0, i % 2 == 0);
    tracker.Advance();
    tracker.Reset(i);
  }
}

}  // namespace
}  // namespace dfr::control
