#include "dfr/control/rollout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

#include "dfr/control/published/switching_controller.h"
#include "tests/control/analytic.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

using core::Outcome;
using test::PointPlant;

// The learned policy moves by 0.25 along the first axis.
class RolloutTest : public testing::Test {
 protected:
  SwitchingController Make(Recovery recovery, double lambda = 1.0, int horizon = 10) const {
    return {policy, ball, lambda, {.recovery = recovery, .horizon = horizon}};
  }
  test::FunctionSupport ball = test::UnitBall(2);
  test::FunctionPolicy policy = test::ConstantPolicy(2, 0.25);
};

TEST_F(RolloutTest, ACollisionDuringAProbeCounts) {
  // The wall is nearer than the length of a probe. The first probe outwards hits it.
  constexpr double kFrom = 0.9;
  bool in_probe = false;
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    PointPlant plant({.start = {kFrom, 0.0}, .wall = kFrom + 1e-9});
    auto dfr = Make(Recovery::kDfr);
    const RolloutResult result = Rollout(plant, dfr, {.controller_seed = seed});
    if (result.outcome != Outcome::kCollided || result.last_mode != Mode::kProbe) continue;
    in_probe = true;
    EXPECT_EQ(result.probes, result.recovery_steps + 1);
    EXPECT_EQ(result.policy_steps, 0);
  }
  EXPECT_TRUE(in_probe);
}

TEST_F(RolloutTest, CountsRecoveriesAndTheirControls) {
  // At x_0 = 0.76 the gate g > 0.25 is closed, and it opens after some iterations. The learned
  // control then moves right to where the gate is closed. This repeats until the time is up.
  PointPlant plant({.start = {0.76, 0.0}});
  auto dfr = Make(Recovery::kDfr, 1.0, 3);
  struct Counter final : RolloutObserver {
    int policy = 0, probes = 0, steps = 0, recoveries = 0;
    bool recovering = false;
    void OnControl(const RolloutEvent& event) override {
      const bool now = event.step.mode != Mode::kPolicy;
      recoveries += now && !recovering ? 1 : 0;
      recovering = now;
      policy += event.step.mode == Mode::kPolicy ? 1 : 0;
      probes += event.step.mode == Mode::kProbe ? 1 : 0;
      steps += event.step.mode == Mode::kRecovery ? 1 : 0;
    }
  } counter;
  const RolloutResult result = Rollout(plant, dfr, {.controller_seed = 2}, &counter);
  EXPECT_GE(result.recoveries, 1);
  EXPECT_EQ(result.recoveries, counter.recoveries);
  EXPECT_EQ(result.policy_steps, counter.policy);
  EXPECT_EQ(result.probes, counter.probes);
  EXPECT_EQ(result.recovery_steps, counter.steps);
  EXPECT_EQ(result.recovery_controls(), counter.probes + counter.steps);
  EXPECT_EQ(result.controls(), plant.applied);
}

// Alternates between steps of three kinds: a control that passes, a changed one, and one of a
// recovery.
class Changing final : public Controller {
 public:
  int state_dim() const noexcept override { return 2; }
  int control_dim() const noexcept override { return 2; }

 private:
  void DoReset(std::uint64_t) noexcept override { count_ = 0; }
  Step DoNext(std::span<const double>, std::span<double>) noexcept override {
    const Step steps[] = {{.mode = Mode::kPolicy},
                          {.mode = Mode::kPolicy, .filtered = true, .change = 0.5},
                          {.mode = Mode::kRecovery, .change = 2.0}};
    return steps[count_++ % 3];
  }
  int count_ = 0;
};

TEST_F(RolloutTest, SumsTheMeasuredChangesOfControls) {
  PointPlant plant({});
  Changing controller;
  const RolloutResult result = Rollout(plant, controller, {.max_controls = 8});
  EXPECT_EQ(result.changed_steps, 3);
  EXPECT_EQ(result.changed_controls(), 5);
  EXPECT_EQ(result.sized_changes, 5);
  EXPECT_EQ(result.change, 3 * 0.5 + 2 * 2.0);
}

