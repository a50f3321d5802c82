#include "dfr/safety/guard_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/archive.h"
#include "dfr/core/random.h"
#include "dfr/kernel/cover_radius.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"

namespace dfr::safety {
namespace {

using testing::AnyOf;
using testing::HasSubstr;

class GuardFileTest : public testing::Test {
 protected:
  GuardFileTest()
      : path_(std::filesystem::path(testing::TempDir()) /
              (std::string(testing::UnitTest::GetInstance()->current_test_info()->name()) +
               ".guard")) {}
  ~GuardFileTest() override { std::filesystem::remove(path_); }

  // Small: the tests try every truncation and many damages.
  static std::shared_ptr<const GuardModel> Small() {
    return GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(2, 6, 4),
                           {.features = "tip", .source = "six demonstrations"});
  }

  std::string Content() const {
    std::ostringstream out;
    out << std::ifstream(path_, std::ios::binary).rdbuf();
    return out.str();
  }
  void Replace(const std::string& content) const {
    std::ofstream(path_, std::ios::binary | std::ios::trunc) << content;
  }
  // Returns Load()'s error about the file; "" if it is valid.
  std::string Refusal() const {
    try {
      static_cast<void>(GuardModel::Load(path_));
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "";
  }

  std::filesystem::path path_;
};

TEST_F(GuardFileTest, KeepsAllBits) {
  const auto model =
      GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(2, 20),
                      {.features = "tip", .horizon = 33, .source = "twenty demonstrations"});
  model->Save(path_);
  const auto loaded = GuardModel::Load(path_);
  EXPECT_EQ(loaded->layout(), model->layout());
  EXPECT_EQ(loaded->lambda(), model->lambda());
  EXPECT_EQ(loaded->settings().strategy, Strategy::kGuard);
  EXPECT_EQ(loaded->settings().horizon, 33);
  EXPECT_EQ(loaded->settings().max_actions, model->settings().max_actions);
  EXPECT_EQ(loaded->settings().alarm_level, model->settings().alarm_level);
  EXPECT_EQ(loaded->summary().source, "twenty demonstrations");
  EXPECT_EQ(loaded->summary().demonstrations, 20);
  EXPECT_EQ(loaded->summary().transitions, 400);
  EXPECT_EQ(loaded->summary().acceptance, model->summary().acceptance);

  Guard ours(model);
  Guard theirs(loaded);
  core::Random random(3);
  for (int episode = 0; episode < 5; ++episode) {
    const auto seed = static_cast<std::uint64_t>(episode);
    ours.Reset(seed);
    theirs.Reset(seed);
    test::CorridorPlant plant;
    std::vector<double> action(2);
    std::vector<double> safe(2);
    std::vector<double> same(2);
    for (int t = 0; t < 30; ++t) {
      for (double& a : action) a = 0.1 * random.Normal();
      const Verdict a = ours.Filter(t, plant.x, action, safe);
      const Verdict b = theirs.Filter(t, plant.x, action, same);
      ASSERT_EQ(a.mode, b.mode);
      ASSERT_EQ(a.g, b.g);
      ASSERT_EQ(a.alarm, b.alarm);
      ASSERT_EQ(safe, same);
      plant.Apply(safe);
    }
  }
  // Saving again gives the same file.
  const std::string before = Content();
  loaded->Save(path_);
  EXPECT_EQ(Content(), before);
}

// Archives are cut at and damaged in every byte by the tests of core; here, in some of each
// section.
TEST_F(GuardFileTest, CutsAreRefused) {
  Small()->Save(path_);
  const std::string content = Content();
  for (std::size_t size = 0; size < content.size(); size += 1 + content.size() / 300) {
    Replace(content.substr(0, size));
    ASSERT_THAT(Refusal(), AnyOf(HasSubstr("truncated"), HasSubstr("is empty"),
                                 HasSubstr("not a file written by dfr")))
        << size << " bytes of " << content.size();
  }
  Replace(content);
  EXPECT_EQ(Refusal(), "");
}

TEST_F(GuardFileTest, DamagedBytesAreRefused) {
  Small()->Save(path_);
  const std::string content = Content();
  core::Random random(11);
  for (std::size_t at = 0; at < content.size(); at += 1 + content.size() / 300) {
    std::string damaged = content;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << random.Below(8)));
    Replace(damaged);
    ASSERT_NE(Refusal(), "") << "byte " << at;
  }
}

