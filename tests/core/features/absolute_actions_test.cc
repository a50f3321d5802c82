#include "dfr/core/features/absolute_actions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <span>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::core {
namespace {

using testing::HasSubstr;

// Episodes of 60 steps, in which a point moves from a random start to a random goal. `act` computes
// the action and the next position from the present position and the goal. `observe` computes the
// state.
struct World {
  std::function<void(const Eigen::Vector2d& x, const Eigen::Vector2d& goal, Random& random,
                     Eigen::Vector2d& action, Eigen::Vector2d& next)>
      act;
  std::function<std::vector<double>(const Eigen::Vector2d& x, const Eigen::Vector2d& goal,
                                    const Eigen::Vector2d& last_action)>
      observe = [](const auto& x, const auto&, const auto&) {
        return std::vector<double>{x[0], x[1]};
      };
};

Eigen::Vector2d Normal2(Random& random) { return {random.Normal(), random.Normal()}; }

std::vector<Trajectory> RollOut(const World& world) {
  Random random(1);
  std::vector<Trajectory> set;
  for (int i = 0; i < 20; ++i) {
    Eigen::Vector2d x = Normal2(random);
    const Eigen::Vector2d goal = Normal2(random);
    Eigen::Vector2d u = Eigen::Vector2d::Zero();
    Trajectory episode;
    constexpr int kSteps = 60;
    std::vector<double> state = world.observe(x, goal, u);
    episode.states.resize(kSteps + 1, static_cast<Eigen::Index>(state.size()));
    episode.controls.resize(kSteps, 2);
    std::copy(state.begin(), state.end(), episode.states.row(0).data());
    for (int t = 0; t < kSteps; ++t) {
      Eigen::Vector2d next;
      world.act(x, goal, random, u, next);
      x = next;
      std::copy(u.begin(), u.end(), episode.controls.row(t).data());
      state = world.observe(x, goal, u);
      std::copy(state.begin(), state.end(), episode.states.row(t + 1).data());
    }
    set.push_back(std::move(episode));
  }
  return set;
}

World Targets(double lag, double noise = 0.0) {
  return {.act = [=](const auto& x, const auto& goal, Random& random, auto& u, auto& next) {
    u = x + 0.1 * (goal - x) + noise * Normal2(random);
    next = x + lag * (u - x);
  }};
}

World Velocities(double gain) {
  return {.act = [=](const auto& x, const auto& goal, Random& random, auto& u, auto& next) {
    u = gain * (goal - x) + 0.01 * Normal2(random);
    next = x + 0.1 * u;
  }};
}

TEST(AbsoluteActionsTest, FindsTargetsThatTheStateFollowsAtOnceOrLate) {
  for (const double lag : {1.0, 0.5}) {
    for (const double noise : {0.0, 0.02}) {
      const auto found = FindAbsoluteActions(RollOut(Targets(lag, noise)));
      ASSERT_EQ(found.size(), 2u) << "lag " << lag << ", noise " << noise;
      for (int k = 0; k < 2; ++k) {
        const AbsoluteAction& match = found[static_cast<std::size_t>(k)];
        EXPECT_EQ(match.action, k);
        EXPECT_EQ(match.state, k);
        EXPECT_TRUE(match.leads);
        EXPECT_GT(match.correlation, 0.99);
        EXPECT_NEAR(match.slope, 1.0, 0.1);
      }
    }
  }
}

TEST(AbsoluteActionsTest, FindsActionsThatRepeatTheState) {
  const World world{.act = [](const auto& x, const auto& goal, Random&, auto& u, auto& next) {
    u = x;
    next = x + 0.1 * (goal - x);
  }};
  auto set = RollOut(world);
  const auto found = FindAbsoluteActions(set);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_FALSE(found[0].leads);
  const Matrix states = set[0].states;
  ToDifferences(found, set[0]);
  EXPECT_EQ(set[0].controls, states.bottomRows(60) - states.topRows(60));
}

TEST(AbsoluteActionsTest, DifferencesAreTheDistanceToTheTarget) {
  auto set = RollOut(Targets(0.5));
  const Trajectory before = set[3];
  ToDifferences(FindAbsoluteActions(set), set[3]);
  EXPECT_EQ(set[3].controls, before.controls - before.states.topRows(60));
  EXPECT_EQ(set[3].states, before.states);
  for (auto& episode : set) {
    if (&episode != &set[3]) ToDifferences(std::vector<AbsoluteAction>{{0, 0}, {1, 1}}, episode);
  }
  EXPECT_TRUE(FindAbsoluteActions(set).empty());
}

// The second action may have any unit: ticks per second beside radians per second, for example.
TEST(AbsoluteActionsTest, UnitsOfOtherActionsChangeNoVerdict) {
  World world = Velocities(1.0);
  world.observe = [](const auto& x, const auto&, const auto& last) {
    return std::vector<double>{x[0], x[1], last[0]};
  };
  for (const double unit : {1e-8, 1.0, 1e6, 1e8}) {
    auto set = RollOut(world);
    Random random(3);
    for (Trajectory& episode : set) {
      for (double& velocity : episode.states.col(2)) velocity += 0.01 * random.Normal();
      episode.controls.col(1) *= unit;
      episode.states.col(1) *= unit;
    }
    EXPECT_TRUE(FindAbsoluteActions(set).empty()) << unit;
  }
}

// The target and the angle cross the end of the period in different steps.
TEST(AbsoluteActionsTest, DifferencesOfAnglesAreModuloTheirPeriod) {
  for (const double period : {2.0 * std::numbers::pi, 360.0}) {
    for (const double lag : {1.0, 0.5}) {
      SCOPED_TRACE(lag);
      auto plain = RollOut(Targets(lag, 0.02));
      auto set = plain;
      const auto wrap = [&](double value) { return std::remainder(value, period); };
      for (std::size_t i = 0; i < set.size(); ++i) {
        for (Matrix* values : {&plain[i].states, &plain[i].controls}) {
          values->col(0) = 0.5 * period + 0.1 * period * values->col(0).array();
        }
        set[i] = plain[i];
        set[i].states.col(0) = set[i].states.col(0).unaryExpr(wrap);
        set[i].controls.col(0) = set[i].controls.col(0).unaryExpr(wrap);
      }
      const auto found = FindAbsoluteActions(set);
      ASSERT_EQ(found.size(), 2u);
      EXPECT_EQ(found[0].period, period);
      EXPECT_EQ(found[1].period, 0.0);
      for (std::size_t i = 0; i < set.size(); ++i) {
        ToDifferences(found, set[i]);
        EXPECT_LE((set[i].controls - plain[i].controls + plain[i].states.topRows(60))
                      .cwiseAbs()
                      .maxCoeff(),
                  1e-12 * period);
      }
    }
  }
}

TEST(AbsoluteActionsTest, DifferencesOfARepeatedAngleAreModuloItsPeriod) {
  auto set = RollOut(Targets(1.0));
  for (Trajectory& episode : set) {
    for (double& x : episode.states.reshaped()) x = std::remainder(3.0 + x, 2.0 * std::numbers::pi);
    episode.controls = episode.states.topRows(60);
  }
  const auto found = FindAbsoluteActions(set);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_FALSE(found[0].leads);
  for (Trajectory& episode : set) {
    ToDifferences(found, episode);
    EXPECT_LT(episode.controls.cwiseAbs().maxCoeff(), 1.0);
  }
}

TEST(AbsoluteActionsTest, VelocitiesAreNotTargets) {
  for (const double gain : {0.3, 1.0, 3.0}) {
    EXPECT_TRUE(FindAbsoluteActions(RollOut(Velocities(gain))).empty()) << gain;
  }
  World world = Velocities(1.0);
  world.observe = [](const auto& x, const auto&, const auto& last) {
    return std::vector<double>{x[0], x[1], last[0], last[1]};
  };
  EXPECT_TRUE(FindAbsoluteActions(RollOut(world)).empty()) << "beside the last action";
  // A proportional policy with gain 1 returns the distance to the goal.
  world.observe = [](const auto& x, const auto& goal, const auto&) {
    return std::vector<double>{x[0], x[1], goal[0] - x[0], goal[1] - x[1]};
  };
  EXPECT_TRUE(FindAbsoluteActions(RollOut(world)).empty()) << "beside the distance to the goal";
}

// Velocities act `delay` steps later, through saturating motors. The state has the last `delay`
// actions, as a guard's warning advises. Actions before the start are zero.
std::vector<Trajectory> Late(int delay) {
  Random random(3);
  std::vector<Trajectory> set;
  for (int i = 0; i < 20; ++i) {
    constexpr int kSteps = 60;
    Trajectory episode;
    episode.states = Matrix::Zero(kSteps + 1, 2 + 2 * delay);
    episode.controls.resize(kSteps, 2);
    Eigen::RowVector2d x = Normal2(random).transpose();
    const Eigen::RowVector2d goal = 2.0 * Normal2(random).transpose();
    for (int t = 0; t <= kSteps; ++t) {
      auto state = episode.states.row(t);
      state.head(2) = x;
      for (int past = 1; past <= std::min(delay, t); ++past) {
        state.segment(2 * past, 2) = episode.controls.row(t - past);
      }
      if (t == kSteps) break;
      episode.controls.row(t) = 0.2 * (goal - x) + 0.02 * Normal2(random).transpose();
      if (t >= delay) {
        x += 0.1 * (episode.controls.row(t - delay).array() / 0.3).tanh().matrix();
      }
    }
    set.push_back(std::move(episode));
  }
  return set;
}

// FindAbsoluteActions() still finds the targets if the state has a further entry that moves by
// itself, or that another action moves.
TEST(AbsoluteActionsTest, TargetsBesideOtherActionsAreFound) {
  const auto targets =
      RollOut({.act = [](const auto& x, const auto& goal, Random& random, auto& u, auto& next) {
        u = x + 0.15 * (goal - x) + 0.01 * Normal2(random);
        next = x + 0.9 * (u - x);
      }});
  // The third entry moves by rate + turn, where turn is the third action.
  const auto with = [&](double rate, const std::function<double(Random&)>& turn) {
    Random random(2);
    auto set = targets;
    for (Trajectory& episode : set) {
      episode.states.conservativeResize(Eigen::NoChange, 3);
      episode.controls.conservativeResize(Eigen::NoChange, 3);
      episode.states(0, 2) = 0.05 * random.Normal();
      for (Eigen::Index t = 0; t < episode.controls.rows(); ++t) {
        const double turned = turn(random);
        episode.controls(t, 2) = rate == 0.0 ? turned : 1.0;
        episode.states(t + 1, 2) = episode.states(t, 2) + rate + turned;
      }
    }
    return FindAbsoluteActions(set).size();
  };
  // A conveyor beside a closed gripper.
  EXPECT_EQ(with(0.02, [](Random& random) { return 0.002 * random.Normal(); }), 2U);
  // A rate of rotation.
  EXPECT_EQ(with(0.0, [](Random& random) { return 0.05 + 0.02 * random.Normal(); }), 2U);
}

TEST(AbsoluteActionsTest, EarlierActionsInTheStateAreNotPositions) {
  for (const int delay : {1, 2, 3}) {
    std::vector<Trajectory> set = Late(delay);
    EXPECT_TRUE(FindAbsoluteActions(set).empty()) << delay;
    // Recorded in single precision.
    for (Trajectory& episode : set) episode.states = episode.states.cast<float>().cast<double>();
    EXPECT_TRUE(FindAbsoluteActions(set).empty()) << delay;
    // Without the position nothing shows that the entries are not positions.
    for (Trajectory& episode : set) {
      episode.states = Matrix(episode.states.rightCols(2 * delay));
    }
    EXPECT_EQ(FindAbsoluteActions(set).size(), 2u) << delay;
  }
}

// A third action moves no entry of the state. Only the observation of the whole action shows that
// its entry is a copy.
TEST(AbsoluteActionsTest, AnEntryWithinTheLastActionIsNotAPosition) {
  auto set = Late(1);
  Random random(4);
  for (Trajectory& episode : set) {
    const Matrix before = episode.states;  // the position, then the last action
    const Eigen::Index steps = episode.controls.rows();
    Matrix controls(steps, 3);
    Matrix states = Matrix::Zero(steps + 1, 5);
    for (Eigen::Index t = 0; t < steps; ++t) {
      const double width = (t < steps / 2 ? 1.0 : -1.0) + 0.01 * random.Normal();
      controls.row(t) << episode.controls.row(t), width;
      states.row(t + 1).head(3) = controls.row(t);
    }
    states.rightCols(2) = before.leftCols(2);
    episode = {.states = states, .controls = controls};
  }
  EXPECT_TRUE(FindAbsoluteActions(set).empty());
  // In another order the entries are not an observation of the action.
  for (Trajectory& episode : set) episode.states.col(0).swap(episode.states.col(2));
  const auto found = FindAbsoluteActions(set);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found[0].action, 2);
}

