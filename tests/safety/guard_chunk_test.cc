// Chunks of actions, and the explanation of an action that did not pass.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/message_of.h"

// A separate namespace, because sources are compiled together.
namespace dfr::safety::chunk_tests {
namespace {

using control::HaltCause;
using test::Action;
using test::CorridorPlant;
using test::Model;
using testing::HasSubstr;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr int kChunk = 8;

// Returns the same action `count` times.
std::vector<double> Repeated(const std::vector<double>& action, int count) {
  std::vector<double> chunk;
  for (int i = 0; i < count; ++i) chunk.insert(chunk.end(), action.begin(), action.end());
  return chunk;
}

std::span<const double> ActionOf(const std::vector<double>& chunk, int i) {
  return std::span(chunk).subspan(2 * static_cast<std::size_t>(i), 2);
}

// Returns a policy's chunk of actions for `y` of the tip.
using Ask = std::vector<double> (*)(double y);

struct Episode {
  int asked = 0;
  int counted = 0;  // Number of actions counted by chunks.
  int passed = 0;   // Number of these that Filter() then passed.
  double furthest = 0.0;
  double reached = 0.0;
  bool halted = false;
};

// Applies the counted actions. If there are none, applies one action as changed by the guard.
Episode Play(const std::shared_ptr<const GuardModel>& model, double y, Ask ask) {
  Guard guard(model);
  guard.Reset(1);
  CorridorPlant plant;
  plant.x[2] = y;
  Episode episode;
  std::vector<double> safe(2);
  for (int t = 0; plant.x[1] < 1.8 && !episode.halted && t < 100;) {
    const std::vector<double> chunk = ask(plant.x[2]);
    const ChunkVerdict ahead = guard.FilterChunk(t, plant.x, chunk);
    EXPECT_EQ(ahead.cause, HaltCause::kNone);
    EXPECT_EQ(ahead.judged, kChunk);
    ++episode.asked;
    episode.counted += ahead.playable;
    for (int i = 0; i < std::max(1, ahead.playable) && plant.x[1] < 1.8; ++i, ++t) {
      const Verdict verdict = guard.Filter(t, plant.x, ActionOf(chunk, i), safe);
      episode.halted = verdict.mode == control::Mode::kHalt;
      if (i < ahead.playable) episode.passed += verdict.changed ? 0 : 1;
      plant.Apply(safe);
      episode.furthest = std::max(episode.furthest, std::abs(plant.x[2]));
    }
  }
  episode.reached = plant.x[1];
  return episode;
}

// Returns to the middle within the chunk, from the state at the query.
std::vector<double> GoodPolicy(double y) { return Repeated(Action(0.0997, -y / kChunk), kChunk); }
// A policy that does not observe its position.
std::vector<double> DriftingPolicy(double /*y*/) { return Repeated(Action(0.09, 0.06), kChunk); }

TEST(GuardChunkTest, AGoodPolicyThatIsQueriedEveryEightStepsPlaysItsChunks) {
  for (const double y : {-0.05, 0.0, 0.08}) {
    const Episode episode = Play(Model(), y, GoodPolicy);
    EXPECT_GE(episode.reached, 1.8);
    // An episode has 19 steps.
    EXPECT_LE(episode.asked, 4) << y;
    EXPECT_GE(episode.counted, 16) << y;
    EXPECT_EQ(episode.passed, std::min(episode.counted, 19)) << y;
  }
}

TEST(GuardChunkTest, ADriftingPolicyIsQueriedAgainBeforeItsChunkLeaves) {
  const Episode episode = Play(Model(), 0.0, DriftingPolicy);
  EXPECT_FALSE(episode.halted);
  EXPECT_GE(episode.reached, 1.8);
  EXPECT_LT(episode.furthest, 0.5);
  EXPECT_GT(episode.asked, 4);
  EXPECT_GT(episode.counted, 0);
  EXPECT_EQ(episode.passed, episode.counted);
}

// The guard cuts a chunk before the first action that is predicted to end outside.
TEST(GuardChunkTest, CountsUpToTheFirstActionThatLeaves) {
  Guard guard(Model());
  guard.Reset(1);
  const CorridorPlant plant;
  const std::vector<double> inside = Repeated(Action(0.0997, 0.0), kChunk);
  ASSERT_EQ(guard.FilterChunk(0, plant.x, inside).playable, kChunk);
  const std::vector<double> far = Action(0.05, 0.29);
  ASSERT_LT(std::abs(far[0]), guard.model().settings().action_limit[0] * 2.0);
  for (int leaves = 0; leaves < kChunk; ++leaves) {
    std::vector<double> chunk = inside;
    std::copy(far.begin(), far.end(), chunk.begin() + 2 * leaves);
    EXPECT_EQ(guard.FilterChunk(0, plant.x, chunk).playable, leaves);
  }
}

// Filter() passes the first action of a chunk whenever FilterChunk() counts it.
TEST(GuardChunkTest, TheFirstActionIsJudgedAsByTheFilter) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController}) {
    core::Random random(3);
    int counted = 0;
    int refused = 0;
    for (int episode = 0; episode < 40; ++episode) {
      Guard guard(Model(strategy));
      guard.Reset(1);
      CorridorPlant plant;
      std::vector<double> safe(2);
      for (int t = 0; t < 15; ++t) {
        const std::vector<double> action =
            Action(0.1 + 0.02 * random.Normal(), 0.08 * random.Normal());
        const int playable = guard.FilterChunk(t, plant.x, action).playable;
        const Verdict verdict = guard.Filter(t, plant.x, action, safe);
        if (verdict.mode == control::Mode::kHalt) break;
        EXPECT_FALSE(playable == 1 && verdict.changed) << t;
        counted += playable;
        refused += 1 - playable;
        plant.Apply(safe);
      }
    }
    EXPECT_GT(counted, 50);
    EXPECT_GT(refused, 50);
  }
}

