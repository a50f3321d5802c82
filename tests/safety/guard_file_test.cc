#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"
#include "tests/safety/damaged.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::safety {
namespace {

using testing::HasSubstr;

class GuardFileTest : public testing::Test {
 protected:
  GuardFileTest()
      : path_(dfr::test::ProcessFolder() /
              (std::string(testing::UnitTest::GetInstance()->current_test_info()->name()) +
               ".guard")) {}
  ~GuardFileTest() override { std::filesystem::remove(path_); }

  // A small model, because the tests load many damaged files.
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
  // Returns Load()'s error about the file.
  std::string Refusal() const {
    return test::MessageOf<std::runtime_error>([&] { static_cast<void>(GuardModel::Load(path_)); });
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
  EXPECT_EQ(loaded->settings().horizon, 33);
  EXPECT_EQ(loaded->settings().max_actions, model->settings().max_actions);
  EXPECT_EQ(loaded->summary().source, "twenty demonstrations");
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

TEST_F(GuardFileTest, WrongContentWithAValidChecksumIsRefusedOrUsable) {
  Small()->Save(path_);
  const std::string content = Content();
  core::Random random(12);
  int refused = 0;
  for (int i = 0; i < 200; ++i) {
    Replace(test::Damaged(content, random));
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
  EXPECT_LT(refused, 200);
}

// Each file has one value that no fit produces. If it were loaded, its guard would accept states
// outside the support.
TEST_F(GuardFileTest, OneContradictoryValueIsRefusedByName) {
  auto demonstrations = test::CorridorDemonstrations(2, 6, 4);
  constexpr double kConstant = 0.1234567;
  for (core::Trajectory& d : demonstrations) d.states.col(0).setConstant(kConstant);
  const auto model = GuardModel::Fit(test::CorridorLayout(), demonstrations);
  model->Save(path_);
  const std::string content = Content();
  const auto refusal = [&](double value, double other) {
    const std::string changed = test::WithNumber(content, value, other);
    EXPECT_FALSE(changed.empty()) << value;
    Replace(changed);
    return Refusal();
  };
  const kernel::WhitenedSupport& support = model->task().feature_support();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  for (const double rho : {0.0, -0.5, 1.5, kInfinity, std::nan("")}) {
    EXPECT_THAT(refusal(support.estimate(1).rho(), rho), HasSubstr("rho must lie in (0, 1]"));
  }
  const double skewed = support.map(1)(0, 1);
  ASSERT_NE(skewed, 0.0);
  EXPECT_THAT(refusal(skewed, skewed + 0.01), HasSubstr("its map must be symmetric"));
  EXPECT_THAT(refusal(kConstant, kInfinity), HasSubstr("constant that is not finite"));
  Replace(content);
  EXPECT_NE(GuardModel::Load(path_), nullptr);
}

TEST_F(GuardFileTest, AnotherVersionIsRefusedByName) {
  core::ArchiveWriter("guard", 9).Save(path_);
  EXPECT_THAT(Refusal(), HasSubstr("is a guard file of version 9; this program reads version 8: "
                                   "fit it again"));
}

TEST_F(GuardFileTest, TheOrderOfDemonstrationsChangesNoBitOfTheFit) {
  const auto demonstrations = test::CorridorDemonstrations(5, 14, 6);
  const auto fit = [&](const std::vector<core::Trajectory>& some, double hold_out) {
    return GuardModel::Fit(
        test::CorridorLayout(), some,
        {.features = "tip", .strategy = Strategy::kCertified, .hold_out = hold_out});
  };
  const auto content = [&](const GuardModel& model) {
    core::ArchiveWriter writer("recovery", 1);
    model.task().Save(writer);
    writer.Save(path_);
    return Content();
  };
  for (const double hold_out : {0.0, 0.3}) {
    SCOPED_TRACE(hold_out);
    const auto model = fit(demonstrations, hold_out);
    const GuardSummary& summary = model->summary();
    // One support of all fitted demonstrations, and one without each fold: five folds and five
    // contiguous ones, or four of each for the nine demonstrations that are not held out.
    EXPECT_EQ(summary.support_fits, hold_out > 0.0 ? 9 : 11);
    for (std::uint64_t seed = 1; seed <= 2; ++seed) {
      std::vector<core::Trajectory> permuted = demonstrations;
      core::Random(seed).Shuffle(std::span(permuted));
      const auto other = fit(permuted, hold_out);
      EXPECT_EQ(other->settings().alarm_level, model->settings().alarm_level);
      EXPECT_EQ(other->settings().direction_error, model->settings().direction_error);
      EXPECT_EQ(other->summary().support_fits, summary.support_fits);
      for (const auto share : {&GuardSummary::acceptance, &GuardSummary::changed,
                               &GuardSummary::ends_outside, &GuardSummary::explained}) {
        EXPECT_EQ(other->summary().*share, summary.*share);
      }
      EXPECT_EQ(other->summary().gain.value, summary.gain.value);
      EXPECT_EQ(content(*other), content(*model)) << seed;
    }
  }
}

}  // namespace
}  // namespace dfr::safety
