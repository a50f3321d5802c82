#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <memory>
#include <numbers>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/onnx_export.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::safety {
namespace {

using control::HaltCause;
using control::Mode;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

constexpr double kPi = std::numbers::pi;

// The corridor, with a tool that turns about z by kTurnRate per step and slightly about other axes.
// Actions have a third entry, the turn. `rotation` writes the angle as entries of the state.
constexpr double kTurnRate = 0.06;
using Writer = std::function<std::vector<double>(double angle, core::Random& random)>;

std::vector<core::Trajectory> Turning(const Writer& rotation, std::uint64_t seed, int count,
                                      double begin, double rate = kTurnRate) {
  core::Random random(seed);
  // `rotation` has a separate generator and does not change the other random numbers.
  core::Random own(seed + 1000);
  auto corridor = test::CorridorDemonstrations(seed, count);
  for (core::Trajectory& d : corridor) {
    const Eigen::Index steps = d.controls.rows();
    d.controls.conservativeResize(steps, 3);
    core::Matrix states(steps + 1, 0);
    double angle = begin + 0.1 * random.Normal();
    for (Eigen::Index t = 0; t <= steps; ++t) {
      const std::vector<double> entries = rotation(angle, own);
      if (t == 0) states.resize(steps + 1, 2 + std::ssize(entries));
      states.row(t).head(2) = d.states.row(t).tail(2);
      states.row(t).tail(std::ssize(entries)) = core::AsVector(std::span(entries)).transpose();
      if (t == steps) break;
      d.controls(t, 2) = rate + 0.02 * random.Normal();
      angle += d.controls(t, 2);
    }
    d.states = states;
  }
  return corridor;
}

core::StateLayout Layout(const std::string& name, int size) {
  core::StateLayout layout;
  layout.Add("tip", 2);
  layout.Add(name, size);
  return layout;
}

std::vector<double> Quaternion(double angle, double sign) {
  return {sign * std::cos(angle / 2.0), 0.0, 0.0, sign * std::sin(angle / 2.0)};
}
std::vector<double> Plain(double angle, core::Random& /*random*/) { return Quaternion(angle, 1.0); }
std::vector<double> Flipped(double angle, core::Random& random) {
  return Quaternion(angle, random.Uniform() < 0.3 ? -1.0 : 1.0);
}
std::vector<double> Wrapped(double angle, core::Random& /*random*/) {
  return {angle - 2.0 * kPi * std::round(angle / (2.0 * kPi))};
}

void Flip(Eigen::Ref<core::Matrix> quaternions) { quaternions *= -1.0; }

// Returns a model of quaternions with both signs, fitted once.
std::shared_ptr<const GuardModel> QuaternionModel() {
  static const auto kModel = GuardModel::Fit(Layout("quat", 4), Turning(Flipped, 1, 30, 0.3));
  return kModel;
}

// Returns a model of an angle that makes 2.2 revolutions, fitted once.
std::shared_ptr<const GuardModel> RevolvingModel() {
  static const auto kModel = GuardModel::Fit(Layout("angle", 1), Turning(Wrapped, 1, 30, 0.3, 0.7));
  return kModel;
}

TEST(ContinuousStatesTest, AQuaternionAndItsNegativeAreOneOrientation) {
  const auto model = QuaternionModel();
  // Recordings with other signs give the same model.
  const auto same = GuardModel::Fit(Layout("quat", 4), Turning(Plain, 1, 30, 0.3));
  EXPECT_GT(model->summary().acceptance, 0.7);
  const auto fresh = Turning(Plain, 2, 5, 0.3);
  for (const core::Trajectory& d : fresh) {
    core::Matrix flipped = d.states;
    Flip(flipped.rightCols(4));
    EXPECT_EQ(model->Levels(d.states), model->Levels(flipped));
    EXPECT_EQ(model->Levels(d.states), same->Levels(d.states));
    EXPECT_EQ(Attribution(*model, d.states), Attribution(*model, flipped));
    const auto row = core::Row(d.states, 3);
    const auto other = core::Row(flipped, 3);
    EXPECT_EQ(model->Certify(3, row, core::Row(d.controls, 3)).margin,
              model->Certify(3, other, core::Row(d.controls, 3)).margin);
    EXPECT_EQ(model->support().Decision(3, row), model->support().Decision(3, other));
    std::vector<double> gradient(6);
    std::vector<double> mirrored(6);
    model->support().Gradient(3, row, gradient);
    model->support().Gradient(3, other, mirrored);
    EXPECT_EQ(gradient[0], mirrored[0]);
    EXPECT_EQ(gradient[2], -mirrored[2]);
  }
}

TEST(ContinuousStatesTest, FilterGivesTheSameBitsForBothSignsAndAllocatesNothing) {
  const auto model = QuaternionModel();
  Guard ours(model);
  Guard theirs(model);
  ours.Reset(1);
  theirs.Reset(1);
  const auto fresh = Turning(Plain, 3, 1, 0.3)[0];
  std::vector<double> safe(3);
  std::vector<double> same(3);
  for (int t = 0; t < fresh.num_steps(); ++t) {
    core::Matrix flipped = fresh.states.row(t);
    if (t % 3 != 0) Flip(flipped.rightCols(4));
    Verdict a;
    {
      const test::NoAlloc none;
      a = ours.Filter(t, core::Row(fresh.states, t), core::Row(fresh.controls, t), safe);
    }
    const Verdict b = theirs.Filter(t, core::Row(flipped, 0), core::Row(fresh.controls, t), same);
    ASSERT_NE(a.mode, Mode::kHalt) << a.reason();
    ASSERT_EQ(safe, same);
    ASSERT_EQ(a.g, b.g);
    ASSERT_EQ(a.alarm, b.alarm);
    ASSERT_EQ(a.mode, b.mode);
    ASSERT_EQ(a.entry, -1);
  }
}

// An orientation is judged in the same way at every norm that does not halt the guard.
TEST(ContinuousStatesTest, ANormNearOneChangesNoJudgement) {
  const auto model = QuaternionModel();
  const auto fresh = Turning(Plain, 3, 1, 0.3)[0];
  const std::vector<double> levels = model->Levels(fresh.states);
  for (const double length : {0.91, 1.0 + 1e-4, 1.09}) {
    core::Matrix scaled = fresh.states;
    scaled.rightCols(4) *= length;
    const std::vector<double> same = model->Levels(scaled);
    for (std::size_t t = 0; t < levels.size(); ++t) ASSERT_NEAR(levels[t], same[t], 1e-9);
    Guard exact(model);
    Guard off(model);
    exact.Reset(1);
    off.Reset(1);
    std::vector<double> safe(3);
    std::vector<double> near(3);
    for (int t = 0; t < fresh.num_steps(); ++t) {
      const Verdict a =
          exact.Filter(t, core::Row(fresh.states, t), core::Row(fresh.controls, t), safe);
      const Verdict b = off.Filter(t, core::Row(scaled, t), core::Row(fresh.controls, t), near);
      ASSERT_EQ(a.mode, b.mode) << t;
      ASSERT_EQ(a.alarm, b.alarm) << t;
      ASSERT_NEAR(a.level, b.level, 1e-9) << t;
    }
  }
}

TEST(ContinuousStatesTest, AQuaternionOfAnotherNormHaltsWithItsEntry) {
  const auto model = QuaternionModel();
  const auto fresh = Turning(Plain, 3, 1, 0.3)[0];
  for (const double length : {0.0, 0.85, 1.15}) {
    Guard guard(model);
    guard.Reset(1);
    std::vector<double> safe(3);
    core::Matrix state = fresh.states.row(0);
    state.rightCols(4) *= length;
    Guard monitor(test::As(Strategy::kMonitor, model));
    for (Guard* const judge : {&guard, &monitor}) {
      judge->Reset(1);
      const ChunkVerdict chunk =
          judge->FilterChunk(0, core::Row(state, 0), core::Row(fresh.controls, 0));
      EXPECT_EQ(chunk.playable, 0);
      EXPECT_EQ(chunk.cause, HaltCause::kBadQuaternion);
    }
    Verdict verdict = guard.Filter(0, core::Row(state, 0), core::Row(fresh.controls, 0), safe);
    EXPECT_EQ(verdict.mode, Mode::kHalt);
    EXPECT_EQ(verdict.cause, HaltCause::kBadQuaternion);
    EXPECT_STREQ(verdict.reason(), "quaternion-invalid");
    EXPECT_EQ(verdict.entry, 2);
    EXPECT_EQ(safe, std::vector<double>(3, 0.0));
    // The halt lasts until the next episode.
    verdict = guard.Filter(1, core::Row(fresh.states, 0), core::Row(fresh.controls, 0), safe);
    EXPECT_EQ(verdict.cause, HaltCause::kBadQuaternion);
    EXPECT_EQ(verdict.entry, 2);
    guard.Reset(1);
    verdict = guard.Filter(0, core::Row(fresh.states, 0), core::Row(fresh.controls, 0), safe);
    EXPECT_NE(verdict.mode, Mode::kHalt);
    EXPECT_EQ(verdict.entry, -1);
  }
}

void ExpectNearOnEveryRevolution(const GuardModel& model, const core::Matrix& states) {
  core::Matrix later = states;
  later.col(2).array() += 4.0 * kPi;
  const std::vector<double> levels = model.Levels(states);
  const std::vector<double> others = model.Levels(later);
  for (std::size_t i = 0; i < levels.size(); ++i) EXPECT_NEAR(levels[i], others[i], 1e-9);
  EXPECT_GT(*std::min_element(levels.begin(), levels.end()), -1.0);
}

// The angle turns from 2.6 to 3.8 rad and therefore wraps once.
TEST(ContinuousStatesTest, AnAngleThatWrapsIsContinuousOnEveryRevolution) {
  const auto model = GuardModel::Fit(Layout("angle", 1), Turning(Wrapped, 1, 30, 2.6));
  EXPECT_GT(model->summary().acceptance, 0.7);
  EXPECT_THAT(Warnings(*model), Not(Contains(HasSubstr("angle[0]"))));
  ExpectNearOnEveryRevolution(*model, Turning(Wrapped, 2, 1, 2.6)[0].states);
}

// The same orientation on any revolution is the same state.
TEST(ContinuousStatesTest, AnAngleOverSeveralRevolutionsIsContinuous) {
  const auto model = RevolvingModel();
  EXPECT_EQ(model->task().features().num_features(), 4);
  EXPECT_GT(model->summary().acceptance, 0.7);
  EXPECT_THAT(Warnings(*model), Not(Contains(HasSubstr("angle[0]"))));
  const auto fresh = Turning(Wrapped, 2, 1, 0.3, 0.7)[0];
  ExpectNearOnEveryRevolution(*model, fresh.states);

  // The gradient in the angle equals a difference quotient of g, and an explanation names the
  // angle.
  std::vector<double> state(core::Row(fresh.states, 4).begin(), core::Row(fresh.states, 4).end());
  std::vector<double> gradient(3);
  const double g = model->support().Gradient(4, state, gradient);
  state[2] += 1e-6;
  EXPECT_NEAR((model->support().Decision(4, state) - g) / 1e-6, gradient[2], 1e-3);
  for (const double turned : {2.2, -2.2}) {
    state[2] = fresh.states(4, 2) + turned;
    const auto outside = OutsideEntries(*model, 4, state);
    ASSERT_EQ(outside.size(), 3u);
    const auto angle = std::ranges::find(outside, 2, &OutsideEntry::entry);
    ASSERT_NE(angle, outside.end());
    EXPECT_GT(angle->share, 0.0);
    EXPECT_GT(angle->excess * turned, 0.0);
  }
}

// A double cannot represent an angle of 1e30 revolutions.
TEST(ContinuousStatesTest, AnAngleThatNoRobotReportsHaltsWithItsEntry) {
  const auto centred = GuardModel::Fit(Layout("angle", 1), Turning(Wrapped, 1, 30, 2.6));
  const auto constant = GuardModel::Fit(
      Layout("angle", 1),
      Turning([](double,
                 core::Random& random) { return std::vector{random.Uniform() < 0.5 ? kPi : -kPi}; },
              1, 30, 0.3));
  EXPECT_EQ(constant->num_constants(), 1);
  for (const auto& model : {RevolvingModel(), centred, constant}) {
    EXPECT_EQ(model->Periods(), (std::vector{0.0, 0.0, 2.0 * kPi}));
    for (const double revolutions : {1e5, -1e5, 1.1e6, -1.1e6, 1e30, 1e307}) {
      SCOPED_TRACE(revolutions);
      const bool legal = std::abs(revolutions) < 1e6;
      const std::vector<double> state = {0.0, 0.0, 2.0 * kPi * revolutions + kPi};
      const std::vector<double> wish = test::Action(0.05, 0.0);
      const std::vector<double> action = {wish[0], wish[1], 0.1};
      std::vector<double> safe(3);
      Guard guard(test::As(Strategy::kMonitor, model));
      guard.Reset(1);
      const ChunkVerdict chunk = guard.FilterChunk(0, state, action);
      EXPECT_EQ(chunk.cause, legal ? HaltCause::kNone : HaltCause::kStateInvalid);
      const Verdict verdict = guard.Filter(0, state, action, safe);
      EXPECT_EQ(verdict.cause, legal ? HaltCause::kNone : HaltCause::kStateInvalid);
      if (legal) continue;
      EXPECT_EQ(safe, std::vector<double>(3, 0.0));
      EXPECT_THAT(
          Explain(*model, verdict, state, action),
          testing::MatchesRegex("halted: angle\\[0\\] of the state is .*e\\+.*, more than a "
                                "million revolutions from zero"));
    }
  }
}

// An axis with two speeds turns an angle. Its jumps do not make it a gripper.
TEST(ContinuousStatesTest, AnAxisThatTurnsAWrappedAngleIsSteered) {
  core::Random random(6);
  std::vector<core::Trajectory> plain = test::CorridorDemonstrations(2, 20, 24);
  for (core::Trajectory& d : plain) {
    core::Matrix states(d.states.rows(), 3);
    states.leftCols(2) = d.states.rightCols(2);
    d.controls.conservativeResize(Eigen::NoChange, 3);
    double yaw = 0.2 * random.Uniform();
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      states(t, 2) = yaw;
      if (t == d.controls.rows()) break;
      d.controls(t, 2) = random.Uniform() < 0.75 ? 0.3 : 0.0;
      yaw += d.controls(t, 2);
    }
    d.states = states;
  }
  std::vector<core::Trajectory> wrapped = plain;
  for (core::Trajectory& d : wrapped) {
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      d.states(t, 2) = std::remainder(d.states(t, 2), 2.0 * kPi);
    }
  }
  for (const auto& demonstrations : {plain, wrapped}) {
    const auto model = GuardModel::Fit(Layout("yaw", 1), demonstrations, {.accept_any = true});
    EXPECT_EQ(model->actions().steered_dim(), 3);
    EXPECT_EQ(model->context(), nullptr);
    EXPECT_THAT(Warnings(*model), Not(Contains(HasSubstr("few demonstrated values"))));
  }
}

