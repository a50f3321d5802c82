#include "dfr/control/guided/safety_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "dfr/control/constants.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/control/task.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

using Choice = SafetyFilter::Choice;

// A disk that moves to the right, demonstrations that follow it, and a state at the disk's rim.
class SafetyFilterTest : public testing::Test {
 protected:
  SafetyFilterTest() { estimate_.FitAt(0, core::AsSpan(z_), fit_); }

  [[nodiscard]] Choice Filter(const GuidedOptions& options, Eigen::VectorXd& v) {
    return SafetyFilter(model_, options).Filter(fit_, target_, target_.level, v);
  }
  [[nodiscard]] double Level(const Eigen::VectorXd& v) const { return local_.Level(1, v); }

  test::GaussianSupport support_ = test::MovingDisk();
  test::Task model_{test::IdentityFeatures(), support_, test::Rightwards()};
  ResponseEstimate estimate_{model_.response.prior()};
  Eigen::VectorXd z_ = Eigen::Vector2d(0.0, 0.35);
  LocalFit fit_ = estimate_.MakeFit();
  LocalModel local_{support_, fit_};
  StepTarget target_{1, model_.levels.gate(1)};
  StepLimits limits_ =
      Limits(GuidedOptions{}, model_.response.control_dim(), model_.response.control_unit());
  // Two controls: one leads out of the disk, the other deep into the disk.
  Eigen::VectorXd outwards_ = Eigen::Vector2d(0.0, 3.0);
  Eigen::VectorXd inwards_ = Eigen::Vector2d(test::kSpeed, -0.35) / model_.response.control_unit();
};

TEST_F(SafetyFilterTest, AControlThatEndsDeepInsidePassesUnchanged) {
  ASSERT_GT(Level(inwards_), target_.level);
  Eigen::VectorXd v = inwards_;
  const Choice choice = Filter({}, v);
  EXPECT_EQ(choice.mode, Mode::kPolicy);
  EXPECT_EQ(choice.level, Level(inwards_));
  EXPECT_TRUE(v == inwards_);
}

TEST_F(SafetyFilterTest, AControlThatEndsOutsideIsReplacedByTheNominalOne) {
  ASSERT_LT(Level(outwards_), 0.0);
  Eigen::VectorXd expected(2);
  ASSERT_TRUE(fit_.NominalControl(expected));
  const double level = AscendSupport(local_, target_, limits_, expected);
  Eigen::VectorXd v = outwards_;
  const Choice choice = Filter({}, v);
  EXPECT_EQ(choice.mode, Mode::kRecovery);
  EXPECT_GE(choice.level, 0.0);
  EXPECT_EQ(choice.level, level);
  EXPECT_TRUE(v == expected);
}

// The disk moves to the right. Demonstrations follow it at one speed or stand still. The first
// entry of a corrected control has one of the two demonstrated values.
TEST_F(SafetyFilterTest, AnEntryWithFewValuesIsNeverAMeanOfThem) {
  const test::Task task{test::IdentityFeatures(), support_, test::RightwardsOrStill()};
  const ResponseEstimate estimate(task.response.prior());
  LocalFit fit = estimate.FitAt(0, core::AsSpan(z_));
  Eigen::VectorXd nominal(2);
  ASSERT_TRUE(fit.NominalControl(nominal));
  const double speed = test::kSpeed / task.response.control_unit();
  ASSERT_GT(nominal[0], 0.1 * speed);
  ASSERT_LT(nominal[0], 0.9 * speed);
  Eigen::VectorXd v = outwards_;
  const Choice choice = SafetyFilter(task, {}).Filter(fit, target_, target_.level, v);
  EXPECT_EQ(choice.mode, Mode::kRecovery);
  EXPECT_NEAR(v[0], nominal[0] > 0.5 * speed ? speed : 0.0, 1e-12);
}

