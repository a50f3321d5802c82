#include "dfr/core/features.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/no_alloc.h"

namespace dfr::core {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

StateLayout Layout() {
  StateLayout layout;
  layout.Add("arm", 3);
  layout.Add("object", 2);
  layout.Add("tip", 3);
  return layout;
}

// g(t, x) = t + x_0 + 10 x_1, to see which entries arrive where.
class Linear final : public DecisionFunction {
 public:
  int state_dim() const noexcept override { return 2; }
  int num_steps() const noexcept override { return 5; }
  double Decision(int t, std::span<const double> x) const noexcept override {
    return t + x[0] + 10.0 * x[1];
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    g[0] = 1.0;
    g[1] = 10.0;
    return Decision(t, x);
  }
  double lipschitz_bound(int) const noexcept override { return std::sqrt(101.0); }
};

TEST(StateLayoutTest, BlocksFollowEachOther) {
  const StateLayout layout = Layout();
  EXPECT_EQ(layout.state_dim(), 8);
  EXPECT_EQ(layout.blocks[2].offset, 5);
}

TEST(FeatureSelectionTest, TakesBlocksAndRangesInTheGivenOrder) {
  const FeatureSelection selection(Layout(), "tip[0:2],object");
  EXPECT_THAT(selection.indices(), ElementsAre(5, 6, 3, 4));
  Matrix states(1, 8);
  states << 0, 1, 2, 3, 4, 5, 6, 7;
  Matrix expected(1, 4);
  expected << 5, 6, 3, 4;
  EXPECT_EQ(selection.Apply(states), expected);
}

TEST(FeatureSelectionTest, ErrorsNameTheFeatureAndWhatThereIs) {
  const auto message = [](const char* spec) -> std::string {
    try {
      FeatureSelection(Layout(), spec);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  EXPECT_THAT(message("gripper"), HasSubstr("'gripper' is not part of the state"));
  EXPECT_THAT(message("gripper"), HasSubstr("object[0:2]"));
  EXPECT_THAT(message("tip[2:4]"), HasSubstr("not within tip[0:3]"));
  EXPECT_THAT(message("tip[2:2]"), HasSubstr("empty"));
  EXPECT_THAT(message("tip[1]"), HasSubstr("name[first:last]"));
  EXPECT_THAT(message("tip[a:2]"), HasSubstr("name[first:last]"));
  EXPECT_THAT(message("tip,,object"), HasSubstr("''"));
  EXPECT_THAT(message(""), HasSubstr("no feature"));
}

TEST(FeatureDecisionTest, ValueAndGradientAreThoseOfTheInnerFunction) {
  const Linear inner;
  const FeatureDecision decision(FeatureSelection(Layout(), "object"), inner);
  const std::vector<double> x = {9, 9, 9, 1, 2, 9, 9, 9};
  std::vector<double> gradient(8, -1.0);
  const test::NoAlloc guard;
  EXPECT_EQ(decision.Decision(3, x), 3 + 1 + 20);
  EXPECT_EQ(decision.Gradient(3, x, gradient), 24);
  EXPECT_EQ(gradient[3], 1.0);
  EXPECT_EQ(gradient[4], 10.0);
  EXPECT_EQ(gradient[0], 0.0);
  EXPECT_EQ(gradient[7], 0.0);
}

TEST(FeatureDecisionTest, AStateOfTheWrongSizeIsOutside) {
  const Linear inner;
  const FeatureDecision decision(FeatureSelection(Layout(), "object"), inner);
  const std::vector<double> x(7, 0.0);
  EXPECT_EQ(decision.Decision(0, x), -std::numeric_limits<double>::infinity());
}

TEST(FeatureDecisionTest, RefusesASelectionOfAnotherSize) {
  const Linear inner;
  EXPECT_THROW(FeatureDecision(FeatureSelection(Layout(), "tip"), inner), std::invalid_argument);
}

// A specification of 23 KB that names an entry again and again asked for gigabytes of features.
TEST(FeatureSelectionTest, NoEntryIsNamedTwice) {
  StateLayout layout;
  layout.Add("a", 3);
  for (const char* spec : {"a,a", "a[0:2],a[1:3]", "a[2:3],a"}) {
    try {
      const FeatureSelection selection(layout, spec);
      ADD_FAILURE() << spec;
    } catch (const std::invalid_argument& e) {
      EXPECT_NE(std::string(e.what()).find("repeats an entry"), std::string::npos) << e.what();
    }
  }
  EXPECT_EQ(FeatureSelection(layout, "a[2:3],a[0:2]").indices(), (std::vector{2, 0, 1}));
  EXPECT_THROW(FeatureSelection(layout, "a[0:" + std::string(309, '9') + "]"),
               std::invalid_argument);
}

TEST(StateLayoutTest, HasABoundThatSumsDoNotPass) {
  StateLayout layout;
  layout.Add("a", StateLayout::kMaxStateDim - 1);
  layout.Add("b", 1);
  EXPECT_EQ(layout.state_dim(), StateLayout::kMaxStateDim);
  EXPECT_THROW(layout.Add("c", 1), std::invalid_argument);
  EXPECT_THROW(layout.Add("d", std::numeric_limits<int>::max()), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::core
