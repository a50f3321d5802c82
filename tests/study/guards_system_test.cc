#include <gtest/gtest.h>

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "apps/study/study.h"

namespace dfr::study {
namespace {

Study OnReach(std::vector<std::string> policies, int trials, int episodes) {
  Study study = Study::OfGuards();
  study.tasks = {"reach"};
  study.demonstrations = 20;
  study.trials = trials;
  study.episodes = episodes;
  study.seed = 3;
  study.policies = std::move(policies);
  study.controllers = {"guard"};
  return study;
}

// Policies that learn again or query the supervisor work in tasks of the gallery. Takes seconds:
// DAgger and DART learn many times.
TEST(GuardsTest, RunsPoliciesThatLearnAgain) {
  const Study study = OnReach({"ensemble", "dart", "dagger", "none"}, 1, 6);
  std::map<std::pair<std::string, std::string>, Row> rows;
  for (const Row& row : RunStudy(study)) rows[{row.policy, row.controller}] = row;
  for (const char* policy : {"ensemble", "dart", "dagger"}) {
    EXPECT_GE((rows[{policy, "baseline"}].completed), 5) << policy;
    EXPECT_GE((rows[{policy, "guard"}].completed), 5) << policy;
  }
  EXPECT_EQ((rows[{"none", "baseline"}].completed), 0);
  EXPECT_EQ((rows[{"none", "baseline"}].collided), 0);
}

// A policy that steers towards the constraints collides in every episode. A guard saves five of six
// episodes. Trials differ: in few trials the share may lie between three quarters and all.
TEST(GuardsTest, SavesEpisodesFromAnAdversary) {
  const std::vector<Row> rows = RunStudy(OnReach({"at-constraints"}, 12, 20));
  ASSERT_EQ(rows.size(), 2);
  EXPECT_EQ(rows[0].collided, 240);
  EXPECT_GE(rows[1].saved, 200);
}

}  // namespace
}  // namespace dfr::study