// Damage with a valid checksum, as by another program: the file is refused, or its content is
// usable.
TEST_F(GuardFileTest, WrongContentWithARightChecksumDoesNoHarm) {
  Small()->Save(path_);
  const std::string content = Content();
  core::Random random(12);
  int refused = 0;
  for (int i = 0; i < 400; ++i) {
    std::string damaged = content.substr(0, content.size() - sizeof(std::uint64_t));
    for (std::uint64_t n = 1 + random.Below(3); n > 0; --n) {
      damaged[random.Below(damaged.size())] = static_cast<char>(random.Below(256));
    }
    if (random.Below(8) == 0) damaged.resize(random.Below(damaged.size()));
    std::uint64_t checksum = 0xcbf29ce484222325u;  // FNV-1a
    for (const char c : damaged) {
      checksum = (checksum ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
    }
    damaged.append(reinterpret_cast<const char*>(&checksum), sizeof checksum);
    Replace(damaged);
    std::shared_ptr<const GuardModel> model;
    try {
      model = GuardModel::Load(path_);
    } catch (const std::runtime_error& e) {
      ASSERT_THAT(e.what(), HasSubstr(path_.string()));
      ++refused;
      continue;
    }
    Guard guard(model);
    guard.Reset(1);
    const std::vector<double> state(static_cast<std::size_t>(model->state_dim()), 0.1);
    std::vector<double> action(static_cast<std::size_t>(model->action_dim()), 0.1);
    for (int t = 0; t < 6; ++t) {
      static_cast<void>(guard.Filter(t, state, action, action));
      for (const double a : action) ASSERT_TRUE(std::isfinite(a));
    }
  }
  EXPECT_GT(refused, 40);
  EXPECT_LT(refused, 400);
}

TEST_F(GuardFileTest, OtherVersionsAndFilesAreRefusedByName) {
  core::ArchiveWriter("guard", 5).Save(path_);
  EXPECT_THAT(Refusal(), HasSubstr("is a guard file of version 5; this program reads version 2: "
                                   "fit it again"));
  core::ArchiveWriter("time-varying-support", 1).Save(path_);
  EXPECT_THAT(Refusal(), HasSubstr("is a time-varying-support file, where a guard file is needed"));
  std::filesystem::remove(path_);
  EXPECT_THAT(Refusal(), HasSubstr("cannot be opened"));
}

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
  // 40 of 400 on the average over sets of 60 demonstrations, whose threshold itself scatters: its
  // level is a beta variable of standard deviation sqrt(.1 .9 / 62) = .04. Three of these.
  EXPECT_LT(alarms, 400 * (0.1 + 3 * 0.04));
}

// The fit does not depend on the order of recording.
TEST_F(GuardFileTest, TheOrderOfDemonstrationsChangesNoBitOfTheFit) {
  const auto demonstrations = test::CorridorDemonstrations(5, 14, 6);
  const auto fit = [&](const std::vector<core::Trajectory>& some, double hold_out) {
    const auto model = GuardModel::Fit(
        test::CorridorLayout(), some,
        {.features = "tip", .strategy = Strategy::kCertified, .hold_out = hold_out});
    return std::pair(model, model->summary());
  };
  for (const double hold_out : {0.0, 0.3}) {
    SCOPED_TRACE(hold_out);
    const auto [model, summary] = fit(demonstrations, hold_out);
    for (std::uint64_t seed = 1; seed <= 5; ++seed) {
      std::vector<core::Trajectory> permuted = demonstrations;
      core::Random(seed).Shuffle(std::span(permuted));
      const auto [other, other_summary] = fit(permuted, hold_out);
      EXPECT_EQ(other->settings().alarm_level, model->settings().alarm_level);
      EXPECT_EQ(other->settings().direction_error, model->settings().direction_error);
      EXPECT_EQ(other->lambda(), model->lambda());
      EXPECT_EQ(other_summary.acceptance, summary.acceptance);
      EXPECT_EQ(other_summary.gain.value, summary.gain.value);
      // One support of all fitted demonstrations, then one without each of five folds and five
      // stretches: four of the nine demonstrations that are not held out.
      EXPECT_EQ(summary.support_fits, hold_out > 0.0 ? 9 : 11);
      EXPECT_EQ(other_summary.support_fits, summary.support_fits);
      core::ArchiveWriter ours("recovery", 1);
      model->task().Save(ours);
      ours.Save(path_);
      const std::string expected = Content();
      core::ArchiveWriter theirs("recovery", 1);
      other->task().Save(theirs);
      theirs.Save(path_);
      EXPECT_EQ(Content(), expected) << seed;
    }
  }
}