// Demonstrations use the second entry everywhere, but the entry acts only beyond x = .3. Near that
// place J is a mean of two responses. A raise with least intervention uses the entry less.
TEST_F(SafetyFilterTest, AnEntryOnWhoseEffectDemonstrationsDisagreeIsRaisedLess) {
  const auto raises = [&](double begin, bool least) {
    auto demonstrations = test::Rightwards();
    core::Random random(3);
    for (core::Trajectory& demonstration : demonstrations) {
      for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
        const double y = 0.1 * random.Normal();
        const bool acts = demonstration.states(t, 0) > begin;
        demonstration.controls(t, 1) = y;
        demonstration.states(t + 1, 1) = demonstration.states(t, 1) + (acts ? y : 0.0);
      }
    }
    const test::Task task{test::IdentityFeatures(), support_, demonstrations};
    const ResponseEstimate estimate(task.response.prior());
    LocalFit fit = estimate.FitAt(2, core::AsSpan(z_));
    Eigen::VectorXd nominal(2);
    EXPECT_TRUE(fit.NominalControl(nominal));
    Eigen::VectorXd v = outwards_;
    const Choice choice =
        SafetyFilter(task, {.least_intervention = least}).Filter(fit, target_, target_.level, v);
    EXPECT_EQ(choice.mode, Mode::kRecovery);
    return std::abs(v[1] - nominal[1]);
  };
  for (const bool acts : {true, false}) {
    const double begin = acts ? -10.0 : 0.3;
    const double full = raises(begin, false);
    EXPECT_GT(full, guided::kLeastHedged);
    if (acts) {
      EXPECT_GT(raises(begin, true), 0.9 * full);
    } else {
      EXPECT_LT(raises(begin, true), 0.7 * full);
    }
  }
}

// Only both entries together move the state to the right: each alone moves it mainly up or down.
// Demonstrations disagree on the second entry, and a raise that used it less would lead away.
TEST_F(SafetyFilterTest, ARaiseNeverLowersThePredictedLevel) {
  auto demonstrations = test::Rightwards();
  core::Random random(3);
  for (core::Trajectory& demonstration : demonstrations) {
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      auto u = demonstration.controls.row(t);
      u << 0.006 * random.Normal(), 0.006 * random.Normal();
      const double second = random.Uniform() < 0.5 ? u[1] : 0.0;
      demonstration.states.row(t + 1) = demonstration.states.row(t);
      demonstration.states(t + 1, 0) += u[0] + second;
      demonstration.states(t + 1, 1) += 20.0 * (u[0] - second);
    }
  }
  const test::Task task{test::IdentityFeatures(), support_, demonstrations};
  const ResponseEstimate estimate(task.response.prior());
  LocalFit fit = estimate.FitAt(0, std::vector{-0.2, 0.0});
  const LocalModel local{support_, fit};
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(2);
  const auto raised = [&](bool least) {
    Eigen::VectorXd v = zero;
    const GuidedOptions options{
        .iterations = 100, .least_intervention = least, .probe_size = 0.0, .demonstrated = false};
    const double level = local.Level(1, zero) + 0.2;
    const Choice choice = SafetyFilter(task, options).Filter(fit, {1, level}, level, v);
    EXPECT_EQ(choice.level, local.Level(1, v));
    return v;
  };
  Eigen::VectorXd damped = raised(false);
  EXPECT_GT(local.Level(1, damped), local.Level(1, zero));
  damped[1] *= fit.Agreement(1);
  ASSERT_LT(local.Level(1, damped), local.Level(1, zero));
  EXPECT_GE(local.Level(1, raised(true)), local.Level(1, zero));
}

// A learned control that ends inside passes or is replaced, depending on the pass level.
TEST_F(SafetyFilterTest, AControlThatEndsInsidePassesFromThePassLevelOn) {
  Eigen::VectorXd between = inwards_;
  for (double share = 0.0; Level(between) >= target_.level; share += 0.01) {
    between = (1.0 - share) * inwards_ + share * outwards_;
  }
  ASSERT_GE(Level(between), 0.0);
  Eigen::VectorXd v = between;
  const Choice choice = Filter({}, v);
  EXPECT_EQ(choice.mode, Mode::kRecovery);
  EXPECT_FALSE(v == between);
  EXPECT_GT(choice.level, Level(between));

  v = between;
  const Choice passed = SafetyFilter(model_, {}).Filter(fit_, target_, Level(between), v);
  EXPECT_EQ(passed.mode, Mode::kPolicy);
  EXPECT_TRUE(v == between);
  EXPECT_EQ(passed.level, Level(between));
}

