#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/temp_folder.h"

// Columns of a state that a fit finds to be constants, copies, clocks or sensors.
namespace dfr::safety {
namespace {

using testing::Contains;
using testing::HasSubstr;

// Returns demonstrations of the corridor with further columns in the middle of the state.
std::vector<core::Trajectory> WithColumns(
    std::vector<core::Trajectory> demonstrations,
    const std::function<Eigen::RowVectorXd(const Eigen::RowVectorXd&)>& columns) {
  for (core::Trajectory& d : demonstrations) {
    const Eigen::Index more = columns(d.states.row(0)).size();
    core::Matrix states(d.states.rows(), 3 + more);
    for (Eigen::Index t = 0; t < states.rows(); ++t) {
      states.row(t) << d.states(t, 0), columns(d.states.row(t)), d.states(t, 1), d.states(t, 2);
    }
    d.states = std::move(states);
  }
  return demonstrations;
}

core::StateLayout LayoutWith(int columns) {
  core::StateLayout layout;
  layout.Add("clock", 1);
  layout.Add("more", columns);
  layout.Add("tip", 2);
  return layout;
}

TEST(StateColumnsTest, ConstantColumnsChangeNoBitOfADecision) {
  const auto demonstrations = test::CorridorDemonstrations(3, 30);
  const auto other = test::CorridorDemonstrations(4, 5);
  Eigen::RowVectorXd values = Eigen::RowVector3d(1e6, 0.0, -0.1);
  const auto constant = [&](const Eigen::RowVectorXd&) { return values; };
  const auto plain = GuardModel::Fit(test::CorridorLayout(), demonstrations);
  const auto padded = GuardModel::Fit(LayoutWith(3), WithColumns(demonstrations, constant));
  EXPECT_EQ(padded->num_constants(), 3);
  EXPECT_EQ(padded->summary().gamma, plain->summary().gamma);
  EXPECT_EQ(padded->settings().alarm_level, plain->settings().alarm_level);
  Guard one(plain);
  Guard two(padded);
  const auto padded_other = WithColumns(other, constant);
  int changed = 0;
  for (std::size_t d = 0; d < other.size(); ++d) {
    one.Reset(d);
    two.Reset(d);
    for (int t = 0; t < other[d].num_steps(); ++t) {
      // The second half of the actions leads outside.
      const std::vector<double> u = {other[d].controls(t, 0),
                                     t < 10 ? other[d].controls(t, 1) : 0.1};
      std::vector<double> a(2);
      std::vector<double> b(2);
      const Verdict first = one.Filter(t, core::Row(other[d].states, t), u, a);
      const Verdict second = two.Filter(t, core::Row(padded_other[d].states, t), u, b);
      EXPECT_EQ(a, b);
      EXPECT_EQ(first.g, second.g);
      EXPECT_EQ(first.alarm, second.alarm);
      changed += first.changed ? 1 : 0;
    }
  }
  EXPECT_GT(changed, 0);
}

TEST(StateColumnsTest, AConstantThatChangesHaltsWithItsReason) {
  const auto columns = [](double value) {
    return [value](const Eigen::RowVectorXd&) { return Eigen::RowVector2d(-0.5, value); };
  };
  const auto demonstrations = test::CorridorDemonstrations(3, 30);
  const auto fitted = GuardModel::Fit(LayoutWith(2), WithColumns(demonstrations, columns(200.0)));
  const std::filesystem::path path = dfr::test::ProcessFolder() / "constant_columns_test.guard";
  fitted->Save(path);
  const auto model = GuardModel::Load(path);
  std::filesystem::remove(path);
  const auto cause_at = [&](double value, const GuardModel& guarded, std::string& why) {
    const core::Matrix states = WithColumns(demonstrations, columns(value))[0].states;
    Guard guard(guarded.With(guarded.settings()));
    guard.Reset(1);
    const std::vector<double> wish = test::Action(0.1, 0.0);
    std::vector<double> action = wish;
    const Verdict verdict = guard.Filter(0, core::Row(states, 0), action, action);
    EXPECT_EQ(verdict.alarm, std::abs(value - 200.0) > 0.2);
    why = Explain(guarded, verdict, core::Row(states, 0), wish);
    return verdict.cause;
  };
  std::string why;
  // A change by less than a thousandth does not halt.
  EXPECT_EQ(cause_at(200.1, *model, why), control::HaltCause::kNone);
  EXPECT_EQ(cause_at(201.0, *model, why), control::HaltCause::kStateInvalid);
  EXPECT_EQ(why,
            "halted: more[1] of the state is 201, unlike in all demonstrations, where it is "
            "constant");
  EXPECT_EQ(cause_at(201.0, *test::As(Strategy::kMonitor, model), why), control::HaltCause::kNone);
}

// A sensor that is read in every third step.
TEST(StateColumnsTest, AStateMayStandStillTwiceAsLongAsDemonstratedAndThreeSteps) {
  auto demonstrations = test::CorridorDemonstrations(3, 30, 21);
  const ActionSpace space(demonstrations);
  double longest = 0.0;
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) d.states.row(t) = d.states.row(t - t % 3);
    for (Eigen::Index t = 0; t < d.controls.rows(); t += 3) {
      longest = std::max(longest, space.StepOf(core::Row(d.controls, t)) +
                                      space.StepOf(core::Row(d.controls, t + 1)));
    }
  }
  EXPECT_GT(longest, 1.0);
  EXPECT_LE(longest, 2.0);
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                     {.features = "tip", .accept_any = true});
  ASSERT_EQ(model->sensor_groups().size(), 1u);
  const SensorGroup& group = model->sensor_groups()[0];
  ASSERT_EQ(group.ranges.size(), 1u);
  EXPECT_EQ(group.ranges[0].first, 1);
  EXPECT_EQ(group.ranges[0].size, 2);
  EXPECT_NEAR(group.longest, longest, 1e-12);
  EXPECT_NEAR(group.limit(), 2.0 * longest + 3.0, 1e-12);

  const std::vector<double> wish = test::Action(0.3, 0.0);  // Counts as one step.
  std::vector<double> state = {0.0, 0.0, 0.0};
  std::vector<double> action(2);
  Guard monitor(test::As(Strategy::kMonitor, model));
  monitor.Reset(1);
  Verdict verdict;
  for (int t = 0; t < 9; ++t) {
    state[0] = t;  // The clock, which is not a feature.
    verdict = monitor.Filter(t, state, wish, action);
    EXPECT_EQ(verdict.frozen, t > 2.0 * longest + 3.0 ? 0 : -1) << t;
  }
  verdict.source = Source::kHalt;
  verdict.cause = control::HaltCause::kStateInvalid;
  EXPECT_EQ(Explain(*model, verdict, state, wish),
            core::Format("halted: tip[0:2] has not changed for 8 steps; in demonstrations it never "
                         "stood still for more than %.3g",
                         longest));
}