TEST(GuardChunkTest, LimitsLengthAndHorizonEndACount) {
  const auto model = Model(Strategy::kMonitor);
  Guard guard(model);
  guard.Reset(1);
  const CorridorPlant plant;
  std::vector<double> chunk = Repeated(Action(0.05, 0.05), kChunk);
  EXPECT_EQ(guard.FilterChunk(0, plant.x, chunk).playable, kChunk);
  chunk[6] = 1.01 * model->settings().action_limit[0];
  EXPECT_EQ(guard.FilterChunk(0, plant.x, chunk).playable, 3);
  const std::vector<double> longest = Repeated(Action(0.0, 0.0), Guard::kLongestChunk + 7);
  EXPECT_EQ(guard.FilterChunk(0, plant.x, longest).judged, Guard::kLongestChunk);
  // The episode ends at the horizon.
  EXPECT_EQ(guard.FilterChunk(0, plant.x, longest).playable, model->settings().horizon);
}

TEST(GuardChunkTest, InvalidInputIsNamedAndDoesNotHalt) {
  Guard guard(Model());
  const std::vector<double> state = {0.0, 0.0, 0.0};
  const std::vector<double> chunk = Repeated(Action(0.0997, 0.0), 3);
  const auto expect = [&](HaltCause cause, int t, const std::vector<double>& x,
                          const std::vector<double>& actions) {
    const ChunkVerdict verdict = guard.FilterChunk(t, x, actions);
    EXPECT_EQ(verdict.cause, cause);
    EXPECT_EQ(verdict.playable, 0);
    EXPECT_EQ(verdict.judged, 0);
  };
  expect(HaltCause::kNotReset, 0, state, chunk);
  guard.Reset(1);
  expect(HaltCause::kStepSkipped, 1, state, chunk);
  expect(HaltCause::kStateInvalid, 0, {0.0, 0.0}, chunk);
  expect(HaltCause::kStateInvalid, 0, {0.0, kNaN, 0.0}, chunk);
  expect(HaltCause::kControlInvalid, 0, state, {});
  expect(HaltCause::kControlInvalid, 0, state, {0.1, 0.1, 0.1});
  expect(HaltCause::kControlInvalid, 0, state, {0.1, 0.1, 0.1, kNaN});
  EXPECT_EQ(guard.FilterChunk(0, state, chunk).playable, 3);
  guard.Stop();
  expect(HaltCause::kStopRequested, 0, state, chunk);
  // Strategies without predictions examine no action.
  guard = Guard(Model(Strategy::kDfr));
  guard.Reset(1);
  expect(HaltCause::kNone, 0, state, chunk);
}

TEST(GuardExplainTest, NamesTheEntryThatEndsOutside) {
  const auto model = Model();
  Guard guard(model);
  guard.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(2);
  const std::vector<double> action = Action(0.09, 0.1);
  int explained = 0;
  for (int t = 0; t < 20; ++t) {
    const Verdict verdict = guard.Filter(t, plant.x, action, safe);
    const std::string why = Explain(*model, verdict, plant.x, action);
    EXPECT_EQ(why.empty(), verdict.source == Source::kPolicy) << t;
    if (verdict.source == Source::kDemonstrations) {
      EXPECT_LT(verdict.predicted, verdict.pass_level);
      EXPECT_THAT(why, HasSubstr("replaced by a demonstrated action: the policy's action"));
      if (why.find("tip[1] is") != std::string::npos) {
        EXPECT_THAT(why, HasSubstr("above what was demonstrated at step"));
        ++explained;
      }
    }
    plant.Apply(safe);
  }
  EXPECT_GT(explained, 3);
}

