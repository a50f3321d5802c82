#include "dfr/safety/guard_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/message_of.h"

namespace dfr::safety {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;

TEST(GuardModelTest, AlarmsOnFewUnseenDemonstrations) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 60),
                                     {.features = "tip", .false_alarms = 0.1});
  EXPECT_EQ(model->summary().false_alarms, 0.1);
  int alarms = 0;
  const auto unseen = test::CorridorDemonstrations(2, 400);
  for (const auto& demonstration : unseen) {
    const std::vector<double> levels = model->Levels(demonstration.states);
    alarms += *std::min_element(levels.begin(), levels.end()) < -model->settings().alarm_level;
  }
  // On average over sets of 60 demonstrations 40 of 400 raise an alarm. The rate of one set has a
  // beta distribution with standard deviation sqrt(.1 .9 / 62) = .04. The limit is the mean plus
  // three standard deviations.
  EXPECT_LT(alarms, 400 * (0.1 + 3 * 0.04));
}

// A supervisor cycles through goals. Folds by d mod 5 would leave out each goal as a whole.
TEST(GuardModelTest, CyclingThroughGoalsDoesNotRaiseTheAlarmLevel) {
  const auto goals = [](bool in_turn) {
    std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(6, 40);
    for (std::size_t d = 0; d < demonstrations.size(); ++d) {
      const double goal = static_cast<double>(in_turn ? d % 5 : d / 8);
      core::Matrix& states = demonstrations[d].states;
      for (Eigen::Index t = 0; t < states.rows(); ++t) {
        states(t, 2) += 0.2 * goal * static_cast<double>(t);
      }
    }
    return demonstrations;
  };
  const auto cycled = GuardModel::Fit(test::CorridorLayout(), goals(true), {.features = "tip"});
  const auto sorted = GuardModel::Fit(test::CorridorLayout(), goals(false), {.features = "tip"});
  EXPECT_LT(cycled->settings().alarm_level, 1.0);
  EXPECT_LT(sorted->settings().alarm_level, 1.0);
  // With goals recorded one after the other, each stretch of the recording contains one goal.
  EXPECT_THAT(Warnings(*sorted), testing::Contains(HasSubstr("recording conditions drift")));
  EXPECT_GT(sorted->summary().drift_level, sorted->settings().alarm_level + 0.2);
  EXPECT_LT(sorted->summary().drift_chance, 0.01);
  EXPECT_THAT(Warnings(*cycled),
              testing::Not(testing::Contains(HasSubstr("recording conditions drift"))));
}

// Four demonstrations are left out in pairs. One of the three possible pairings equals the folds,
// and then no level differs. For the other two, Wilcoxon's test has up to four ranks, whose sum has
// mean 5 and variance 4 * 5 * 9 / 24 = 7.5.
TEST(GuardModelTest, ContiguousFoldsEqualToTheOthersShowNoDrift) {
  const auto recorded = test::CorridorDemonstrations(7, 4);
  std::vector<double> possible;
  for (int ranks = 0; ranks <= 10; ++ranks) {
    possible.push_back(0.5 * std::erfc((ranks - 5.0) / std::sqrt(15.0)));
  }
  int the_same = 0;
  for (const std::size_t partner : {1u, 2u, 3u}) {
    auto demonstrations = recorded;
    std::swap(demonstrations[1], demonstrations[partner]);
    const GuardSummary summary =
        GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"})->summary();
    if (summary.drift_chance == 1.0) {
      ++the_same;
      continue;
    }
    double nearest = 1.0;
    for (const double p : possible) {
      nearest = std::min(nearest, std::abs(p - summary.drift_chance));
    }
    EXPECT_LT(nearest, 1e-12) << summary.drift_chance;
  }
  EXPECT_EQ(the_same, 1);
}

TEST(GuardModelTest, AcceptanceCountsStatesAndInsideThroughoutCountsDemonstrations) {
  const auto demonstrations = test::CorridorDemonstrations(1, 40);
  GuardOptions options{.features = "tip"};
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  const GuardSummary& summary = model->summary();
  EXPECT_GT(summary.inside_throughout, 0.0);
  EXPECT_LT(summary.inside_throughout, summary.acceptance);
  EXPECT_LT(summary.acceptance, 1.0);
  EXPECT_EQ(40.0 * summary.inside_throughout, std::round(40.0 * summary.inside_throughout));
  EXPECT_NEAR(840.0 * summary.acceptance, std::round(840.0 * summary.acceptance), 1e-9);
  options.support.svm.gamma = 1e3;
  options.accept_any = true;
  const auto narrow = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_EQ(narrow->summary().inside_throughout, 0.0);
}

