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
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/archive.h"
#include "dfr/core/random.h"
#include "dfr/safety/guard.h"
#include "tests/safety/corridor.h"

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

  // Small, so that every cut and many damages can be tried.
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
  // What Load() says of the file; "" if it takes it.
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
  EXPECT_EQ(loaded->settings().strategy, Strategy::kGuided);
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

TEST_F(GuardFileTest, EveryCutIsRefused) {
  Small()->Save(path_);
  const std::string content = Content();
  for (std::size_t size = 0; size < content.size(); ++size) {
    Replace(content.substr(0, size));
    ASSERT_THAT(Refusal(), AnyOf(HasSubstr("truncated"), HasSubstr("is empty"),
                                 HasSubstr("not a file written by dfr")))
        << size << " bytes of " << content.size();
  }
  Replace(content);
  EXPECT_EQ(Refusal(), "");
}

TEST_F(GuardFileTest, EveryDamagedByteIsRefused) {
  Small()->Save(path_);
  const std::string content = Content();
  core::Random random(11);
  for (std::size_t at = 0; at < content.size(); ++at) {
    std::string damaged = content;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << random.Below(8)));
    Replace(damaged);
    ASSERT_NE(Refusal(), "") << "byte " << at;
  }
}

// Damage that the checksum does not see, as of a file that another program wrote wrongly: it is
// refused, or what it holds can be used.
TEST_F(GuardFileTest, WrongContentWithARightChecksumDoesNoHarm) {
  Small()->Save(path_);
  const std::string content = Content();
  core::Random random(12);
  int refused = 0;
  for (int i = 0; i < 4000; ++i) {
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
  EXPECT_GT(refused, 400);
  EXPECT_LT(refused, 4000);
}

TEST_F(GuardFileTest, NewerAndOtherFilesAreRefusedByName) {
  core::ArchiveWriter("guard", 4).Save(path_);
  EXPECT_THAT(Refusal(), HasSubstr("version 4; this build reads versions up to 3: update dfr"));
  core::ArchiveWriter("time-varying-support", 1).Save(path_);
  EXPECT_THAT(Refusal(), HasSubstr("holds a time-varying-support, where a guard is needed"));
  std::filesystem::remove(path_);
  EXPECT_THAT(Refusal(), HasSubstr("cannot be opened"));
}

// docs/packages.md: every version reads the files of all before it. The file is what Small() saved
// when that was the newest version, and so are the numbers.
TEST_F(GuardFileTest, AFileOfVersion1IsReadByAllLaterOnes) {
  const auto model = GuardModel::Load(DFR_SAFETY_FILES "/version_1.guard");
  EXPECT_EQ(model->layout(), test::CorridorLayout());
  EXPECT_EQ(model->num_steps(), 5);
  EXPECT_EQ(model->action_dim(), 2);
  EXPECT_EQ(model->settings().strategy, Strategy::kGuided);
  EXPECT_EQ(model->settings().horizon, 8);
  EXPECT_EQ(model->summary().source, "six demonstrations");
  const std::vector<double> inside = {0.0, 0.02, 0.01};
  const std::vector<double> outside = {0.0, 0.5, -0.4};
  // Other instruction sets round g otherwise, by 1e-12 of rho at the most.
  EXPECT_NEAR(model->support().Decision(0, inside), 0.030404204367598886, 1e-12);
  EXPECT_NEAR(model->support().Decision(2, outside), -0.27505503021144639, 1e-12);
  EXPECT_NEAR(model->lambda()[1], 0.31560438024818965, 1e-12);
  EXPECT_NEAR(model->settings().alarm_level, 0.44441348401161695, 1e-12);
  EXPECT_EQ(model->recovery().model().slack(), 0.2);
  EXPECT_NEAR(model->recovery().model().gate_level(1), 0.10484338114468128, 1e-12);
  EXPECT_NEAR(model->recovery().model().largest_control(1), 1.4067651325850505, 1e-12);
  EXPECT_NEAR(model->recovery().model().control_unit(), 0.11371979690725259, 1e-12);

  core::Matrix states(5, 3);
  states << 0.0, 0.0, 0.02, 1.0, 0.1, 0.01, 2.0, 0.21, -0.02, 3.0, 0.5, 0.4, 4.0, 0.42, 0.0;
  std::vector<int> steps;
  const std::vector<double> levels = model->Levels(states, &steps);
  EXPECT_EQ(steps, (std::vector<int>{0, 1, 1, 2, 3}));
  const std::vector<double> expected = {0.081172332943678649, 0.10989212626895828,
                                        0.095172277932188409, -4.9474935719867776,
                                        0.094895221218566306};
  for (std::size_t i = 0; i < levels.size(); ++i) EXPECT_NEAR(levels[i], expected[i], 1e-11);

  // An episode of what was published, into a recovery; how guided recovery drives may change.
  GuardSettings settings = model->settings();
  settings.strategy = Strategy::kDfr;
  Guard guard(model->With(settings));
  guard.Reset(7);
  test::CorridorPlant plant;
  plant.x = {0.0, 0.0, 0.02};
  std::vector<double> safe(2);
  const std::vector<double> g = {0.025602115014171756, 0.035427067766005071, 0.017046082540605356,
                                 0.015791220872879375, 0.015817027790075378};
  for (int t = 0; t < 5; ++t) {
    const Verdict verdict = guard.Filter(t, plant.x, std::vector{0.03, -0.06}, safe);
    EXPECT_NEAR(verdict.g, g[static_cast<std::size_t>(t)], 1e-12);
    EXPECT_STREQ(verdict.reason(), t < 3 ? "inside" : t == 3 ? "probe" : "recovery");
    EXPECT_EQ(verdict.step, std::min(t, 3));
    plant.Apply(safe);
  }
  EXPECT_NEAR(safe[0], 0.0011282467023324199, 1e-12);
  EXPECT_NEAR(safe[1], -0.00037745538523032367, 1e-12);
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

TEST(GuardModelTest, FindingsNameWhatSpeaksAgainstAGuardAndTheRemedy) {
  const auto good = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                    {.features = "tip", .action_limit = 0.2});
  EXPECT_THAT(Findings(*good), testing::IsEmpty());
  const auto few = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 4),
                                   {.features = "tip", .action_limit = 0.2});
  EXPECT_THAT(Findings(*few), testing::Contains(HasSubstr("4 demonstrations cannot tell")));
  GuardSettings settings = good->settings();
  settings.alarm_level = 3.5;
  settings.action_limit = 50.0;
  EXPECT_THAT(Findings(*good->With(settings)),
              testing::ElementsAre(HasSubstr("alarm is raised below l = -3.5"),
                                   HasSubstr("give --action-limit")));
  // A kernel so narrow that no unseen state is inside.
  GuardOptions narrow{.features = "tip", .action_limit = 0.2};
  narrow.support.svm.gamma = 1e3;
  EXPECT_THAT(Findings(*GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                        narrow)),
              testing::Contains(HasSubstr("of the states of left-out demonstrations are inside")));
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
    model->recovery().features().Apply(x, z);
    EXPECT_EQ(support.Decision(i, x), model->recovery().support().Decision(i, z));
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