// A zero control leaves the state in the middle of the disk, which moves on.
TEST_F(SafetyFilterTest, AControlMayStayInThePresentPhaseFromTheStayLevelOn) {
  z_ = Eigen::Vector2d::Zero();
  estimate_.FitAt(0, core::AsSpan(z_), fit_);
  const Eigen::VectorXd zero = Eigen::Vector2d::Zero();
  const double here = local_.Level(0, zero);
  ASSERT_GT(here, Level(zero));
  for (const double stay_level : {here, here + 1e-9}) {
    Eigen::VectorXd v = zero;
    const Choice choice = SafetyFilter(model_, {}).Filter(fit_, {1, 10.0}, 10.0, v, stay_level);
    EXPECT_EQ(choice.stays, stay_level == here);
    EXPECT_EQ(v == zero, choice.stays);
    EXPECT_EQ(choice.learned, Level(zero));
  }
}

// Above the disk, the demonstrated control is applied unless a raise within the limits makes up for
// more than half of its negative level.
TEST_F(SafetyFilterTest, FarOutsideARaiseMustBeWorthIt) {
  z_ = Eigen::Vector2d(0.0, 2.5);
  estimate_.FitAt(0, core::AsSpan(z_), fit_);
  for (const double limit : {0.6, 1.0}) {
    GuidedOptions options;
    options.control_limit = {limit};
    options.probe_size = 0.0;
    limits_ = Limits(options, 2, model_.response.control_unit());
    Eigen::VectorXd demonstrated(2);
    ASSERT_TRUE(fit_.NominalControl(demonstrated));
    limits_.Limit(demonstrated);
    const double plain = Level(demonstrated);
    Eigen::VectorXd raised = demonstrated;
    const double best = AscendSupport(local_, target_, limits_, raised);
    SafetyFilter filter(model_, options);
    ASSERT_LT(best, -filter.max_exit_level());
    Eigen::VectorXd v = outwards_;
    limits_.Limit(v);
    const Choice choice = filter.Filter(fit_, target_, target_.level, v);
    const bool worth = best > guided::kWorthRaising * plain;
    EXPECT_EQ(worth, limit == 1.0);
    EXPECT_EQ(v == demonstrated, !worth);
    EXPECT_EQ(choice.level, Level(v));
    EXPECT_EQ(choice.level > guided::kWorthRaising * plain, worth);
  }
}

// Demonstrations never use the second entry, so its effect is unknown. A limit of zero keeps it at
// rest. Then no probe could measure its effect.
TEST_F(SafetyFilterTest, AnEntryWithLimitZeroIsNotProbed) {
  auto demonstrations = test::Rightwards();
  for (core::Trajectory& demonstration : demonstrations) {
    demonstration.controls.col(1).setZero();
    demonstration.states.col(1).setConstant(demonstration.states(0, 1));
  }
  const test::Task task{test::IdentityFeatures(), support_, demonstrations};
  const ResponseEstimate estimate(task.response.prior());
  z_ = Eigen::Vector2d(0.0, 1.5);
  LocalFit fit = estimate.FitAt(0, core::AsSpan(z_));
  for (const double limit : {1.0, 0.0}) {
    GuidedOptions options;
    options.control_limit = {1.0, limit};
    Eigen::VectorXd v = Eigen::Vector2d(1.0, 0.0);
    const Choice choice = SafetyFilter(task, options).Filter(fit, target_, target_.level, v);
    EXPECT_EQ(choice.mode == Mode::kProbe, limit > 0.0);
    EXPECT_NE(v.norm(), 0.0);
    EXPECT_EQ(choice.level, (LocalModel{support_, fit}.Level(1, v)));
  }
}