TEST(GuardModelTest, CertificatesNeedTheirConstantsAndDoublePrecision) {
  GuardOptions options{.features = "tip"};
  options.support.single_precision = true;
  const auto demonstrations = test::CorridorDemonstrations(1, 20);
  const auto message = [](const auto& call) {
    return test::MessageOf<std::invalid_argument>(call);
  };
  const auto single = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  GuardSettings settings = single->settings();
  settings.strategy = Strategy::kCertified;
  EXPECT_THAT(message([&] { (void)single->With(settings); }), HasSubstr("double precision"));
  options.strategy = Strategy::kCertified;
  EXPECT_THAT(
      message([&] { (void)GuardModel::Fit(test::CorridorLayout(), demonstrations, options); }),
      HasSubstr("double precision"));
  settings.direction_error = 0.0;
  EXPECT_THAT(message([&] { (void)single->With(settings); }),
              HasSubstr("needs a positive direction_error"));
  settings.direction_error = -1.0;
  EXPECT_THAT(message([&] { (void)single->With(settings); }), HasSubstr("direction_error"));
}

// Definition: no outcome allowed by the assumption raises an alarm.
TEST(GuardModelTest, CertifyPassesOnlyActionsThatProvablyRaiseNoAlarm) {
  const auto model = test::Model();
  const double eps = model->settings().direction_error;
  const kernel::WhitenedSupport& support = model->task().feature_support();
  const core::FeatureTransform& features = model->task().features();
  const double least = -model->settings().alarm_level - 1e-9;
  const auto deepest = [&](const Eigen::VectorXd& there) {
    double best = -std::numeric_limits<double>::infinity();
    for (int q = 0; q < support.num_steps(); ++q) {
      best = std::max(best, support.LogDecision(q, core::AsSpan(there), {}));
    }
    return best;
  };
  core::Random random(3);
  int passed = 0;
  int refused = 0;
  for (int i = 0; i < 200; ++i) {
    const int t = i % 18;
    const std::vector<double> state = {0.0, 0.1 * t + 0.1 * random.Normal(), 0.1 * random.Normal()};
    const std::vector<double> action = {0.2 * random.Normal(), 0.2 * random.Normal()};
    const Certification found = model->Certify(t, state, action);
    Eigen::VectorXd z(2);
    features.Apply(state, core::AsSpan(z));
    (found.passes ? passed : refused) += 1;
    EXPECT_EQ(found.passes, found.margin >= 0.0);
    const double error = eps * std::hypot(action[0], action[1]);
    for (int angle = 0; angle < 24; ++angle) {
      const Eigen::Vector2d direction(std::cos(M_PI * angle / 12.0), std::sin(M_PI * angle / 12.0));
      if (found.passes) {
        EXPECT_GE(deepest(z + found.effect + error * direction), least);
      }
      if (found.radius > 0.0) {
        EXPECT_GE(deepest(z + found.radius * direction), least);
        EXPECT_GE(deepest(z + found.shift + found.ball_radius * direction), least);
      }
    }
  }
  EXPECT_GT(passed, 40);
  EXPECT_GT(refused, 40);
  EXPECT_THROW((void)model->Certify(0, std::vector{0.0}, std::vector{0.0, 0.0}),
               std::invalid_argument);
  EXPECT_THROW((void)model->Certify(0, std::vector{0.0, 0.0, 0.0}, std::vector{0.0}),
               std::invalid_argument);
}

TEST(GuardModelTest, LevelsFollowFasterAndSlowerEpisodes) {
  const auto model = test::Model();
  core::Matrix slow(41, 3);
  core::Matrix fast(11, 3);
  for (int i = 0; i < slow.rows(); ++i) slow.row(i) << i, 0.05 * i, 0.0;
  for (int i = 0; i < fast.rows(); ++i) fast.row(i) << i, 0.2 * i, 0.0;
  for (const core::Matrix& states : {slow, fast}) {
    std::vector<int> steps;
    const std::vector<double> levels = model->Levels(states, &steps);
    ASSERT_EQ(steps.size(), static_cast<std::size_t>(states.rows()));
    EXPECT_GT(*std::min_element(levels.begin(), levels.end()), -model->settings().alarm_level);
    EXPECT_NEAR(steps.back(), 20, 2);
  }
}