TEST(ContinuousStatesTest, RotationsThatJumpCauseAWarning) {
  const auto jumping = Turning(Flipped, 1, 30, 0.3, 0.5);
  const auto spun = GuardModel::Fit(Layout("quat", 4), jumping, {.accept_any = true});
  EXPECT_THAT(Warnings(*spun), Contains(HasSubstr("quat[0:4] is a unit quaternion with")));
  const auto blind = GuardModel::Fit(Layout("quat", 4), jumping, {.features = "tip"});
  EXPECT_THAT(Warnings(*blind), Not(Contains(HasSubstr("quat"))));
  // An entry that no feature uses may have any value.
  Guard guard(blind);
  guard.Reset(1);
  std::vector<double> safe(3);
  const auto fresh = Turning(Plain, 3, 1, 0.3)[0];
  core::Matrix state = fresh.states.row(0);
  state.rightCols(4).setZero();
  EXPECT_NE(guard.Filter(0, core::Row(state, 0), core::Row(fresh.controls, 0), safe).mode,
            Mode::kHalt);
}

TEST(ContinuousStatesTest, AFileKeepsRotationsAndWarnings) {
  const auto path = dfr::test::ProcessFolder() / "continuous_states.guard";
  const core::Matrix turned = Turning(Flipped, 2, 1, 0.3)[0].states;
  const core::Matrix revolved = Turning(Wrapped, 2, 1, 0.3, 0.7)[0].states;
  for (const auto& [model, states] :
       {std::pair(QuaternionModel(), turned), {RevolvingModel(), revolved}}) {
    model->Save(path);
    const auto loaded = GuardModel::Load(path);
    EXPECT_EQ(loaded->Levels(states), model->Levels(states));
    EXPECT_EQ(Warnings(*loaded), Warnings(*model));
  }
  std::filesystem::remove(path);
}

