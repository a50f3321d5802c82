#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/constants.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/safety/pictures/picture_corridor.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::safety {
namespace {

using test::kPixel;
using test::kPixels;
using test::kWidth;
using test::PictureDemonstrations;
using test::PictureLayout;
using test::PictureModel;
using test::PointsModel;
using test::StateAt;
using testing::HasSubstr;

TEST(ReducedGuardTest, KeepsADriftingPolicyInsideByPicturesAlone) {
  Guard guard(PictureModel());
  core::Random random(7);
  int completed = 0;
  for (std::uint64_t episode = 0; episode < 5; ++episode) {
    guard.Reset(episode);
    test::CorridorPlant plant;
    const Eigen::Vector2d drift = test::ActionFor(0.09, 0.06);
    double worst = 0.0;
    for (int t = 0; t < 40 && plant.x[1] < 1.7; ++t) {
      std::vector<double> action = {drift[0], drift[1]};
      const Verdict verdict =
          guard.Filter(t, StateAt(plant.x[1], plant.x[2], random), action, action);
      ASSERT_NE(verdict.cause, control::HaltCause::kStateInvalid);
      plant.Apply(action);
      worst = std::max(worst, std::abs(plant.x[2]));
    }
    completed += plant.x[1] >= 1.7 && worst < 0.5 ? 1 : 0;
  }
  EXPECT_GE(completed, 4);  // Without the guard the tip is then at y = 1.2.
}

TEST(ReducedGuardTest, TheSummaryScoresEachNumberOfComponents) {
  const GuardSummary& summary = PictureModel()->summary();
  const int chosen = PictureModel()->reduction()->reduced_dim();
  EXPECT_EQ(std::ranges::count(summary.components, chosen, &reduction::ComponentsScore::components),
            1);
  EXPECT_THAT(summary.components_reason, HasSubstr(std::to_string(chosen) + " components"));
  EXPECT_GE(summary.acceptance, 0.85);
  EXPECT_EQ(PictureModel()->state_dim(), kPixels + 1);
  EXPECT_EQ(PictureModel()->task_layout().state_dim(), chosen);
}

TEST(ReducedGuardTest, AFileKeepsTheReduction) {
  const std::filesystem::path path = dfr::test::ProcessFolder() / "reduced_guard_test.guard";
  PictureModel()->Save(path);
  Guard read = Guard::Load(path);
  std::filesystem::remove(path);
  Guard written(PictureModel());
  EXPECT_EQ(read.model().layout(), written.model().layout());
  EXPECT_EQ(read.model().summary().components.size(), PictureModel()->summary().components.size());
  EXPECT_EQ(read.model().summary().components_reason, PictureModel()->summary().components_reason);
  core::Random random(3);
  read.Reset(1);
  written.Reset(1);
  for (int t = 0; t < 6; ++t) {
    const std::vector<double> state = StateAt(0.1 * t, 0.03 * t, random);
    std::vector<double> a = test::Action(0.09, 0.06);
    std::vector<double> b = a;
    const Verdict first = written.Filter(t, state, a, a);
    EXPECT_EQ(read.Filter(t, state, b, b).g, first.g);
    EXPECT_EQ(a, b);
    EXPECT_TRUE(std::isfinite(first.g));
  }
}

TEST(ReducedGuardTest, FilterAllocatesNothing) {
  for (const auto& model : {PictureModel(), PointsModel()}) {
    Guard guard(model);
    core::Random random(4);
    const std::vector<double> state = StateAt(0.0, 0.0, random);
    std::vector<double> action = test::Action(0.1, 0.0);
    const test::NoAlloc no_alloc;
    guard.Reset(1);
    static_cast<void>(guard.Filter(0, state, action, action));
    static_cast<void>(guard.FilterChunk(1, state, action));
  }
}

TEST(ReducedGuardTest, AnInvalidPictureHaltsWithItsReason) {
  const auto why = [&](const std::vector<double>& state) {
    Guard guard(PictureModel());
    guard.Reset(1);
    const std::vector<double> wish = test::Action(0.1, 0.0);
    std::vector<double> action = wish;
    const Verdict verdict = guard.Filter(0, state, action, action);
    EXPECT_EQ(verdict.cause, control::HaltCause::kStateInvalid);
    EXPECT_EQ(action, std::vector(2, 0.0));
    return Explain(*PictureModel(), verdict, state, wish);
  };
  core::Random random(5);
  std::vector<double> state = StateAt(0.0, 0.0, random);
  state[9] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(why(state), "halted: camera[9] of the state is nan");
  state[9] = 300.0;
  EXPECT_EQ(why(state),
            "halted: camera[9] of the state is 300; a picture has values from 0 to 255");
  std::fill_n(state.begin(), kPixels, 0.0);
  EXPECT_EQ(why(state), "halted: the picture 'camera' is black");
  state.pop_back();
  EXPECT_EQ(why(state), "halted: the state has 96 entries; the guard needs 97");
}

// A bright patch of 3 x 2 pixels in a corner that the tip never visits.
std::vector<double> WithDistractor(std::vector<double> state) {
  for (const int row : {0, 1, 2}) {
    for (const int column : {10, 11})
      state[static_cast<std::size_t>(kWidth) * static_cast<std::size_t>(row) +
            static_cast<std::size_t>(column)] = 250.0;
  }
  return state;
}

TEST(ReducedGuardTest, APictureThatResemblesNoDemonstrationHaltsWithItsReason) {
  core::Random random(11);
  const std::vector<double> ordinary = StateAt(0.1, 0.0, random);
  const std::vector<double> strange = WithDistractor(ordinary);
  const auto model = PointsModel();
  Guard guard(model);
  guard.Reset(1);
  const std::vector<double> wish = test::Action(0.1, 0.0);
  std::vector<double> action = wish;
  EXPECT_EQ(guard.FilterChunk(0, strange, wish).cause, control::HaltCause::kStateInvalid);
  const Verdict verdict = guard.Filter(0, strange, action, action);
  EXPECT_EQ(verdict.cause, control::HaltCause::kStateInvalid);
  EXPECT_TRUE(verdict.alarm);
  EXPECT_EQ(action, std::vector(2, 0.0));
  EXPECT_THAT(Explain(*model, verdict, strange, wish),
              HasSubstr("halted: the picture 'camera' resembles no demonstration: its difference "
                        "from all of them is "));
  guard.Reset(2);
  action = wish;
  EXPECT_NE(guard.Filter(0, ordinary, action, action).cause, control::HaltCause::kStateInvalid);
  Guard monitor(test::As(Strategy::kMonitor, model));
  monitor.Reset(1);
  action = wish;
  const Verdict watched = monitor.Filter(0, strange, action, action);
  EXPECT_TRUE(watched.alarm);
  EXPECT_FALSE(watched.changed);
  EXPECT_EQ(action, wish);
  EXPECT_EQ(monitor.FilterChunk(1, strange, wish).playable, 1);
}

// Only the clock advances.
TEST(ReducedGuardTest, AFrozenPictureHaltsWithItsReasonAfterTheStandstillMargin) {
  const auto model = PictureModel();
  ASSERT_EQ(model->sensor_groups().size(), 1u);
  EXPECT_EQ(model->sensor_groups()[0].longest, 0.0);  // Pictures have noise.
  core::Random random(12);
  std::vector<double> state = StateAt(0.1, 0.0, random);
  const std::vector<double> wish = test::Action(0.1, 0.0);
  for (const bool asks_for_chunks : {false, true}) {
    Guard guard(model);
    guard.Reset(1);
    double steps = 0.0;  // Number of steps since the picture last changed.
    int t = 0;
    for (; steps <= fit::kStandstillMargin; ++t) {
      ASSERT_LT(t, 10);
      state[kPixels] = t;
      for (int i = 0; i < 3 && asks_for_chunks; ++i) {
        EXPECT_NE(guard.FilterChunk(t, state, wish).cause, control::HaltCause::kStateInvalid);
      }
      std::vector<double> action = wish;
      const Verdict verdict = guard.Filter(t, state, action, action);
      ASSERT_EQ(verdict.cause, control::HaltCause::kNone) << Explain(*model, verdict, state, wish);
      EXPECT_EQ(verdict.frozen, -1);
      steps += std::min(1.0, model->actions().Distance(action, std::vector(2, 0.0)));
    }
    EXPECT_GE(t, 4);
    std::vector<double> action = wish;
    EXPECT_EQ(guard.FilterChunk(t, state, wish).cause, control::HaltCause::kStateInvalid);
    const Verdict verdict = guard.Filter(t, state, action, action);
    EXPECT_EQ(verdict.cause, control::HaltCause::kStateInvalid);
    EXPECT_TRUE(verdict.alarm);
    EXPECT_EQ(action, std::vector(2, 0.0));
    EXPECT_NEAR(verdict.unchanged, steps, 1e-12);
    const std::string why = Explain(*model, verdict, state, wish);
    EXPECT_EQ(why, core::Format("halted: the picture 'camera' has not changed for %.0f steps; in "
                                "demonstrations it never stood still for more than 0",
                                steps));
    // The reason remains when the picture changes, until the next episode.
    const std::vector<double> other = StateAt(0.1, 0.0, random);
    EXPECT_EQ(Explain(*model, guard.Filter(t + 1, other, wish, action), other, wish), why);
    guard.Reset(2);
    EXPECT_EQ(guard.Filter(0, state, wish, action).frozen, -1);
  }
}

TEST(ReducedGuardTest, AMonitorRaisesAnAlarmWhileAPictureIsFrozenAndTheRobotMoves) {
  const std::filesystem::path path = dfr::test::ProcessFolder() / "frozen_picture_test.guard";
  test::As(Strategy::kMonitor, PictureModel())->Save(path);
  Guard monitor = Guard::Load(path);
  std::filesystem::remove(path);
  core::Random random(13);
  const std::vector<double> state = StateAt(0.1, 0.0, random);
  const std::vector<double> rest = {0.0, 0.0};
  const std::vector<double> move = test::Action(0.3, 0.0);  // Counts as one step.
  std::vector<double> action(2);
  monitor.Reset(1);
  int t = 0;
  for (; t < 20; ++t) EXPECT_EQ(monitor.Filter(t, state, rest, action).frozen, -1);
  for (const int last = t + 4; t < last; ++t) {
    EXPECT_EQ(monitor.Filter(t, state, move, action).frozen, -1);
  }
  const Verdict frozen = monitor.Filter(t, state, move, action);
  EXPECT_EQ(frozen.frozen, 0);
  EXPECT_EQ(frozen.unchanged, 4.0);
  EXPECT_TRUE(frozen.alarm);
  EXPECT_FALSE(frozen.changed);
  EXPECT_EQ(frozen.cause, control::HaltCause::kNone);
  EXPECT_EQ(monitor.FilterChunk(t + 1, state, move).cause, control::HaltCause::kNone);
  EXPECT_EQ(monitor.Filter(t + 1, StateAt(0.1, 0.0, random), move, action).frozen, -1);
  // Applied() reports that the robot stays at rest.
  monitor.Reset(2);
  for (t = 0; t < 20; ++t) {
    EXPECT_EQ(monitor.Filter(t, state, move, action).frozen, -1);
    monitor.Applied(rest);
  }
}

// Light and noise vary as in the demonstrations of the fit.
TEST(ReducedGuardTest, PicturesOfOtherDemonstrationsResembleThoseOfTheFit) {
  const auto others = PictureDemonstrations(9, 60);
  for (const auto& model : {PointsModel(), PictureModel()}) {
    EXPECT_LE(model->reduction()->novel_left_out().value_or(1.0), 0.05);
    reduction::StateReduction::Workspace workspace(*model->reduction());
    int novel = 0;
    for (const core::Trajectory& d : others) {
      double most = 0.0;
      for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
        ASSERT_TRUE(model->reduction()->Apply(core::Row(d.states, t), workspace));
        most = std::max(most, workspace.novelty());
      }
      novel += most > 1.0 ? 1 : 0;
    }
    EXPECT_LE(novel, 1);
  }
}

TEST(ReducedGuardTest, PixelsThatPutAStateOutsideAreThoseOfTheTip) {
  core::Random random(6);
  const std::vector<double> outside = StateAt(1.0, 0.45, random);
  core::Matrix states(1, kPixels + 1);
  states.row(0) = core::AsVector(outside).transpose();
  const double l = PictureModel()->Levels(states)[0];
  ASSERT_LT(l, -0.5);
  const core::Matrix attribution = Attribution(*PictureModel(), states);
  EXPECT_NEAR(attribution.sum(), -l, 1e-6 * -l);
  EXPECT_EQ(attribution(0, kPixels), 0.0);  // The clock is not a feature.
  // Most of the attribution is in the columns of the tip, x = 1.
  double near = 0.0;
  double all = 0.0;
  for (int i = 0; i < kPixels; ++i) {
    all += std::abs(attribution(0, i));
    if (std::abs(kPixel * (i % kWidth) - 0.1 - 1.0) < 0.55) near += std::abs(attribution(0, i));
  }
  EXPECT_GT(near, 0.7 * all);
}

}  // namespace
}  // namespace dfr::safety
