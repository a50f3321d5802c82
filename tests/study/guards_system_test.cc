#include <gtest/gtest.h>

#include <map>
#include <string>
#include <utility>

#include "apps/study/study.h"

namespace dfr::study {
namespace {

// Policies that learn again or query the supervisor work in tasks of the gallery, and the adversary
// uses the controlled plant. Takes seconds: DAgger and DART learn many times over.
TEST(GuardsTest, RunsBaselinesAndAdversaries) {
  Study study = Study::OfGuards();
  study.tasks = {"reach"};
  study.demonstrations = 20;
  study.episodes = 6;
  study.trials = 1;
  study.seed = 3;
  study.policies = {"ensemble", "dart", "dagger", "none"};
  study.controllers = {"guard"};
  std::map<std::pair<std::string, std::string>, Row> rows;
  for (const Row& row : RunStudy(study)) rows[{row.policy, row.controller}] = row;
  for (const char* policy : {"ensemble", "dart", "dagger"}) {
    EXPECT_GE((rows[{policy, "baseline"}].completed), 5) << policy;
    EXPECT_GE((rows[{policy, "guard"}].completed), 5) << policy;
  }
  EXPECT_EQ((rows[{"none", "baseline"}].completed), 0);
  EXPECT_EQ((rows[{"none", "baseline"}].collided), 0);
}

// A policy that heads for the constraints collides in every episode; a guard saves five of six.
TEST(GuardsTest, SavesEpisodesFromAnAdversary) {
  Study study = Study::OfGuards();
  study.tasks = {"reach"};
  study.demonstrations = 20;
  study.episodes = 12;
  study.trials = 4;
  study.seed = 3;
  study.policies = {"at-constraints"};
  study.controllers = {"guard"};
  const std::vector<Row> rows = RunStudy(study);
  ASSERT_EQ(rows.size(), 2);
  EXPECT_EQ(rows[0].collided, 48);
  EXPECT_GE(rows[1].saved, 40);
}

}  // namespace
}  // namespace dfr::study
