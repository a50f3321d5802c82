#include "dfr/study/controller_factory.h"

#include <gtest/gtest.h>

#include <array>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/text/suggest.h"
#include "dfr/study/policies.h"

namespace dfr::study {
namespace {

TEST(MethodTest, ProgramsRefuseMethodsThatTheyCannotMake) {
  EXPECT_EQ(ParseMethod("dart").name, "dart");
  EXPECT_EQ(ParseMethod("controller@ensemble").name, "controller@ensemble");
  for (const char* loaded : {"lwr", "controller@lwr-online", "guard@none", "true-jacobian",
                             "controller@random", "dfr@out-of-support/raw"}) {
    EXPECT_EQ(ParseMethod(loaded, kLoadedMethods).name, loaded);
  }
  for (const char* taught : {"dart", "dagger", "ensemble", "dart/raw"}) {
    EXPECT_THROW(static_cast<void>(ParseMethod(taught, kLoadedMethods)), core::UnknownName)
        << taught;
  }
  for (const char* taught : {"controller@dart", "guard@dagger", "baseline@ensemble"}) {
    EXPECT_THROW(static_cast<void>(ParseMethod(taught, kLoadedMethods)), std::invalid_argument)
        << taught;
  }
  constexpr std::array<std::string_view, 1> kRegression = {"lwr"};
  EXPECT_EQ(PoliciesFor(kRegression), (std::vector<std::string_view>{"lwr", "none"}));
  EXPECT_EQ(PoliciesFor(kOtherMethods),
            std::vector<std::string_view>(kPolicies.begin(), kPolicies.end()));
  const std::string help = MethodHelp(kRegression);
  for (const char* word : {"dart", "dagger", "ensemble", "oracles", "at-constraints"}) {
    EXPECT_EQ(help.find(word), std::string::npos) << word;
    EXPECT_NE(MethodHelp().find(word), std::string::npos) << word;
  }
}

}  // namespace
}  // namespace dfr::study