// The first entry has two speeds and never rests. A probe of the second entry uses one of them.
TEST_F(SafetyFilterTest, AProbeKeepsAnEntryWithFewValues) {
  auto demonstrations = test::Rightwards();
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    core::Trajectory& demonstration = demonstrations[d];
    demonstration.controls.col(1).setZero();
    demonstration.states.col(1).setConstant(demonstration.states(0, 1));
    for (int t = 0; t < test::kSteps; ++t) {
      const double speed = (static_cast<std::size_t>(t) + d) % 3 == 0 ? 0.05 : test::kSpeed;
      demonstration.controls(t, 0) = speed;
      demonstration.states(t + 1, 0) = demonstration.states(t, 0) + speed;
    }
  }
  const test::Task task{test::IdentityFeatures(), support_, demonstrations};
  z_ = Eigen::Vector2d(0.0, 1.5);
  LocalFit fit = ResponseEstimate(task.response.prior()).FitAt(0, core::AsSpan(z_));
  Eigen::VectorXd v = Eigen::Vector2d(1.0, 0.0);
  const Choice choice = SafetyFilter(task, {}).Filter(fit, target_, target_.level, v);
  ASSERT_EQ(choice.mode, Mode::kProbe);
  EXPECT_NEAR(std::abs(v[1]), GuidedOptions().probe_size, 1e-3);
  EXPECT_NEAR(v[0] * task.response.control_unit(), 0.05, 1e-12);
}

// The learned control ends outside by less than the exit level, and the demonstrated one by more.
TEST_F(SafetyFilterTest, TheBetterControlPassesWithinTheExitLevel) {
  z_ = Eigen::Vector2d(0.0, 1.0);
  estimate_.FitAt(0, core::AsSpan(z_), fit_);
  SafetyFilter filter(model_, {.iterations = 0, .probe_size = 0.0});
  Eigen::VectorXd demonstrated(2);
  ASSERT_TRUE(fit_.NominalControl(demonstrated));
  ASSERT_LT(Level(demonstrated), -filter.max_exit_level());
  const Eigen::VectorXd learned =
      Eigen::Vector2d(test::kSpeed, -0.5) / model_.response.control_unit();
  ASSERT_LT(Level(learned), 0.0);
  ASSERT_GT(Level(learned), -filter.max_exit_level());
  Eigen::VectorXd v = learned;
  const Choice choice = filter.Filter(fit_, target_, target_.level, v);
  EXPECT_EQ(choice.mode, Mode::kPolicy);
  EXPECT_EQ(choice.level, Level(learned));
  EXPECT_TRUE(v == learned);
}

// One small control along the unknown entry has moved the state up or down. According to the
// resulting estimate, the probe moves the state down.
TEST_F(SafetyFilterTest, AProbeHasTheSignWithTheHigherPredictedLevel) {
  auto demonstrations = test::Rightwards();
  for (core::Trajectory& demonstration : demonstrations) demonstration.controls.col(1).setZero();
  const test::Task task{test::IdentityFeatures(), support_, demonstrations};
  const Eigen::VectorXd z = Eigen::Vector2d(0.0, 1.5);
  const Eigen::VectorXd tried = Eigen::Vector2d(0.0, 0.3);
  for (const double sign : {1.0, -1.0}) {
    ResponseEstimate estimate(task.response.prior());
    LocalFit fit = estimate.FitAt(0, core::AsSpan(z));
    const Eigen::VectorXd effect = Eigen::Vector2d(0.0, 0.02 * sign);
    estimate.Update(fit, core::AsSpan(tried), core::AsSpan(effect));
    estimate.FitAt(0, core::AsSpan(z), fit);
    Eigen::VectorXd v = Eigen::Vector2d(1.0, 0.0);
    const Choice choice = SafetyFilter(task, {}).Filter(fit, target_, target_.level, v);
    ASSERT_EQ(choice.mode, Mode::kProbe);
    EXPECT_LT(v[1] * sign, -0.3);
  }
}