// The excess is in the entry's unit: removing it leads back to the boundary.
TEST(GuardExplainTest, TheExcessLeadsBackToTheBoundary) {
  const auto model = Model();
  for (const double y : {-0.6, 0.4, 0.8}) {
    std::vector<double> state = {3.0, 0.3, y};
    ASSERT_LT(model->support().Decision(3, state), 0.0);
    const double outside = -model->support().LogDecision(3, state, {});
    const std::vector<OutsideEntry> entries = OutsideEntries(*model, 3, state);
    ASSERT_EQ(entries.size(), 2U);
    EXPECT_EQ(entries[0].entry, 2);
    EXPECT_GT(entries[0].excess * y, 0.0);
    EXPECT_NEAR(entries[0].share + entries[1].share, outside, 1e-9);
    for (const OutsideEntry& entry : entries) {
      state[static_cast<std::size_t>(entry.entry)] -= entry.excess;
    }
    // The path consists of 64 straight pieces and misses the boundary because of its curvature.
    EXPECT_NEAR(model->support().LogDecision(3, state, {}), 0.0, 0.02 * outside);
  }
  EXPECT_TRUE(OutsideEntries(*model, 3, std::vector{3.0, 0.3, 0.0}).empty());
}

TEST(GuardExplainTest, NamesTheDefectOfTheInput) {
  const auto model = Model();
  const std::vector<double> state = {0.0, 0.0, 0.0};
  const std::vector<double> action = Action(0.0997, 0.0);
  const auto why = [&](int t, const std::vector<double>& x, const std::vector<double>& u) {
    Guard guard(model);
    guard.Reset(1);
    std::vector<double> safe(2);
    const Verdict verdict = guard.Filter(t, x, u, safe);
    return Explain(*model, verdict, x, u);
  };
  EXPECT_EQ(why(0, {0.0, 0.0}, action), "halted: the state has 2 entries; the guard needs 3");
  EXPECT_EQ(why(0, {0.0, 0.0, kNaN}, action), "halted: tip[1] of the state is nan");
  EXPECT_EQ(why(0, state, {0.1}), "halted: the action has 1 entries; the guard needs 2");
  EXPECT_EQ(why(0, state, {0.1, kNaN}), "halted: entry 1 of the action is nan");
  EXPECT_EQ(why(3, state, action), "halted: t was not the next one: a call was lost or doubled");
  EXPECT_THAT(why(0, state, {9.0, 0.0}), HasSubstr("entry 0 of the action is 9, beyond its limit"));
  EXPECT_EQ(why(0, state, action), "");
}

TEST(GuardExplainTest, FindsTheNearestDemonstration) {
  const auto model = Model();
  std::vector<core::Matrix> states;
  for (const core::Trajectory& d : test::CorridorDemonstrations(1, 30)) states.push_back(d.states);
  for (const int d : {0, 7, 29}) {
    const NearestDemonstration found =
        Nearest(*model, 5, core::Row(states[static_cast<std::size_t>(d)], 6), states);
    EXPECT_EQ(found.demonstration, d);
    EXPECT_EQ(found.step, 6);
    EXPECT_NEAR(found.distance, 0.0, 1e-12);
  }
  // Ignores states far from the time step, unless no time step is given.
  const auto late = core::Row(states[4], 15);
  EXPECT_GT(Nearest(*model, 3, late, states).distance, 0.1);
  EXPECT_EQ(Nearest(*model, -1, late, states).step, 15);
  EXPECT_EQ(Nearest(*model, 0, late, {}).demonstration, -1);
  // Features that overflow have no distance.
  const std::vector<double> far(3, std::numeric_limits<double>::max());
  const std::vector<core::Matrix> same = {core::AsVector(far).transpose()};
  EXPECT_EQ(Nearest(*model, 0, far, same).demonstration, -1);
  const NearestDemonstration last =
      Nearest(*model, std::numeric_limits<int>::max(), core::Row(states[1], 20), states);
  EXPECT_EQ(last.demonstration, 1);
  EXPECT_EQ(last.step, 20);
  EXPECT_THROW(static_cast<void>(Nearest(*model, 0, std::vector{0.0}, states)),
               std::invalid_argument);
  states[1](3, 1) = kNaN;
  EXPECT_THAT(test::MessageOf<std::invalid_argument>(
                  [&] { static_cast<void>(Nearest(*model, 0, core::Row(states[0], 0), states)); }),
              HasSubstr("demonstration 1 has a non-finite entry in state 3"));
}

}  // namespace
}  // namespace dfr::safety::chunk_tests
