#include "dfr/safety/method.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>
#include <string_view>

#include "dfr/control/guided/guided_controller.h"
#include "tests/support/message_of.h"

namespace dfr::safety {
namespace {

using testing::HasSubstr;
using Kind = Method::Kind;

constexpr std::array<std::string_view, 2> kOthers = {"oracle", "lwr"};

// Returns ParseMethod()'s error about a name.
std::string Refusal(std::string_view name) {
  return dfr::test::MessageOf<std::invalid_argument>(
      [&] { static_cast<void>(ParseMethod(name, kOthers)); });
}

// The test EveryListedNameIsValid checks Method::name.
TEST(MethodTest, NamesOfAlgorithm1AreThoseOfItsRecoveries) {
  for (const control::Recovery recovery :
       {control::Recovery::kNone, control::Recovery::kEarlyStopping, control::Recovery::kDfr}) {
    const Method method = ParseMethod(control::Name(recovery));
    EXPECT_EQ(method.kind, Kind::kSwitching);
    EXPECT_EQ(method.recovery, recovery);
    EXPECT_FALSE(method.published_dfr);
  }
  const Method fine = ParseMethod("dfr-fine");
  EXPECT_EQ(fine.kind, Kind::kSwitching);
  EXPECT_EQ(fine.recovery, control::Recovery::kDfr);
  EXPECT_TRUE(fine.published_dfr);
}

TEST(MethodTest, NamesRemovePartsOfGuidedRecovery) {
  EXPECT_EQ(ParseMethod("controller").kind, Kind::kController);
  EXPECT_EQ(ParseMethod("controller").without, "");
  for (const std::string_view part : control::GuidedPartNames()) {
    const Method method = ParseMethod("controller-without-" + std::string(part));
    EXPECT_EQ(method.kind, Kind::kController);
    EXPECT_EQ(method.without, part);
  }
  EXPECT_EQ(ParseMethod("controller-without-exit-level+online-jacobian").without,
            "exit-level+online-jacobian");
}

TEST(MethodTest, EveryListedNameIsValid) {
  const std::string names = MethodNames(kOthers);
  int count = 0;
  for (std::size_t begin = 0; begin < names.size(); ++count) {
    const std::size_t end = std::min(names.find(", ", begin), names.size());
    const std::string name = names.substr(begin, end - begin);
    EXPECT_EQ(Refusal(name), "nothing thrown");
    EXPECT_EQ(ParseMethod(name, kOthers).name, name);
    begin = end + 2;
  }
  EXPECT_EQ(ParseMethod("oracle", kOthers).kind, Kind::kOther);
  EXPECT_THROW(static_cast<void>(ParseMethod("oracle")), std::invalid_argument);
  // Three names of Algorithm 1, dfr-fine, guard, controller and two others.
  EXPECT_EQ(count, 8 + static_cast<int>(control::GuidedPartNames().size()));
}

TEST(MethodTest, AnUnknownNameIsRefusedWithTheValidOnes) {
  for (const std::string_view name : {"", "magic", "controller-lwr", "Controller", "controller ",
                                      "controller-", "controller-without", "controller-without-",
                                      "controller-without-filter+", "dfr-coarse", "baseline,dfr"}) {
    EXPECT_THAT(Refusal(name), HasSubstr("unknown method '" + std::string(name) + "'"));
    EXPECT_THAT(Refusal(name), HasSubstr("valid: " + MethodNames(kOthers)));
  }
  for (const std::string_view name :
       {"controller-without-magic", "controller-without-filter+magic"}) {
    EXPECT_THAT(Refusal(name),
                HasSubstr("no part 'magic'; it has: filter, exit-level, demonstrated"));
  }
  EXPECT_THAT(Refusal("controller-without-+filter"), HasSubstr("no part ''"));
}

}  // namespace
}  // namespace dfr::safety