struct Ending {
  const char* what;
  test::PointPlantOptions plant;
  Outcome outcome;
  HaltCause cause;
  int controls;
};

TEST_F(RolloutTest, AnEpisodeEndsForItsFirstReason) {
  constexpr auto kNone = HaltCause::kNone;
  const std::vector<double> far = {2.0, 0.0};
  const Ending endings[] = {
      {"at the goal", {.goal = 0.75}, Outcome::kCompleted, kNone, 3},
      {"beyond the goal at the start", {.start = far, .goal = 1.0}, Outcome::kCompleted, kNone, 0},
      {"beyond the wall at the start", {.start = far, .wall = 1.0}, Outcome::kCollided, kNone, 0},
      {"a wall on the way", {.wall = 0.6, .goal = 0.75}, Outcome::kCollided, kNone, 3},
      {"a wall at the goal", {.wall = 0.7, .goal = 0.75}, Outcome::kCollided, kNone, 3},
      {"a fault at the wall", {.wall = 0.6, .fault_at = 2}, Outcome::kCollided, kNone, 3},
      // The control may have been applied.
      {"a fault", {.fault_at = 2}, Outcome::kHalted, HaltCause::kPlantFault, 3},
      {"a fault at the goal",
       {.goal = 0.75, .fault_at = 2},
       Outcome::kHalted,
       HaltCause::kPlantFault,
       3},
      {"a refusal", {.refuse_at = 2}, Outcome::kHalted, HaltCause::kPlantRefused, 2},
      {"the end of the time", {}, Outcome::kHalted, HaltCause::kTimeUp, 10},
  };
  auto baseline = Make(Recovery::kNone);
  std::vector<double> u(2);
  for (const Ending& ending : endings) {
    SCOPED_TRACE(ending.what);
    PointPlant plant(ending.plant);
    const RolloutResult result = Rollout(plant, baseline, {});
    EXPECT_EQ(result.outcome, ending.outcome);
    EXPECT_EQ(result.halt_cause, ending.cause);
    EXPECT_EQ(result.controls(), ending.controls);
    EXPECT_EQ(result.policy_steps, ending.controls);
    EXPECT_EQ(result.recoveries, 0);
    EXPECT_EQ(result.last_mode == Mode::kPolicy, ending.controls > 0);
    EXPECT_EQ(plant.halts, 1);
    if (ending.cause == kNone) continue;
    // Further calls of the controller have no effect.
    u.assign(2, 1.0);
    EXPECT_EQ(baseline.Next(plant.x, u).cause, ending.cause);
    EXPECT_THAT(u, testing::Each(0.0));
  }
}

TEST_F(RolloutTest, StopsAtTheLimitOfControls) {
  PointPlant plant({});
  auto baseline = Make(Recovery::kNone);
  const RolloutResult result = Rollout(plant, baseline, {.max_controls = 5});
  EXPECT_EQ(result.outcome, Outcome::kHalted);
  EXPECT_EQ(result.halt_cause, HaltCause::kControlLimit);
  EXPECT_EQ(plant.applied, 5);
  EXPECT_EQ(Rollout(plant, baseline, {}).last_step.t, 10) << "the controller's own end";
  EXPECT_EQ(plant.halts, 1) << "of this rollout";
}