// A tool that points down: its roll is pi or -pi, and its quaternion has either sign.
TEST(ContinuousStatesTest, AFileKeepsOneOrientationInTwoNotations) {
  const auto path = dfr::test::ProcessFolder() / "constant_rotation.guard";
  const auto roll = [](double, core::Random& random) {
    return std::vector{random.Uniform() < 0.5 ? kPi : -kPi};
  };
  const auto quaternion = [](double, core::Random& random) {
    return Quaternion(1.0, random.Uniform() < 0.5 ? 1.0 : -1.0);
  };
  for (const auto& [name, rotation] : {std::pair<const char*, Writer>("roll", roll),
                                       std::pair<const char*, Writer>("quat", quaternion)}) {
    SCOPED_TRACE(name);
    const auto recorded = Turning(rotation, 1, 30, 0.3);
    const auto size = static_cast<int>(recorded[0].states.cols()) - 2;
    const auto model = GuardModel::Fit(Layout(name, size), recorded);
    EXPECT_EQ(model->num_constants(), size);
    model->Save(path);
    Guard ours(model);
    Guard theirs(GuardModel::Load(path));
    ours.Reset(1);
    theirs.Reset(1);
    const auto fresh = Turning(rotation, 2, 1, 0.3)[0];
    std::vector<double> safe(3);
    std::vector<double> same(3);
    for (int t = 0; t < fresh.num_steps(); ++t) {
      const auto state = core::Row(fresh.states, t);
      const Verdict a = ours.Filter(t, state, core::Row(fresh.controls, t), safe);
      const Verdict b = theirs.Filter(t, state, core::Row(fresh.controls, t), same);
      ASSERT_NE(a.cause, HaltCause::kStateInvalid) << t;
      ASSERT_EQ(a.cause, b.cause) << t;
      ASSERT_EQ(a.alarm, b.alarm) << t;
      ASSERT_EQ(safe, same) << t;
    }
  }
  std::filesystem::remove(path);
}

TEST(ContinuousStatesTest, ExportsOfRotationsAreRefused) {
  for (const auto& [model, name] :
       {std::pair(QuaternionModel(), "quat[0:4]"), {RevolvingModel(), "the angle angle[0]"}}) {
    EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] { CheckExport(*model); }),
                HasSubstr(name));
  }
}

}  // namespace
}  // namespace dfr::safety