// A supervisor who cycles through goals: d mod folds would leave out each goal as a whole.
TEST(GuardModelTest, ASupervisorWhoCyclesThroughGoalsLosesNothing) {
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
  // Recorded one goal after the other, a stretch of the recording is a goal.
  EXPECT_THAT(Warnings(*sorted), testing::Contains(HasSubstr("conditions of recording drift")));
  EXPECT_GT(sorted->summary().drift_level, sorted->settings().alarm_level + 0.2);
  EXPECT_LT(sorted->summary().drift_chance, 0.01);
  EXPECT_THAT(Warnings(*cycled),
              testing::Not(testing::Contains(HasSubstr("conditions of recording drift"))));
}

// Four demonstrations are left out in pairs. Of the three ways to pair them, one is that in which
// they are left out anyway: no demonstration is further outside then. The others have up to four
// ranks of Wilcoxon's test, whose sum has the mean 5 and the variance 4 * 5 * 9 / 24 = 7.5.
TEST(GuardModelTest, StretchesThatAreLeftOutAnywayTellOfNoDrift) {
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

// A demonstration that never leaves has all of its states inside.
TEST(GuardModelTest, AcceptanceIsOfStatesAndOfWholeDemonstrations) {
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

// With held-out demonstrations, the alarm rate of a fit stays below the guaranteed one with the
// guaranteed confidence.
TEST(GuardModelTest, AConfidenceHoldsForThatShareOfFits) {
  constexpr int kFits = 30;
  int kept = 0;
  for (int fit = 0; fit < kFits; ++fit) {
    const auto seed = static_cast<std::uint64_t>(fit);
    const auto model = GuardModel::Fit(
        test::CorridorLayout(), test::CorridorDemonstrations(100 + seed, 60, 6),
        {.features = "tip", .false_alarms = 0.2, .confidence = 0.8, .hold_out = 0.5});
    EXPECT_EQ(model->summary().held_out, 30);
    EXPECT_EQ(model->summary().confidence, 0.8);
    int alarms = 0;
    for (const auto& unseen : test::CorridorDemonstrations(1000 + seed, 200, 6)) {
      const std::vector<double> levels = model->Levels(unseen.states);
      alarms += *std::min_element(levels.begin(), levels.end()) < -model->settings().alarm_level;
    }
    kept += alarms <= 40 ? 1 : 0;
  }
  // Binomial(30, .8): 24 expected at least, standard deviation 2.2; three of these.
  EXPECT_GE(kept, 24 - 7);
}

TEST(GuardModelTest, CertificatesNeedTheirConstantsAndDoublePrecision) {
  GuardOptions options{.features = "tip"};
  options.support.single_precision = true;
  const auto demonstrations = test::CorridorDemonstrations(1, 20);
  const auto message = [](const auto& call) -> std::string {
    try {
      call();
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
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

// By its definition: every outcome that the assumption allows raises no alarm.
TEST(GuardModelTest, CertifySaysWhichActionsProvablyRaiseNoAlarm) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                     {.features = "tip"});
  const double eps = model->settings().direction_error;
  const kernel::WhitenedSupport& support = model->task().feature_support();
  const core::FeatureTransform& features = model->task().features();
  core::Random random(3);
  int passed = 0;
  int refused = 0;
  for (int i = 0; i < 400; ++i) {
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
      const auto deepest = [&](const Eigen::VectorXd& there) {
        double best = -std::numeric_limits<double>::infinity();
        for (int q = 0; q < support.num_steps(); ++q) {
          best = std::max(best, support.LogDecision(q, core::AsSpan(there), {}));
        }
        return best;
      };
      if (found.passes) {
        EXPECT_GE(deepest(z + found.effect + error * direction),
                  -model->settings().alarm_level - 1e-9);
      }
      if (found.radius > 0.0) {
        EXPECT_GE(deepest(z + found.radius * direction), -model->settings().alarm_level - 1e-9);
        EXPECT_GE(deepest(z + found.shift + found.ball_radius * direction),
                  -model->settings().alarm_level - 1e-9);
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

// In the unit of the state: no state that raises no alarm is further from all demonstrated ones.
TEST(GuardModelTest, ClearanceIsADistanceThatNoStateWithoutAlarmExceeds) {
  const auto demonstrations = test::CorridorDemonstrations(1, 30);
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  const auto clearances = Clearances(*model);
  ASSERT_EQ(clearances.size(), 1u) << "no feature looks at the clock";
  EXPECT_EQ(clearances[0].block, "tip");
  EXPECT_GE(clearances[0].largest, clearances[0].median);
  double furthest = 0.0;
  core::Random random(8);
  for (int i = 0; i < 20000; ++i) {
    const std::vector<double> x = {0.0, random.Uniform(-1.0, 3.0), random.Uniform(-1.0, 1.0)};
    const int t = static_cast<int>(random.Below(20));
    if (model->support().LogDecision(t, x, {}) < -std::max(0.0, model->settings().alarm_level)) {
      continue;
    }
    double nearest = std::numeric_limits<double>::infinity();
    for (const auto& d : demonstrations) {
      for (const auto& row : d.states.rowwise()) {
        nearest = std::min(nearest, std::hypot(row[1] - x[1], row[2] - x[2]));
      }
    }
    furthest = std::max(furthest, nearest);
  }
  EXPECT_GT(furthest, 0.02);
  EXPECT_LE(furthest, clearances[0].largest);
}

// One feature alone: the radius of the support divided by the scale of the feature.
TEST(GuardModelTest, ClearanceOfOneFeatureIsWhatEachTimeStepCovers) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 30),
                                     {.features = "tip[1:2]"});
  const kernel::WhitenedSupport& support = model->task().feature_support();
  const double level = std::max(0.0, model->settings().alarm_level);
  std::vector<double> lengths;
  for (int t = 0; t < support.num_steps(); ++t) {
    const double scale = support.map(t)(0, 0) * model->task().features().scale()(0, 0);
    lengths.push_back(kernel::CoverRadius(support.estimate(t), level) / std::abs(scale));
  }
  ASSERT_EQ(lengths.size(), 21u);
  const auto clearances = Clearances(*model);
  ASSERT_EQ(clearances.size(), 1u);
  EXPECT_EQ(clearances[0].block, "tip");
  const auto largest = std::max_element(lengths.begin(), lengths.end());
  EXPECT_NEAR(clearances[0].largest, *largest, 1e-12 * *largest);
  EXPECT_EQ(clearances[0].step, largest - lengths.begin());
  std::sort(lengths.begin(), lengths.end());
  EXPECT_NEAR(clearances[0].median, lengths[10], 1e-12 * lengths[10]);
}

TEST(GuardModelTest, LevelsFollowFasterAndSlowerEpisodes) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                     {.features = "tip"});
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

// Half of the demonstrations go round at y = 2.
TEST(GuardModelTest, AttributionNamesTheEntriesThatPutAStateOutside) {
  const std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(1, 40);
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  core::Matrix states = demonstrations[3].states;
  const core::Matrix inside = Attribution(*model, states);
  states.rightCols(1).array() += 1.0;
  states.col(0).array() += 100.0;  // no feature looks at it
  const std::vector<double> levels = model->Levels(states);
  const core::Matrix attribution = Attribution(*model, states);
  ASSERT_EQ(attribution.rows(), states.rows());
  ASSERT_EQ(attribution.cols(), 3);
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    const double l = levels[static_cast<std::size_t>(i)];
    ASSERT_LT(l, 0.0);
    EXPECT_NEAR(attribution.row(i).sum(), -l, 1e-9 * -l);
    EXPECT_EQ(attribution(i, 0), 0.0);
    EXPECT_GT(attribution(i, 2), 0.6 * -l);
    const double own = model->Levels(demonstrations[3].states)[static_cast<std::size_t>(i)];
    if (own >= 0.0) {
      EXPECT_EQ(inside.row(i).cwiseAbs().sum(), 0.0);
    }
  }
}

// The same demonstrations with one entry in other units: millimetres instead of metres.
TEST(GuardModelTest, AttributionDoesNotDependOnUnits) {
  std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(1, 40);
  core::Matrix states = demonstrations[0].states;
  states.rightCols(2).array() += 0.7;
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  const core::Matrix attribution = Attribution(*model, states);
  for (core::Trajectory& d : demonstrations) d.states.col(2) *= 1024.0;
  states.col(2) *= 1024.0;
  const auto scaled = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  EXPECT_TRUE(test::AllClose(Attribution(*scaled, states), attribution, 1e-3));
}

// Few long demonstrations with different paces: most states of a left-out one are far from the
// others at that time step. Its supports pool more time steps then, and short ones never do.
TEST(GuardModelTest, LongDemonstrationsOfDifferingPaceAreMostlyInside) {
  const auto walk = [](int count, int shortest, int spread) {
    core::Random random(5);
    std::vector<core::Trajectory> demonstrations;
    for (int d = 0; d < count; ++d) {
      const int steps = shortest + static_cast<int>(random.Below(spread));
      const double aside = 0.05 * random.Normal();
      core::Trajectory trajectory;
      trajectory.states.resize(steps + 1, 3);
      for (int t = 0; t <= steps; ++t) {
        const double share = static_cast<double>(t) / steps;
        trajectory.states.row(t) << 0.0, share, aside + 0.3 * std::sin(6.0 * share);
      }
      trajectory.controls = trajectory.states.bottomRows(steps).rightCols(2) -
                            trajectory.states.topRows(steps).rightCols(2);
      trajectory.outcome = core::Outcome::kCompleted;
      demonstrations.push_back(std::move(trajectory));
    }
    return demonstrations;
  };
  core::StateLayout layout;
  layout.Add("clock", 1);
  layout.Add("tip", 2);
  GuardOptions options{.features = "tip"};
  GuardOptions fixed = options;
  fixed.support.window_share = 0.0;
  const auto pooled = GuardModel::Fit(layout, walk(16, 200, 400), options);
  const auto alone = GuardModel::Fit(layout, walk(16, 200, 400), fixed);
  EXPECT_LT(alone->summary().acceptance, 0.8);
  EXPECT_LT(1.0 - pooled->summary().acceptance, 0.7 * (1.0 - alone->summary().acceptance));
  EXPECT_EQ(GuardModel::Fit(layout, walk(16, 20, 30), options)->summary().acceptance,
            GuardModel::Fit(layout, walk(16, 20, 30), fixed)->summary().acceptance);
}

TEST(GuardModelTest, AKernelThatFillsTheRoomBetweenTwoWaysIsMadeNarrower) {
  auto demonstrations = test::CorridorDemonstrations(1, 40);
  for (std::size_t d = 0; d < demonstrations.size(); d += 2) {
    demonstrations[d].states.col(2).array() += 2.0;
  }
  GuardOptions options{.features = "tip"};
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_EQ(model->summary().gamma, options.support.svm.gamma);
  EXPECT_GE(model->summary().gaps.points, model->num_steps() - 2);
  EXPECT_EQ(model->summary().gaps.inside, 0);
  options.support.svm.gamma = 0.01;
  const auto narrowed = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_GT(narrowed->summary().gamma, 0.01);
  EXPECT_LE(narrowed->summary().gamma, 0.04);
  options.support.svm.gamma = 1e-4;
  const auto wide = GuardModel::Fit(test::CorridorLayout(), demonstrations, options);
  EXPECT_EQ(wide->summary().gamma, 4e-4);
  EXPECT_THAT(Warnings(*wide), testing::Contains(HasSubstr("demonstrations take several ways")));
}

TEST(GuardModelTest, EachEntryOfAnActionReachesHalfAsFarAgainUnlessALimitIsGiven) {
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

TEST(GuardModelTest, FindingsNameWhatSpeaksAgainstAGuardAndTheRemedy) {
  const auto good = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                    {.features = "tip", .action_limit = {0.2}});
  EXPECT_THAT(Warnings(*good), testing::IsEmpty());
  const auto few = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 4),
                                   {.features = "tip", .action_limit = {0.2}});
  EXPECT_THAT(Warnings(*few), testing::Contains(HasSubstr("4 demonstrations cannot tell")));
  GuardSettings settings = good->settings();
  settings.alarm_level = 3.5;
  settings.action_limit = {50.0};
  EXPECT_THAT(Warnings(*good->With(settings)),
              testing::ElementsAre(HasSubstr("alarm is raised below l = -3.5"),
                                   HasSubstr("entry 0 of an action may reach 50"),
                                   HasSubstr("give --action-limit")));
  // A kernel so narrow that no unseen state is inside.
  GuardOptions narrow{.features = "tip", .action_limit = {0.2}, .accept_any = true};
  narrow.support.svm.gamma = 1e3;
  EXPECT_THAT(Warnings(*GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                        narrow)),
              testing::Contains(HasSubstr("of the states of left-out demonstrations are inside")));
}