// Appends a gripper that closes to `closed` once. The state follows at `rate` per step.
void AddGripper(double closed, double rate, std::vector<Trajectory>& set) {
  for (std::size_t i = 0; i < set.size(); ++i) {
    Trajectory& episode = set[i];
    const Eigen::Index n = episode.states.cols();
    const Eigen::Index m = episode.controls.cols();
    episode.states.conservativeResize(Eigen::NoChange, n + 1);
    episode.controls.conservativeResize(Eigen::NoChange, m + 1);
    episode.states(0, n) = 0.0;
    const auto closes = static_cast<Eigen::Index>(20 + i);
    for (Eigen::Index t = 0; t < episode.controls.rows(); ++t) {
      episode.controls(t, m) = t < closes ? 0.0 : closed;
      const bool follows = t > closes;  // one step late
      episode.states(t + 1, n) =
          follows ? std::min(closed, episode.states(t, n) + rate) : episode.states(t, n);
    }
  }
}

TEST(AbsoluteActionsTest, AGripperIsNotAPosition) {
  for (const double rate : {1.0, 0.25}) {
    auto velocities = RollOut(Velocities(1.0));
    AddGripper(1.0, rate, velocities);
    EXPECT_TRUE(FindAbsoluteActions(velocities).empty()) << rate;
    auto targets = RollOut(Targets(0.5));
    AddGripper(1.0, rate, targets);
    EXPECT_EQ(FindAbsoluteActions(targets).size(), 2U) << rate;
  }
  // Keys move the robot in fixed steps.
  auto keys = RollOut({.act = [](const auto& x, const auto& goal, Random&, auto& u, auto& next) {
    for (Eigen::Index i = 0; i < 2; ++i) {
      const double off = goal[i] - x[i];
      u[i] = std::abs(off) < 0.05 ? 0.0 : std::copysign(0.1, off);
    }
    next = x + u;
  }});
  AddGripper(1.0, 1.0, keys);
  EXPECT_TRUE(FindAbsoluteActions(keys).empty());
  // A robot that has only a gripper.
  for (Trajectory& episode : keys) {
    episode.controls = Matrix(episode.controls.rightCols(1));
    episode.states = Matrix(episode.states.rightCols(1));
  }
  EXPECT_TRUE(FindAbsoluteActions(keys).empty());
  // An axis with two targets.
  std::vector<Trajectory> axis(20, {.states = Matrix(61, 0), .controls = Matrix(60, 0)});
  AddGripper(1.0, 0.25, axis);
  EXPECT_EQ(FindAbsoluteActions(axis).size(), 1U);
}

