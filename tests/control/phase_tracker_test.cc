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

class PhaseTrackerTest : public testing::Test {
 protected:
  const test::GaussianSupport support_ = Line(1.0);
  PhaseTracker tracker_{support_};
};

// In phase 5, the fit of phase q to a state x is -(x - q)^2 minus .05 |q - 6|, because 6 is the
// next phase. Phase 7 fits x = 7.3 best, and phase 5 fits x = 5.4 best. Phases before 5 and after 8
// are ignored.
TEST_F(PhaseTrackerTest, AMissedSupportAdvancesToTheBestPhaseAhead) {
  const auto advanced = [&](double x, bool may_wait) {
    tracker_.Reset(5);
    tracker_.Wait();
    const std::vector<double> z = {x};
    tracker_.Advance(z, support_.LogDecision(6, z, {}), may_wait);
    EXPECT_EQ(tracker_.waited(), tracker_.phase() == 5 ? 2 : 0);
    return tracker_.phase();
  };
  EXPECT_EQ(advanced(7.3, true), 7);
  EXPECT_EQ(advanced(5.4, true), 5);
  EXPECT_EQ(advanced(5.47, true), 5);
  EXPECT_EQ(advanced(5.48, true), 6) << "the present phase fits better by .04, too little to wait";
  EXPECT_EQ(advanced(6.52, true), 6) << "phase 7 fits better by .04, too little to skip a phase";
  EXPECT_EQ(advanced(6.53, true), 7);
  EXPECT_EQ(advanced(2.0, true), 5);
  EXPECT_EQ(advanced(30.0, true), 8);
  EXPECT_EQ(advanced(5.4, false), 6);
  EXPECT_EQ(advanced(2.0, false), 6);
  EXPECT_EQ(advanced(7.3, false), 7);
  EXPECT_EQ(advanced(30.0, false), 8);
}

TEST_F(PhaseTrackerTest, BeyondTheLastSupportThePhaseWaitsOrAdvancesByOne) {
  for (const int phase : {kLineSteps - 1, kLineSteps + 2}) {
    tracker_.Reset(phase);
    tracker_.Advance(std::vector{1.0 * kLineSteps}, -1.0, true);
    EXPECT_EQ(tracker_.phase(), phase) << "no support is ahead";
    EXPECT_EQ(tracker_.waited(), 1);
    tracker_.Advance(std::vector{1.0 * kLineSteps}, -1.0, false);
    EXPECT_EQ(tracker_.phase(), phase + 1);
    EXPECT_EQ(tracker_.waited(), 0);
  }
}

TEST_F(PhaseTrackerTest, ANonFinitePredictionWaitsOrAdvancesByOne) {
  tracker_.Reset(5);
  tracker_.Advance(std::vector{std::nan("")}, std::nan(""), true);
  EXPECT_EQ(tracker_.phase(), 5);
  EXPECT_EQ(tracker_.waited(), 1);
  tracker_.Advance(std::vector{std::nan("")}, std::nan(""), false);
  EXPECT_EQ(tracker_.phase(), 6);
}

TEST_F(PhaseTrackerTest, ResetStartsAnEpisode) {
  tracker_.Wait();
  tracker_.Reset(7);
  EXPECT_EQ(tracker_.phase(), 7);
  EXPECT_EQ(tracker_.waited(), 0);
  EXPECT_NEAR(tracker_.Follow(std::vector{7.0}), std::log(2.0), 1e-15);
  EXPECT_EQ(tracker_.phase(), 7) << "the first state belongs to the phase of Reset()";
  tracker_.Reset();
  EXPECT_EQ(tracker_.phase(), 0);
  (void)tracker_.Follow(std::vector{0.0});
  EXPECT_EQ(tracker_.phase(), 0);
}

TEST_F(PhaseTrackerTest, RelocatesToTheSupportThatContainsTheStateMostDeeply) {
  tracker_.Reset(30);
  tracker_.Wait();
  EXPECT_FALSE(tracker_.Relocate(std::vector{-1.0})) << "0.83 is the half width";
  EXPECT_FALSE(tracker_.Relocate(std::vector{std::nan("")}));
  EXPECT_EQ(tracker_.phase(), 30);
  EXPECT_EQ(tracker_.waited(), 1);
  EXPECT_TRUE(tracker_.Relocate(std::vector{5.4}));
  EXPECT_EQ(tracker_.phase(), 5);
  EXPECT_EQ(tracker_.waited(), 0);
  EXPECT_TRUE(tracker_.Relocate(std::vector{39.2}));
  EXPECT_EQ(tracker_.phase(), 39);
}

// The episode advances by `pace` phases per step.
TEST_F(PhaseTrackerTest, FollowsAnyPace) {
  for (const double pace : {1.0, 2.0, 0.5, 3.0}) {
    SCOPED_TRACE(pace);
    tracker_.Reset();
    for (int i = 0; pace * i < kLineSteps - 1; ++i) {
      const double l = tracker_.Follow(std::vector{pace * i});
      EXPECT_NEAR(tracker_.phase(), pace * i, 0.5 + 1e-12) << i;
      EXPECT_GE(l, std::log(2.0) - 0.25 - 1e-12) << "no support fits better";
    }
  }
}