TEST(GuardModelTest, FindingsNameFeaturesThatFollowTheClock) {
  const auto demonstrations = test::CorridorDemonstrations(1, 40);
  const auto whole =
      GuardModel::Fit(test::CorridorLayout(), demonstrations, {.action_limit = {0.2}});
  EXPECT_THAT(FitWarnings(*whole, demonstrations),
              testing::Contains(testing::StartsWith("clock[0]: the same in all demonstrations")));
  const auto tip = GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                   {.features = "tip", .action_limit = {0.2}});
  EXPECT_THAT(FitWarnings(*tip, demonstrations), testing::IsEmpty());
}

TEST(GuardModelTest, AClockIsOneInAnyUnitAndWhatStandsStillIsNone) {
  constexpr const char* kClock = "the same in all demonstrations";
  const auto demonstrations = test::CorridorDemonstrations(1, 40);
  const auto whole = GuardModel::Fit(test::CorridorLayout(), demonstrations);
  auto slow = demonstrations;
  for (core::Trajectory& d : slow) d.states.col(0) *= 1e-6;
  EXPECT_THAT(FitWarnings(*whole, slow),
              testing::Contains(testing::StartsWith("clock[0]: the same")));
  auto still = demonstrations;
  for (core::Trajectory& d : still) d.states.col(0).setConstant(3.0);
  EXPECT_THAT(FitWarnings(*whole, still), testing::Not(testing::Contains(HasSubstr(kClock))));
  // The last part of the longest demonstration has no other to compare with.
  const auto tip = GuardModel::Fit(test::CorridorLayout(), demonstrations, {.features = "tip"});
  auto longer = test::CorridorDemonstrations(1, 40);
  longer.push_back(test::CorridorDemonstrations(2, 1, 25)[0]);
  longer.back().states.bottomRows(5).array() += 1e6;
  EXPECT_THAT(FitWarnings(*tip, longer), testing::Not(testing::Contains(HasSubstr(kClock))));
}