// The joints reach their targets exactly. The state also has the joints of the step before, and
// either the tip of the arm, which moves with the joints, or an object that the arm does not touch.
TEST(AbsoluteActionsTest, PerfectlyTrackedTargetsAreFound) {
  for (const bool tip : {true, false}) {
    for (const double noise : {0.0, 0.02}) {
      auto set = RollOut(
          {.act = [=](const auto& x, const auto& goal, Random& random, auto& u, auto& next) {
            u = x + 0.1 * (goal - x) + noise * Normal2(random);
            next = u;
          }});
      for (Trajectory& episode : set) {
        const Matrix joints = episode.states;
        Matrix states(joints.rows(), 6);
        for (Eigen::Index t = 0; t < joints.rows(); ++t) {
          const double a = joints(t, 0);
          const double b = joints(t, 1);
          states.row(t) << joints.row(t), joints.row(std::max<Eigen::Index>(0, t - 1)),
              tip ? std::cos(a) + std::cos(a + b) : 0.1 * static_cast<double>(t),
              tip ? std::sin(a) + std::sin(a + b) : std::sin(0.1 * static_cast<double>(t));
        }
        episode.states = states;
      }
      const auto found = FindAbsoluteActions(set);
      ASSERT_EQ(found.size(), 2u) << tip << ' ' << noise;
      EXPECT_EQ(found[0].state, 0);
      EXPECT_EQ(found[1].state, 1);
    }
  }
}

