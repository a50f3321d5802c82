#include "dfr/reduction/choose_components.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/reduction/principal_components.h"
#include "tests/reduction/gap_pictures.h"
#include "tests/support/message_of.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::HasSubstr;

// Returns the scores of `pictures` as states.
std::vector<core::Trajectory> Reduced(const test::GapPictures& pictures) {
  constexpr Eigen::Index kPixels = test::GapPictures::kPixels;
  Matrix rows(std::ssize(pictures.pixels) / kPixels, kPixels);
  std::ranges::copy(pictures.pixels, rows.data());
  const PrincipalComponents fit =
      FitPrincipalComponents(MatrixRows({&rows, 1}), {.components = 24, .scale_floor = 1.0});
  return pictures.WithScores(fit.scores);
}

TEST(ChooseComponentsTest, PicturesNeedMoreComponentsThanTheirStateHasEntries) {
  const ComponentsChoice choice =
      ChooseComponents(Reduced(test::MakeGapPictures(40, 1)), {.candidates = {3, 6, 10, 16, 24}});
  ASSERT_EQ(choice.table.size(), 5U);
  // The state has three entries, which the first three components do not determine.
  EXPECT_LT(choice.table[0].explained, 0.0);
  EXPECT_GT(choice.table[2].explained, 0.5);
  EXPECT_GT(choice.table[0].response_error, choice.table[2].response_error);
  // More components move states out of the support.
  EXPECT_GT(choice.table[0].inside, choice.table[2].inside);
  EXPECT_GT(choice.table[2].inside, choice.table[4].inside);
  EXPECT_EQ(choice.components, 10) << choice.reason;
  EXPECT_THAT(choice.reason, HasSubstr("10 components explain"));
}

TEST(ChooseComponentsTest, TheTrueStateNeedsAllItsEntries) {
  const ComponentsChoice choice =
      ChooseComponents(test::MakeGapPictures(40, 2).truth, {.candidates = {2, 3, 4}});
  ASSERT_EQ(choice.table.size(), 2U);  // There is no fourth component.
  EXPECT_EQ(choice.components, 3) << choice.reason;
  EXPECT_GT(choice.table[1].explained, 0.8);
  EXPECT_LT(choice.table[1].response_error, 0.05);
  EXPECT_GT(choice.table[1].explained_error, 0.0);
  EXPECT_LT(choice.table[1].explained_error, 0.05);
}

TEST(ChooseComponentsTest, ColumnsBesideAreKeptWithAnyNumberOfComponents) {
  const std::vector<core::Trajectory> states = Reduced(test::MakeGapPictures(20, 5));
  const auto row = [&](const ChooseComponentsOptions& options) {
    return ChooseComponents(states, options).table.at(0);
  };
  const ComponentsScore nine = row({.candidates = {9}});
  for (const ChooseComponentsOptions& same :
       {ChooseComponentsOptions{.candidates = {4}, .beside = 5},
        // A shorter block has no third component.
        ChooseComponentsOptions{
            .candidates = {4}, .beside = 3, .blocks = {{3, 5, 7, 8, 9, 10}, {4, 6}}}}) {
    const ComponentsScore score = row(same);
    EXPECT_EQ(score.components, same.candidates[0]);
    EXPECT_EQ(score.explained, nine.explained);
    EXPECT_EQ(score.inside, nine.inside);
  }
}

TEST(ChooseComponentsTest, AcceptsOneActionWithNoise) {
  // The noise does not depend on the states, and the mean predicts it well.
  core::Random random(4);
  std::vector<core::Trajectory> demonstrations(20);
  for (core::Trajectory& d : demonstrations) {
    d.states.setZero(16, 2);
    d.controls.setZero(15, 2);
    for (Eigen::Index t = 0; t < 15; ++t) {
      d.controls.row(t) << 1.0 + 0.2 * random.Normal(), 0.2 * random.Normal();
      d.states.row(t + 1) = d.states.row(t) + d.controls.row(t);
    }
  }
  const ComponentsChoice choice = ChooseComponents(demonstrations, {.candidates = {2}});
  EXPECT_LT(choice.table[0].explained, 0.2);
  EXPECT_LT(choice.table[0].action_error, 0.2);  // The noise is .08 of the squared actions.
  EXPECT_EQ(choice.components, 2) << choice.reason;
}