TEST(GuardModelTest, ActionsThatContradictWhatHappensExplainNothing) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                     {.features = "tip", .action_limit = {0.2}});
  // Slightly backwards, where the demonstrated action is forwards.
  core::Trajectory back;
  back.states.resize(2, 3);
  back.states << 0.0, 0.0, 0.0, 1.0, -0.02, 0.0;
  back.controls = test::ActionFor(test::kSpeed, 0.0).transpose();
  EXPECT_THAT(FitWarnings(*model, std::vector{back}),
              testing::Contains(testing::StartsWith("actions explain only 0 % of")));
  // Constant states need no explanation.
  back.states.row(1) = back.states.row(0);
  EXPECT_THAT(FitWarnings(*model, std::vector{back}), testing::IsEmpty());
}

TEST(GuardModelTest, APromiseSaysOfWhichFitsAndByWhichDemonstrations) {
  GuardSummary summary;
  EXPECT_EQ(DescribeGuarantee(summary),
            "on average over fits, approximately: by fits that left some out");
  summary.held_out = 12;
  EXPECT_EQ(DescribeGuarantee(summary),
            "on average over fits, by 12 demonstrations that nothing was fitted to");
  summary.confidence = 0.95;
  EXPECT_EQ(DescribeGuarantee(summary),
            "with 95 % confidence for this fit, by 12 demonstrations that nothing was fitted to");
}