TEST_F(SafetyFilterTest, WithoutTheNominalControlTheLearnedOneIsRaised) {
  Eigen::VectorXd expected = outwards_;
  const double level = AscendSupport(local_, target_, limits_, expected);
  ASSERT_GE(level, 0.0);
  Eigen::VectorXd v = outwards_;
  const Choice choice = Filter(Without({}, "demonstrated"), v);
  EXPECT_EQ(choice.mode, Mode::kPolicy);
  EXPECT_EQ(choice.level, level);
  EXPECT_TRUE(v == expected);
}

// Far outside, where no control ends inside, the learned control passes if its change would be
// small and gain no more than the margin. The change must be smaller in a world that moves by
// itself, or has a disturbance model, than in a world at rest.
TEST_F(SafetyFilterTest, AnIdleChangeIsSkippedIfNoControlPasses) {
  for (const auto& [rests, disturbed] :
       {std::pair(true, false), std::pair(false, false), std::pair(true, true)}) {
    auto demonstrations = test::Rightwards();
    for (std::size_t d = 0; d < demonstrations.size(); ++d) {
      const double speed = test::kSpeed * (0.07 * static_cast<double>(d) - 1.0);
      for (int t = 0; t <= test::kSteps; ++t) {
        if (t < test::kSteps) demonstrations[d].controls(t, 0) = speed;
        demonstrations[d].states(t, 0) = speed * t;
        if (!rests) demonstrations[d].states(t, 1) += test::kSpeed * t;
      }
    }
    const test::Task task{test::IdentityFeatures(), support_, demonstrations};
    z_ = Eigen::Vector2d(0.0, 1.5);
    LocalFit fit = ResponseEstimate(task.response.prior(), {}, true).FitAt(0, core::AsSpan(z_));
    const LocalModel local{support_, fit};
    GuidedOptions options{.iterations = 0, .probe_size = 0.0};
    if (disturbed) options.disturbance_model = {.base = 0.5, .per_control = 1.0};
    Eigen::VectorXd changed(2);
    ASSERT_TRUE(fit.NominalControl(changed));
    const double level = local.Level(1, changed);
    ASSERT_LT(level, 0.0);
    const double most = rests && !disturbed ? guided::kIdleAtRest : guided::kIdle;
    for (const double difference : {most - 0.1, most + 0.1}) {
      // Sideways, the level stays above the present one.
      const Eigen::VectorXd learned = changed - Eigen::VectorXd(Eigen::Vector2d(difference, 0.0));
      const double cost = level - local.Level(1, learned);
      ASSERT_GT(cost, 0.0);
      for (const double margin : {0.999 * cost, 1.001 * cost}) {
        Eigen::VectorXd v = learned;
        const Choice choice = SafetyFilter(task, options).Filter(fit, {1, 10.0}, 10.0 - margin, v);
        const bool passes = difference < most && margin > cost;
        EXPECT_EQ(choice.mode, passes ? Mode::kPolicy : Mode::kRecovery) << rests << difference;
        EXPECT_TRUE(v == (passes ? learned : changed)) << difference << " " << margin;
        EXPECT_EQ(choice.level, local.Level(1, passes ? learned : changed));
        EXPECT_EQ(choice.learned, local.Level(1, learned));
      }
    }
  }
  // A larger change is made if the learned control lowers the level.
  z_ = Eigen::Vector2d(0.0, 1.5);
  estimate_.FitAt(0, core::AsSpan(z_), fit_);
  Eigen::VectorXd changed(2);
  ASSERT_TRUE(fit_.NominalControl(changed));
  Eigen::VectorXd v = changed + Eigen::VectorXd(Eigen::Vector2d(0.0, 1.4));
  SafetyFilter filter(model_, {.iterations = 0, .probe_size = 0.0});
  EXPECT_EQ(filter.Filter(fit_, {1, 10.0}, 5.0, v).mode, Mode::kRecovery);
  EXPECT_TRUE(v == changed);
}