TEST(ChooseComponentsTest, RefusesComponentsThatDoNotExplainActions) {
  // Actions do not depend on the pictures.
  test::GapPictures pictures = test::MakeGapPictures(20, 3);
  core::Random random(4);
  for (core::Trajectory& d : pictures.truth) {
    for (double& value : d.controls.reshaped()) value = random.Normal();
  }
  const ComponentsChoice choice = ChooseComponents(Reduced(pictures), {.candidates = {3, 6}});
  EXPECT_EQ(choice.components, 0);
  EXPECT_THAT(choice.reason, HasSubstr("do not explain the actions of left-out demonstrations: at "
                                       "most 0 % of their variance"));
}

TEST(ChooseComponentsTest, RefusesNumbersThatLeaveTooFewStatesInside) {
  const ComponentsChoice choice = ChooseComponents(Reduced(test::MakeGapPictures(12, 5)),
                                                   {.candidates = {20, 24}, .least_inside = 0.9});
  EXPECT_EQ(choice.components, 0);
  EXPECT_THAT(choice.reason, HasSubstr("no number of components keeps 90 %"));
  EXPECT_THAT(choice.reason, HasSubstr("Record more demonstrations"));
}

TEST(ChooseComponentsTest, DoesNotDependOnTheOrderOfDemonstrations) {
  std::vector<core::Trajectory> demonstrations = Reduced(test::MakeGapPictures(12, 6));
  const ComponentsChoice before = ChooseComponents(demonstrations, {.candidates = {6}});
  std::swap(demonstrations[0], demonstrations[7]);
  std::swap(demonstrations[3], demonstrations[11]);
  const ComponentsChoice after = ChooseComponents(demonstrations, {.candidates = {6}});
  EXPECT_EQ(before.table[0].inside, after.table[0].inside);
  // The rounding of sums over demonstrations depends on their order.
  EXPECT_NEAR(before.table[0].explained, after.table[0].explained, 1e-12);
}

TEST(ChooseComponentsTest, RefusesBadInput) {
  std::vector<core::Trajectory> demonstrations = test::MakeGapPictures(5, 7).truth;
  const auto message = [&](const ChooseComponentsOptions& options) {
    return test::MessageOf([&] { (void)ChooseComponents(demonstrations, options); });
  };
  EXPECT_THAT(message({.candidates = {}}), HasSubstr("candidates must be positive and ascending"));
  EXPECT_THAT(message({.candidates = {0}}), HasSubstr("candidates must be positive"));
  EXPECT_THAT(message({.candidates = {3, 3}}), HasSubstr("candidates must be positive"));
  EXPECT_THAT(message({.candidates = {4}}),
              HasSubstr("the smallest candidate is 4, but there are 3 scores"));
  EXPECT_THAT(message({.folds = 1}), HasSubstr("folds must be at least 2, not 1"));
  EXPECT_THAT(message({.least_inside = 2.0}), HasSubstr("least_inside must lie in [0, 1]"));
  demonstrations[3].controls(2, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message({}), HasSubstr("demonstration 3 has a non-finite entry"));
  demonstrations[2].controls.conservativeResize(4, Eigen::NoChange);
  EXPECT_THAT(message({}), HasSubstr("demonstration 2 has"));
  for (core::Trajectory& d : demonstrations) d.controls.setZero(d.states.rows() - 1, 2);
  EXPECT_THAT(message({}), HasSubstr("all demonstrated actions are zero"));
  demonstrations.resize(3);
  EXPECT_THAT(message({}), HasSubstr("at least 4 demonstrations; there are 3"));
}

}  // namespace
}  // namespace dfr::reduction