TEST(StateColumnsTest, AClockDoesNotHideAStateThatStandsStill) {
  core::Random random(8);
  auto demonstrations = test::IrregularDemonstrations(30, random);
  const auto first_entry = [&] {
    return GuardModel::Fit(test::CorridorLayout(), demonstrations, {.accept_any = true})
        ->sensor_groups()
        .at(0)
        .ranges.at(0)
        .first;
  };
  EXPECT_EQ(first_entry(), 1);
  for (core::Trajectory& d : demonstrations) d.states.col(0).array() += 1e4 * random.Normal();
  EXPECT_EQ(first_entry(), 1);
  // The phase of a cycle is an angle.
  for (core::Trajectory& d : demonstrations) {
    const double begin = random.Uniform();
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      d.states(t, 0) = std::remainder(begin + 0.7 * static_cast<double>(t), 2.0 * std::numbers::pi);
    }
  }
  EXPECT_EQ(first_entry(), 1);
  // An entry that advances with the actions is not a clock.
  for (core::Trajectory& d : demonstrations) d.states.col(0) = 2.0 * d.states.col(1);
  EXPECT_EQ(first_entry(), 0);
}

TEST(StateColumnsTest, ColumnsThatRepeatAnotherAreNamed) {
  const auto demonstrations = test::CorridorDemonstrations(3, 30);
  const auto copied = WithColumns(demonstrations, [](const Eigen::RowVectorXd& x) {
    return Eigen::RowVector2d(x[2], 4.0 - 57.3 * x[1]);
  });
  const auto model =
      GuardModel::Fit(LayoutWith(2), copied, {.features = "more,tip", .accept_any = true});
  EXPECT_THAT(model->summary().fit_warnings,
              Contains(HasSubstr("tip[0] by more[1], tip[1] by more[0]. They count twice")));
}

}  // namespace
}  // namespace dfr::safety
