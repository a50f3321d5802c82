#include "dfr/core/features/features.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/message_of.h"

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

TEST(FeatureSelectionTest, TakesBlocksAndRangesInTheGivenOrder) {
  const FeatureSelection selection(Layout(), "tip[0:2],object");
  EXPECT_THAT(selection.indices(), ElementsAre(5, 6, 3, 4));
  Matrix states(1, 8);
  states << 0, 1, 2, 3, 4, 5, 6, 7;
  Matrix expected(1, 4);
  expected << 5, 6, 3, 4;
  EXPECT_EQ(selection.Apply(states), expected);
}

TEST(FeatureSelectionTest, ErrorsNameTheFeatureAndTheValidOnes) {
  const auto message = [](const char* spec) -> std::string {
    return dfr::test::MessageOf<std::invalid_argument>([&] { FeatureSelection(Layout(), spec); });
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

// Fits and guard files identify entries by this text.
TEST(FeatureSelectionTest, ANameMayContainBracketsAndCommas) {
  StateLayout layout;
  layout.Add("pos [m]", 2);
  layout.Add("a", 2);
  layout.Add("a[0:1]", 1);
  layout.Add("a,b", 2);
  const auto indices = [&](const char* spec) { return FeatureSelection(layout, spec).indices(); };
  EXPECT_THAT(indices("a,pos [m]"), ElementsAre(2, 3, 0, 1));
  EXPECT_THAT(indices("pos [m][1:2],a[1:2]"), ElementsAre(1, 3));
  EXPECT_THAT(indices("a[0:1],a,b[1:2],a"), ElementsAre(4, 6, 2, 3));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>([&] { indices("pos [m][0:3]"); }),
              HasSubstr("not within pos [m][0:2]"));
}

// A specification of 23 KB that repeated an entry once allocated gigabytes of features.
TEST(FeatureSelectionTest, RepeatedEntriesAreRefused) {
  StateLayout layout;
  layout.Add("a", 3);
  for (const char* spec : {"a,a", "a[0:2],a[1:3]", "a[2:3],a"}) {
    EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>(
                    [&] { const FeatureSelection selection(layout, spec); }),
                testing::HasSubstr("repeats an entry"));
  }
  EXPECT_EQ(FeatureSelection(layout, "a[2:3],a[0:2]").indices(), (std::vector{2, 0, 1}));
  EXPECT_THROW(FeatureSelection(layout, "a[0:" + std::string(309, '9') + "]"),
               std::invalid_argument);
}

TEST(StateLayoutTest, BlocksBeyondTheLargestStateAreRefused) {
  StateLayout layout;
  layout.Add("a", StateLayout::kMaxStateDim - 1);
  layout.Add("b", 1);
  EXPECT_EQ(layout.state_dim(), StateLayout::kMaxStateDim);
  EXPECT_THROW(layout.Add("c", 1), std::invalid_argument);
  EXPECT_THROW(layout.Add("d", std::numeric_limits<int>::max()), std::invalid_argument);
}

TEST(FeaturesTest, ObservationPrefixesAreStripped) {
  EXPECT_EQ(StripObservationPrefixes("obs/object,obs/robot0_eef_pos[0:3]"),
            "object,robot0_eef_pos[0:3]");
  EXPECT_EQ(StripObservationPrefixes("observations/tip,tilt"), "tip,tilt");
  EXPECT_EQ(StripObservationPrefixes(""), "");
}

}  // namespace
}  // namespace dfr::core
