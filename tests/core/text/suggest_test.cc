#include "dfr/core/text/suggest.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace dfr::core {
namespace {

const std::vector<std::string> kCommands = {"check", "fit", "evaluate", "report", "show"};

TEST(ClosestTest, CountsChangedMissingAddedAndSwappedCharacters) {
  EXPECT_EQ(Closest("chack", kCommands), "check");
  EXPECT_EQ(Closest("ceck", kCommands), "check");
  EXPECT_EQ(Closest("fitt", kCommands), "fit");
  EXPECT_EQ(Closest("fti", kCommands), "fit");
  EXPECT_EQ(Closest("evalaute", kCommands), "evaluate");
  EXPECT_EQ(Closest("report", kCommands), "report");
}

TEST(ClosestTest, SuggestsNothingThatDiffersByMoreThanAThird) {
  EXPECT_EQ(Closest("frobnicate", kCommands), "");
  EXPECT_EQ(Closest("shake", kCommands), "");  // three changes from "show"
  EXPECT_EQ(Closest("", kCommands), "");
  EXPECT_EQ(Closest("fit", {}), "");
  EXPECT_EQ(Closest(std::string(1 << 20, 'a'), kCommands), "");
}

TEST(ClosestTest, TheFirstOfEquallyCloseNamesWins) {
  const std::vector<std::string> known = {"cat", "car"};
  EXPECT_EQ(Closest("cap", known), "cat");
}

}  // namespace
}  // namespace dfr::core