std::string MessageOf(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::invalid_argument& e) {
    return e.what();
  }
  return "nothing thrown";
}

TEST(GuardModelTest, WrongDemonstrationsAndOptionsAreNamed) {
  const auto layout = test::CorridorLayout();
  const auto good = test::CorridorDemonstrations(1, 5);
  const auto fit = [&](std::vector<core::Trajectory> demonstrations, GuardOptions options = {}) {
    return MessageOf([&] { static_cast<void>(GuardModel::Fit(layout, demonstrations, options)); });
  };
  EXPECT_THAT(fit({good[0], good[1]}), HasSubstr("at least 3 demonstrations, not 2"));
  auto bad = good;
  bad[2].states(4, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(fit(bad), HasSubstr("demonstration 2 has a non-finite entry"));
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
  EXPECT_THAT(fit(good, {.features = "tip", .false_alarms = 1.0}), HasSubstr("alpha"));
  EXPECT_THAT(fit(good, {.features = "tip", .folds = 1}), HasSubstr("folds"));

  const auto model = GuardModel::Fit(layout, good, {.features = "tip"});
  GuardSettings settings = model->settings();
  settings.action_limit = 0.0;
  EXPECT_THAT(MessageOf([&] { static_cast<void>(model->With(settings)); }),
              HasSubstr("action_limit must be positive"));
  EXPECT_THAT(MessageOf([&] { static_cast<void>(ParseStrategy("brave")); }),
              HasSubstr("no strategy 'brave'; there are: guided, dfr, early-stopping, monitor"));
}

TEST(GuardModelTest, FileNamesOfObservationsAreStripped) {
  EXPECT_EQ(StripObservationPrefixes("obs/object,obs/robot0_eef_pos[0:3]"),
            "object,robot0_eef_pos[0:3]");
  EXPECT_EQ(StripObservationPrefixes("observations/tip,tilt"), "tip,tilt");
  EXPECT_EQ(StripObservationPrefixes(""), "");
}

}  // namespace
}  // namespace dfr::safety