TEST_F(PhaseTrackerTest, FollowsAPauseAndContinuesAfterIt) {
  tracker_.Reset();
  for (int i = 0; i <= 5; ++i) (void)tracker_.Follow(std::vector{1.0 * i});
  for (int i = 0; i < 10; ++i) {
    EXPECT_NEAR(tracker_.Follow(std::vector{5.0}), std::log(2.0), 1e-15);
    EXPECT_EQ(tracker_.phase(), 5) << i;
  }
  (void)tracker_.Follow(std::vector{6.0});
  EXPECT_EQ(tracker_.phase(), 6);
}

// The support is the same at all times: the phase advances by one per state, up to the last.
TEST_F(PhaseTrackerTest, ATieAdvancesThePhaseByOne) {
  const auto still = Line(0.0);
  PhaseTracker follower(still);
  follower.Reset();
  const std::vector<double> x = {0.1};
  const test::NoAlloc guard;
  for (int i = 0; i < kLineSteps + 5; ++i) {
    (void)follower.Follow(x);
    EXPECT_EQ(follower.phase(), std::min(i, kLineSteps - 1));
  }
}

// Each phase fits better than the previous one by `gain`, and each phase of distance costs 0.05.
// With a gain of 0.1 the farthest phase of the window has the best score. With a gain of 0.04 the
// present phase has the best score.
TEST_F(PhaseTrackerTest, MovesWithinItsWindowAndOnlyForABetterFit) {
  const auto moved = [](double gain, bool enters) {
    const test::FunctionLogSupport slope(
        kLineSteps, 1.0,
        [gain](int t, std::span<const double> x, std::span<double>) { return x[0] + gain * t; });
    PhaseTracker climber(slope);
    climber.Reset(10);
    const std::vector<double> inside = {5.0};
    const double l = enters ? climber.Enter(inside) : climber.Follow(inside);
    EXPECT_NEAR(l, 5.0 + gain * climber.phase(), 1e-12);
    return climber.phase();
  };
  EXPECT_EQ(moved(0.1, false), 10 + PhaseTracker::kWindow);
  EXPECT_EQ(moved(-0.1, false), 10 - PhaseTracker::kWindow);
  EXPECT_EQ(moved(0.04, false), 10);
  EXPECT_EQ(moved(-0.04, false), 10);
  EXPECT_EQ(moved(0.1, true), 10 + PhaseTracker::kWindow);
  // The window begins one phase earlier, because the phase may have advanced with the last control.
  EXPECT_EQ(moved(-0.1, true), 10 - PhaseTracker::kWindow - 1);
  EXPECT_EQ(moved(0.04, true), 10);
}

TEST_F(PhaseTrackerTest, ANonFiniteStateAdvancesThePhaseByOne) {
  // Returns -infinity for a non-finite entry, as every support of the library does.
  const test::FunctionLogSupport strict(
      kLineSteps, 1.0, [this](int t, std::span<const double> x, std::span<double> g) {
        return std::isfinite(x[0]) ? support_.LogDecision(t, x, g) : -kInfinity;
      });
  PhaseTracker follower(strict);
  follower.Reset(3);
  (void)follower.Follow(std::vector{3.0});
  EXPECT_EQ(follower.Follow(std::vector{std::nan("")}), -kInfinity);
  EXPECT_EQ(follower.phase(), 4);
  EXPECT_EQ(follower.Follow(std::vector{kInfinity}), -kInfinity);
  EXPECT_EQ(follower.phase(), 5);
  EXPECT_NEAR(follower.Follow(std::vector{6.0}), std::log(2.0), 1e-15);
  EXPECT_EQ(follower.phase(), 6);
  EXPECT_EQ(follower.Enter(std::vector{std::nan("")}), -kInfinity);
  EXPECT_EQ(follower.phase(), 6);
}

TEST_F(PhaseTrackerTest, EntersTheBestPhaseThatContainsTheState) {
  for (const double x : {6.0, 7.4, 8.0, 10.0, 12.0, 13.0}) {
    SCOPED_TRACE(x);
    tracker_.Reset(10);
    const double l = tracker_.Enter(std::vector{x});
    EXPECT_EQ(tracker_.phase(), std::lround(x));
    EXPECT_NEAR(l, std::log(2.0) - std::pow(x - std::lround(x), 2), 1e-12);
  }
}

TEST_F(PhaseTrackerTest, StaysIfNoNearbyPhaseContainsTheState) {
  for (const double x : {5.1, 13.9, 30.0}) {
    SCOPED_TRACE(x);
    tracker_.Reset(10);
    EXPECT_NEAR(tracker_.Enter(std::vector{x}), std::log(2.0) - (x - 10.0) * (x - 10.0), 1e-9);
    EXPECT_LT(tracker_.Enter(std::vector{x}), 0.0);
    EXPECT_EQ(tracker_.phase(), 10);
  }
  // The window never begins before phase 0.
  tracker_.Reset(1);
  EXPECT_GE(tracker_.Enter(std::vector{-0.5}), 0.0);
  EXPECT_EQ(tracker_.phase(), 0);
}

}  // namespace
}  // namespace dfr::control