TEST(GuardModelTest, AKernelThatFillsTheGapBetweenTwoPathsIsNarrowed) {
  auto demonstrations = test::CorridorDemonstrations(1, 40);
  for (std::size_t d = 0; d < demonstrations.size(); d += 2) {
    demonstrations[d].states.col(2).array() += 2.0;
  }
  GuardOptions options{.features = "tip"};
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  // The fit doubles gamma once, because the volume falls; no gap requires it.
  EXPECT_EQ(model->summary().gamma, 2.0 * options.support.svm.gamma);
  EXPECT_GE(model->summary().gaps.points, model->num_steps() - 2);
  EXPECT_EQ(model->summary().gaps.inside, 0);
  options.support.svm.gamma = 0.01;
  const auto narrowed = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_EQ(narrowed->summary().gamma, 0.08);  // Doubled by volume once and for gaps twice.
  options.support.svm.gamma = 1e-4;
  const auto wide = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_EQ(wide->summary().gamma, 4e-4);
  EXPECT_THAT(Warnings(*wide), testing::Contains(HasSubstr("demonstrations have several modes")));
}

TEST(GuardModelTest, TheDefaultActionLimitIsOneAndAHalfTimesTheLargestAction) {
  const auto demonstrations = test::CorridorDemonstrations(1, 10);
  Eigen::RowVector2d largest = Eigen::RowVector2d::Zero();
  for (const auto& d : demonstrations) {
    largest = largest.cwiseMax(d.controls.cwiseAbs().colwise().maxCoeff());
  }
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  EXPECT_THAT(model->settings().action_limit,
              testing::ElementsAre(1.5 * largest[0], 1.5 * largest[1]));
  const auto limited = GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                       {.features = "tip", .action_limit = {0.3}});
  EXPECT_THAT(limited->settings().action_limit, testing::ElementsAre(0.3, 0.3));
}

TEST(GuardModelTest, FewDemonstrationsGiveAWeakerGuarantee) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 4),
                                     {.features = "tip", .false_alarms = 0.01});
  EXPECT_EQ(model->summary().false_alarms, 0.2) << "1 / (4 + 1)";
  EXPECT_TRUE(std::isfinite(model->settings().alarm_level));
}

// With m demonstrations, no probability below 1 - (1 - c)^(1/m) has the confidence c.
TEST(GuardModelTest, AConfidenceThatCannotBeKeptIsAWarning) {
  const auto demonstrations = test::CorridorDemonstrations(1, 10);
  const auto fit = [&](double confidence) {
    return GuardModel::Fit(test::CorridorLayout(), demonstrations,
                           {.features = "tip", .false_alarms = 0.3, .confidence = confidence});
  };
  const auto warning =
      Contains(HasSubstr("10 demonstrations cannot keep the share of false alarms at 0.3 with"));
  for (const double confidence : {0.0, 0.5, 0.95}) {
    const auto model = fit(confidence);
    EXPECT_EQ(model->summary().confidence, confidence);
    EXPECT_THAT(Warnings(*model), Not(warning));
  }
  const auto model = fit(0.98);
  EXPECT_EQ(model->summary().confidence, 0.0);
  EXPECT_THAT(Warnings(*model), warning);
}

TEST(GuardModelTest, ProgressCanStopAFit) {
  std::vector<double> shares;
  GuardOptions options{.features = "tip"};
  options.progress = [&](std::string_view, double share) {
    shares.push_back(share);
    return true;
  };
  const auto demonstrations = test::CorridorDemonstrations(1, 10);
  EXPECT_NE(GuardModel::Fit(test::CorridorLayout(), demonstrations, options), nullptr);
  EXPECT_TRUE(std::is_sorted(shares.begin(), shares.end()));
  EXPECT_EQ(shares.back(), 1.0);
  for (std::size_t stop = 0; stop < shares.size(); ++stop) {
    std::size_t calls = 0;
    options.progress = [&](std::string_view, double) { return calls++ < stop; };
    EXPECT_EQ(GuardModel::Fit(test::CorridorLayout(), demonstrations, options), nullptr);
  }
}