TEST_F(RolloutTest, TheObserverReceivesEveryControlWithItsEffect) {
  struct Recorder final : RolloutObserver {
    std::vector<double> start;
    std::vector<double> x, next_x, u;
    int ends = 0;
    RolloutResult end;
    void OnStart(std::span<const double> state) override {
      start.assign(state.begin(), state.end());
    }
    void OnControl(const RolloutEvent& event) override {
      x.push_back(event.x[0]);
      u.push_back(event.u[0]);
      next_x.push_back(event.next_x[0]);
      EXPECT_EQ(event.step.mode, Mode::kPolicy);
      EXPECT_EQ(event.completed, event.next_x[0] >= 0.75);
    }
    void OnEnd(const RolloutResult& result) override {
      ++ends;
      end = result;
    }
  } recorder;
  PointPlant plant({.goal = 0.75});
  auto baseline = Make(Recovery::kNone);
  Rollout(plant, baseline, {}, &recorder);
  EXPECT_THAT(recorder.start, testing::ElementsAre(0.0, 0.0));
  EXPECT_THAT(recorder.x, testing::ElementsAre(0.0, 0.25, 0.5));
  EXPECT_THAT(recorder.u, testing::Each(0.25));
  EXPECT_THAT(recorder.next_x, testing::ElementsAre(0.25, 0.5, 0.75));
  EXPECT_EQ(recorder.ends, 1);
  EXPECT_EQ(recorder.end.outcome, Outcome::kCompleted);
}

TEST_F(RolloutTest, ThePlantIsHaltedWhenAnObserverThrows) {
  struct Thrower final : RolloutObserver {
    void OnControl(const RolloutEvent&) override { throw std::runtime_error("disk full"); }
  } thrower;
  PointPlant plant({});
  auto baseline = Make(Recovery::kNone);
  EXPECT_THROW(Rollout(plant, baseline, {}, &thrower), std::runtime_error);
  EXPECT_EQ(plant.halts, 1);
}

TEST_F(RolloutTest, TheSeedsDecideEverything) {
  PointPlant plant({.start = {0.76, 0.0}, .turns = true});
  auto dfr = Make(Recovery::kDfr);
  const auto end = [&](std::uint64_t plant_seed, std::uint64_t controller_seed) {
    Rollout(plant, dfr, {.plant_seed = plant_seed, .controller_seed = controller_seed});
    return plant.x;
  };
  const std::vector<double> first = end(1, 2);
  EXPECT_NE(end(3, 2), first);
  EXPECT_NE(end(1, 3), first);
  EXPECT_EQ(end(1, 2), first);
}

TEST_F(RolloutTest, NeverAllocatesWithAWorkspace) {
  PointPlant plant({.start = {0.76, 0.0}});
  RolloutWorkspace workspace;
  for (const Recovery recovery : {Recovery::kNone, Recovery::kEarlyStopping, Recovery::kDfr}) {
    auto controller = Make(recovery);
    Rollout(plant, controller, {}, nullptr, &workspace);
    const test::NoAlloc guard;
    Rollout(plant, controller, {}, nullptr, &workspace);
  }
}

TEST_F(RolloutTest, CpuTimeIsSplitIntoPlantAndDecision) {
  // The policy takes much processor time and the plant takes almost none.
  const test::FunctionPolicy slow(2, 2, [](int, std::span<const double>, std::span<double> u) {
    volatile double sum = 0.0;
    for (int i = 0; i < 100'000; ++i) sum = sum + i;
    u[0] = u[1] = 0.0;
  });
  SwitchingController baseline(slow, ball, 1.0, {.recovery = Recovery::kNone, .horizon = 20});
  PointPlant plant({});
  const RolloutResult result = Rollout(plant, baseline, {});
  EXPECT_GT(result.decision_seconds, 10.0 * result.plant_seconds);
  EXPECT_GT(result.plant_seconds, 0.0);
  EXPECT_EQ(result.seconds(), result.plant_seconds + result.decision_seconds);
}

TEST_F(RolloutTest, RefusesSizesThatDoNotFit) {
  PointPlant plant({.start = {0.0, 0.0, 0.0}});
  auto baseline = Make(Recovery::kNone);
  EXPECT_THROW(Rollout(plant, baseline, {}), std::invalid_argument);
  PointPlant fitting({});
  EXPECT_THROW(Rollout(fitting, baseline, {.max_controls = 0}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::control