TEST(AbsoluteActionsTest, ConstantEntriesAndShortSetsHaveNoTargets) {
  Trajectory still{.states = Matrix::Ones(31, 2), .controls = Matrix::Ones(30, 2)};
  EXPECT_TRUE(FindAbsoluteActions(std::vector{still}).empty());
  Trajectory brief{.states = Matrix::Random(3, 2), .controls = Matrix::Random(2, 2)};
  EXPECT_TRUE(FindAbsoluteActions(std::vector{brief}).empty());
  EXPECT_TRUE(FindAbsoluteActions({}).empty());
}

TEST(AbsoluteActionsTest, OnlyTargetsAreConverted) {
  World world = Targets(1.0);
  const auto targets = world.act;
  world.act = [targets](const auto& x, const auto& goal, Random& random, auto& u, auto& next) {
    targets(x, goal, random, u, next);
    u[1] = random.Normal() > 0 ? 1.0 : -1.0;  // a gripper
  };
  auto set = RollOut(world);
  const auto found = FindAbsoluteActions(set);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].action, 0);
  const Matrix before = set[0].controls;
  ToDifferences(found, set[0]);
  EXPECT_EQ(set[0].controls.col(1), before.col(1));
}

// A matrix of all pairs of entries would take 29 GB.
TEST(AbsoluteActionsTest, MemoryIsLinearInThePixelsOfPictures) {
  constexpr Eigen::Index kPixels = 30'000;
  const auto small = RollOut(Targets(0.5));
  std::vector<Trajectory> set;
  for (const Trajectory& episode : std::span(small).first(2)) {
    Trajectory& wide = set.emplace_back(episode);
    wide.states = Matrix::Constant(episode.states.rows(), kPixels + 2, 120.0);
    wide.states.rightCols(2) = episode.states;
  }
  const auto found = FindAbsoluteActions(set);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].state, kPixels);
  EXPECT_EQ(found[1].state, kPixels + 1);
}

TEST(AbsoluteActionsTest, DescriptionNamesActionsAndEntries) {
  StateLayout layout;
  layout.Add("clock", 1);
  layout.Add("joint", 7);
  std::vector<AbsoluteAction> found;
  for (int k = 0; k < 5; ++k) found.push_back({k, k + 1, true, 0.99 + 0.001 * k, 1.0});
  found[3].slope = 0.94;
  EXPECT_EQ(
      Describe(found, layout),
      "actions 0, 1, 2, ... take the values of joint[0], joint[1], joint[2], ... (correlation "
      "at least 0.990, slope 0.94): they are positions");
  EXPECT_THAT(Describe(std::span(found).first(1), layout), HasSubstr("action 0 takes"));
}

}  // namespace
}  // namespace dfr::core