// A user's Ctrl-C stops a fit of a support. The other supports must not be fitted after it, and the
// stopped one is not consistent.
TEST(GuardModelTest, AStoppedSupportStopsAFit) {
  const auto demonstrations = test::CorridorDemonstrations(1, 10);
  int calls = 0;
  int last = 0;
  GuardOptions options{.features = "tip"};
  options.support.svm.progress = [&](const kernel::FitProgress&) { return ++calls != last; };
  EXPECT_NE(GuardModel::Fit(test::CorridorLayout(), demonstrations, options), nullptr);
  const int all = calls;
  for (last = 1; last <= all; last += std::max(1, all / 60)) {
    calls = 0;
    EXPECT_EQ(GuardModel::Fit(test::CorridorLayout(), demonstrations, options), nullptr) << last;
    EXPECT_EQ(calls, last) << "called again after the stop";
  }
}

TEST(GuardModelTest, ProgressIsAskedBetweenTheSupportsOfEachStage) {
  std::map<std::string, int, std::less<>> calls;
  GuardOptions options{.features = "tip"};
  options.progress = [&](std::string_view stage, double) {
    ++calls[std::string(stage)];
    return true;
  };
  const auto demonstrations = test::CorridorDemonstrations(1, 10);
  EXPECT_NE(GuardModel::Fit(test::CorridorLayout(), demonstrations, options), nullptr);
  EXPECT_GE(calls["comparing kernel widths"], 2 * (options.folds + 1));
  EXPECT_GE(calls["testing for gaps"], 2) << "before the support and before the test";
  EXPECT_GE(calls["leaving stretches out"], 2 * options.folds);
  EXPECT_GE(calls["fitting the response to actions"], 2 * 10)
      << "two comparisons of demonstrations";
  EXPECT_GE(calls["estimating the alarm level"], options.folds);
  EXPECT_EQ(calls["estimating the errors of predictions"], 1);
}

// Constant entries are no features.
TEST(GuardModelTest, TooManyFeaturesAreRefusedWithTheRemedy) {
  constexpr int kEntries = 300;
  auto layout = test::CorridorLayout();
  layout.Add("pixels", kEntries);
  core::Random random(5);
  const auto message = [&](int varying) {
    std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(1, 5);
    for (core::Trajectory& d : demonstrations) {
      d.states.conservativeResize(Eigen::NoChange, 3 + kEntries);
      d.states.rightCols(kEntries).setConstant(1.0);
      for (double& entry : d.states.middleCols(3, varying).reshaped()) entry = random.Normal();
    }
    return test::MessageOf<std::invalid_argument>(
        [&] { static_cast<void>(GuardModel::Fit(layout, demonstrations, {})); });
  };
  EXPECT_THAT(message(300), HasSubstr("at most 256 features are supported, not 303: select fewer, "
                                      "or put pca: before a block"));
  EXPECT_THAT(message(200), Not(HasSubstr("features are supported")));
}