// The correction ends inside, but below the pass level.
TEST_F(SafetyFilterTest, AnIdleChangeIsMadeIfItLeadsBackInside) {
  z_ = Eigen::Vector2d(0.0, 0.38);
  estimate_.FitAt(0, core::AsSpan(z_), fit_);
  Eigen::VectorXd changed(2);
  ASSERT_TRUE(fit_.NominalControl(changed));
  ASSERT_GT(Level(changed), 0.0);
  for (const double difference : {0.2, 1.4}) {
    const Eigen::VectorXd learned = changed + Eigen::VectorXd(Eigen::Vector2d(0.0, difference));
    const bool inside = Level(learned) >= 0.0;
    EXPECT_EQ(inside, difference == 0.2);
    Eigen::VectorXd v = learned;
    SafetyFilter filter(model_, {.iterations = 0, .probe_size = 0.0});
    const Choice choice = filter.Filter(fit_, {1, 10.0}, 9.0, v);
    EXPECT_EQ(choice.mode, inside ? Mode::kPolicy : Mode::kRecovery);
    EXPECT_TRUE(v == (inside ? learned : changed)) << difference;
  }
}

// At the pass depth, the correction decides: it replaces the control only if it ends inside. A
// small excess and a control of almost no size always pass.
TEST_F(SafetyFilterTest, AtThePassDepthOnlyACorrectionThatEndsInsideReplacesAControl) {
  constexpr double kDepth = 0.8;
  model_.levels.SetHeldOut(std::vector{HeldOutLevels{.levels = {-kDepth}, .phases = {0}}});
  model_.levels.SetPredictionErrors(std::vector{kDepth});
  // Without a raise, the correction is the nominal control.
  GuidedOptions options{.iterations = 0, .least_intervention = true, .probe_size = 0.0};
  options.max_exit_ratio = kDepth / model_.levels.slack();
  SafetyFilter filter(model_, options);
  const auto passes = [&](double y, double level, bool inside) {
    z_[1] = y;
    estimate_.FitAt(0, core::AsSpan(z_), fit_);
    Eigen::VectorXd nominal(2);
    EXPECT_TRUE(fit_.NominalControl(nominal));
    EXPECT_EQ(Level(nominal) >= 0.0, inside) << y;
    // A control along the path and to the side that ends at the level.
    Eigen::VectorXd v = Eigen::Vector2d(test::kSpeed / model_.response.control_unit(), 0.0);
    double inner = -20.0;
    double outer = 20.0;
    for (int i = 0; i < 60; ++i) {
      v[1] = 0.5 * (inner + outer);
      (Level(v) > level ? inner : outer) = v[1];
    }
    EXPECT_NEAR(Level(v), level, 1e-6);
    const Eigen::VectorXd learned = v;
    return filter.Filter(fit_, target_, 0.0, v).mode == Mode::kPolicy && v == learned;
  };
  const double shallow = guided::kShallowDepth * kDepth;
  EXPECT_TRUE(passes(0.35, -0.8 * shallow, true));
  EXPECT_FALSE(passes(0.35, -1.5 * shallow, true));
  EXPECT_TRUE(passes(0.7, -1.5 * shallow, false)) << "the correction ends outside as well";
  // At rest the state leaves the moving disk.
  z_[1] = 0.47;
  estimate_.FitAt(0, core::AsSpan(z_), fit_);
  Eigen::VectorXd rest = Eigen::Vector2d::Zero();
  ASSERT_LT(Level(rest), -shallow);
  EXPECT_EQ(filter.Filter(fit_, target_, 0.0, rest).mode, Mode::kPolicy);
  EXPECT_EQ(rest.norm(), 0.0);
  EXPECT_FALSE(passes(0.35, -1.5 * kDepth, true));
}

TEST_F(SafetyFilterTest, KeepsNoStateAndNeverAllocates) {
  SafetyFilter filter(model_, {});
  Eigen::VectorXd first = outwards_;
  Eigen::VectorXd second = outwards_;
  Eigen::VectorXd other = inwards_;
  const test::NoAlloc guard;
  const Choice once = filter.Filter(fit_, target_, target_.level, first);
  static_cast<void>(filter.Filter(fit_, target_, target_.level, other));
  const Choice twice = filter.Filter(fit_, target_, target_.level, second);
  EXPECT_EQ(once.mode, twice.mode);
  EXPECT_EQ(once.level, twice.level);
  EXPECT_TRUE(first == second);
}

}  // namespace
}  // namespace dfr::control