TEST(GuardModelTest, FindingsNameActionsThatDoNotMoveWhatIsLookedAt) {
  core::Random random(3);
  auto demonstrations = test::CorridorDemonstrations(1, 40);
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      d.states.row(t).tail(2) << random.Normal(), random.Normal();
    }
  }
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations,
                                     {.features = "tip", .action_limit = {0.2}});
  EXPECT_THAT(FitWarnings(*model, demonstrations),
              testing::Contains(testing::StartsWith("actions explain only")));
}

TEST(GuardModelTest, FewDemonstrationsPromiseLess) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 4),
                                     {.features = "tip", .false_alarms = 0.01});
  EXPECT_EQ(model->summary().false_alarms, 0.2) << "1 / (4 + 1)";
  EXPECT_TRUE(std::isfinite(model->settings().alarm_level));
}

TEST(GuardModelTest, SupportOfWholeStatesIsThatOfFeatures) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 20),
                                     {.features = "tip"});
  const core::LogDecisionFunction& support = model->support();
  core::Random random(4);
  for (int i = 0; i < 20; ++i) {
    std::vector<double> x = {random.Normal(), 0.1 * i + 0.1 * random.Normal(),
                             0.2 * random.Normal()};
    std::vector<double> z(2);
    model->task().features().Apply(x, z);
    EXPECT_EQ(support.Decision(i, x), model->task().feature_support().Decision(i, z));
    std::vector<double> gradient(3);
    std::vector<double> log_gradient(3);
    // The sums of values and of gradients are rounded in their own order; l may be some hundreds.
    EXPECT_NEAR(support.Gradient(i, x, gradient), support.Decision(i, x), 1e-14);
    EXPECT_NEAR(support.LogDecision(i, x, log_gradient), support.LogDecision(i, x, {}), 1e-11);
    EXPECT_EQ(gradient[0], 0.0) << "no feature";
    for (std::size_t k = 1; k < 3; ++k) {
      constexpr double kStep = 1e-5;
      const double at = x[k];
      x[k] = at + kStep;
      const double above = support.Decision(i, x);
      const double log_above = support.LogDecision(i, x, {});
      x[k] = at - kStep;
      const double below = support.Decision(i, x);
      const double log_below = support.LogDecision(i, x, {});
      x[k] = at;
      // A third derivative of up to a thousand (features are scaled by ten), times step squared.
      EXPECT_NEAR(gradient[k], (above - below) / (2 * kStep), 1e-6);
      EXPECT_NEAR(log_gradient[k], (log_above - log_below) / (2 * kStep), 1e-5);
    }
    EXPECT_LE(Eigen::Map<Eigen::VectorXd>(gradient.data(), 3).norm(), support.lipschitz_bound(i));
  }
  const std::vector<double> broken = {0.0, std::numeric_limits<double>::quiet_NaN(), 0.0};
  EXPECT_EQ(support.Decision(0, broken), -std::numeric_limits<double>::infinity());
  EXPECT_EQ(support.Decision(0, std::vector{1.0}), -std::numeric_limits<double>::infinity());
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
  EXPECT_THAT(fit(bad), HasSubstr("demonstration 0 has states of 2 entries, the layout 3"));
  EXPECT_THAT(fit(good, {.features = "gripper"}), HasSubstr("feature 'gripper'"));
  EXPECT_THAT(fit(good, {.features = "tip", .horizon = -1}), HasSubstr("horizon"));
  // A file that no loader takes is not written.
  EXPECT_THAT(fit(good, {.features = "tip", .horizon = 1073741825}), HasSubstr("horizon"));
  EXPECT_THAT(fit(good, {.features = "tip", .horizon = std::numeric_limits<int>::max()}),
              HasSubstr("horizon"));
  EXPECT_THAT(fit(good, {.features = "tip", .false_alarms = 1.0}),
              HasSubstr("false_alarms must lie in (0, 1)"));
  EXPECT_THAT(fit(good, {.features = "tip", .folds = 1}), HasSubstr("folds"));

  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  EXPECT_THAT(fit(good, {.features = "tip", .false_alarms = 0.0}),
              HasSubstr("false_alarms must lie in (0, 1)"));
  EXPECT_THAT(fit(good, {.features = "tip", .action_limit = {-1.0}}),
              HasSubstr("action_limit must be finite and not negative"));
  for (const double share : {-0.01, 0.51}) {
    EXPECT_THAT(fit(good, {.features = "tip", .hold_out = share}),
                HasSubstr("hold_out must lie in [0, .5]"));
  }
  EXPECT_THAT(fit(good, {.features = "tip", .hold_out = 0.5}),
              HasSubstr("holding out 3 of 5 demonstrations leaves fewer than 3"));
  EXPECT_EQ(fit(good, {.features = "tip", .hold_out = 0.4}), "nothing thrown");
  for (const double factor : {0.0, kInfinity}) {
    EXPECT_THAT(fit(good, {.features = "tip", .error_factor = factor}),
                HasSubstr("error_factor must be positive and finite"));
  }
  EXPECT_EQ(fit(good, {.features = "tip", .folds = 2}), "nothing thrown");

  const auto model = GuardModel::Fit(layout, good, {.features = "tip"});
  const auto refusal = [&](auto GuardSettings::*member, auto value) {
    GuardSettings settings = model->settings();
    settings.*member = value;
    return test::MessageOf<std::invalid_argument>(
        [&] { static_cast<void>(model->With(settings)); });
  };
  for (const double limit : {-0.1, kInfinity, std::nan("")}) {
    EXPECT_THAT(refusal(&GuardSettings::action_limit, std::vector{0.1, limit}),
                HasSubstr("action_limit must be finite and not negative: entry 1"));
  }
  EXPECT_THAT(refusal(&GuardSettings::action_limit, std::vector{0.0, 0.0}),
              HasSubstr("nothing could move"));
  EXPECT_THAT(refusal(&GuardSettings::action_limit, std::vector{0.1, 0.1, 0.1}),
              HasSubstr("action_limit has 3 entries, actions 2"));
  for (const int wrong : {0, (1 << 30) + 1}) {
    EXPECT_THAT(refusal(&GuardSettings::horizon, wrong), HasSubstr("horizon must lie in [1, "));
    EXPECT_THAT(refusal(&GuardSettings::max_actions, wrong),
                HasSubstr("max_actions must lie in [1, "));
  }
  for (const int right : {1, 1 << 30}) {
    EXPECT_EQ(refusal(&GuardSettings::horizon, right), "nothing thrown");
    EXPECT_EQ(refusal(&GuardSettings::max_actions, right), "nothing thrown");
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

TEST(GuardModelTest, FileNamesOfObservationsAreStripped) {
  EXPECT_EQ(core::StripObservationPrefixes("obs/object,obs/robot0_eef_pos[0:3]"),
            "object,robot0_eef_pos[0:3]");
  EXPECT_EQ(core::StripObservationPrefixes("observations/tip,tilt"), "tip,tilt");
  EXPECT_EQ(core::StripObservationPrefixes(""), "");
}

}  // namespace
}  // namespace dfr::safety