TEST(GuardModelTest, WrongDemonstrationsAndOptionsAreNamed) {
  const auto layout = test::CorridorLayout();
  const auto good = test::CorridorDemonstrations(1, 5);
  const auto fit = [&](std::vector<core::Trajectory> demonstrations, GuardOptions options = {}) {
    return test::MessageOf<std::invalid_argument>(
        [&] { static_cast<void>(GuardModel::Fit(layout, demonstrations, options)); });
  };
  EXPECT_THAT(fit({good[0], good[1]}), HasSubstr("at least 3 demonstrations, not 2"));
  auto bad = good;
  bad[2].states(4, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(fit(bad), HasSubstr("demonstration 2 has a non-finite entry in state"));
  bad = good;
  bad[3].controls.conservativeResize(7, 2);
  EXPECT_THAT(fit(bad), HasSubstr("demonstration 3 has 21 states and 7 actions"));
  bad = good;
  bad[1].controls.conservativeResize(20, 1);
  EXPECT_THAT(fit(bad), HasSubstr("demonstration 1 has actions of 1 entries"));
  bad = good;
  bad[0].states.conservativeResize(21, 2);
  EXPECT_THAT(fit(bad), HasSubstr("demonstration 0 has states of 2 entries, but the layout has 3"));

  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  constexpr const char* kShare = "false_alarms must lie in (0, 1)";
  constexpr const char* kConfidence = "confidence must lie in [0, 1)";
  constexpr const char* kHoldOut = "hold_out must lie in [0, .5]";
  constexpr const char* kFactor = "error_factor must be positive and finite";
  struct Refused {
    GuardOptions options;
    const char* message;
  };
  for (const auto& [options, message] : std::vector<Refused>{
           {{.features = "gripper"}, "feature 'gripper'"},
           {{.horizon = -1}, "horizon"},
           // A fit also rejects values that Load() would reject.
           {{.horizon = (1 << 30) + 1}, "horizon"},
           {{.horizon = std::numeric_limits<int>::max()}, "horizon"},
           {{.false_alarms = 0.0}, kShare},
           {{.false_alarms = 1.0}, kShare},
           {{.false_alarms = std::nan("")}, kShare},
           {{.confidence = -0.1}, kConfidence},
           {{.confidence = 1.0}, kConfidence},
           {{.confidence = std::nan("")}, kConfidence},
           {{.folds = 1}, "folds"},
           {{.action_limit = {-1.0}}, "action_limit must be finite and not negative"},
           {{.hold_out = -0.01}, kHoldOut},
           {{.hold_out = 0.51}, kHoldOut},
           {{.hold_out = 0.5}, "holding out 3 of 5 demonstrations leaves fewer than 3"},
           {{.error_factor = 0.0}, kFactor},
           {{.error_factor = kInfinity}, kFactor},
       }) {
    GuardOptions wrong = options;
    int stages = 0;
    wrong.progress = [&](std::string_view, double) { return ++stages > 0; };
    EXPECT_THAT(fit(good, wrong), HasSubstr(message));
    EXPECT_EQ(stages, 0) << "refused before the work begins";
  }
  EXPECT_EQ(fit(good, {.features = "tip", .hold_out = 0.4}), "nothing thrown");
  EXPECT_EQ(fit(good, {.features = "tip", .folds = 2}), "nothing thrown");
  // The product .28 * 25 rounds up.
  const auto held_out = GuardModel::Fit(layout, test::CorridorDemonstrations(1, 25),
                                        {.features = "tip", .hold_out = 0.28});
  EXPECT_EQ(held_out->summary().held_out, 7);

  const auto model = GuardModel::Fit(layout, good, {.features = "tip"});
  const auto refusal = [&](auto GuardSettings::*member, auto value) {
    GuardSettings settings = model->settings();
    settings.*member = value;
    return test::MessageOf<std::invalid_argument>(
        [&] { static_cast<void>(model->With(settings)); });
  };
  constexpr auto kLimit = &GuardSettings::action_limit;
  for (const double limit : {-0.1, kInfinity, std::nan("")}) {
    EXPECT_THAT(refusal(kLimit, std::vector{0.1, limit}),
                HasSubstr("action_limit must be finite and not negative: entry 1"));
  }
  EXPECT_THAT(refusal(kLimit, std::vector{0.0, 0.0}), HasSubstr("nothing could move"));
  EXPECT_THAT(refusal(kLimit, std::vector{0.1, 0.1, 0.1}),
              HasSubstr("action_limit has 3 entries, but actions have 2"));
  for (const auto& [count, name] : {std::pair(&GuardSettings::horizon, "horizon"),
                                    {&GuardSettings::max_actions, "max_actions"}}) {
    for (const int wrong : {0, (1 << 30) + 1}) {
      EXPECT_THAT(refusal(count, wrong), HasSubstr(std::string(name) + " must lie in [1, "));
    }
    for (const int right : {1, 1 << 30}) EXPECT_EQ(refusal(count, right), "nothing thrown");
  }
  EXPECT_THAT(refusal(&GuardSettings::alarm_level, -kInfinity),
              HasSubstr("alarm_level must be finite"));
  EXPECT_THAT(refusal(&GuardSettings::direction_error, kInfinity),
              HasSubstr("direction_error must be finite and not negative"));
  EXPECT_EQ(refusal(&GuardSettings::direction_error, 0.0), "nothing thrown");
  EXPECT_THAT(
      test::MessageOf<std::invalid_argument>([&] { static_cast<void>(ParseStrategy("brave")); }),
      HasSubstr(
          "unknown strategy 'brave'; valid: guard, controller, dfr, early-stopping, monitor"));
}

}  // namespace
}  // namespace dfr::safety
