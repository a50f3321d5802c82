// The claims of the planar studies and of the stress test of the proof.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "apps/study/planar/coverage.h"
#include "apps/study/planar/proof.h"
#include "apps/study/planar/task.h"
#include "apps/study/study.h"

namespace dfr::study::planar {
namespace {

// Returns one row per method, "baseline" first.
std::vector<Row> RunPlane(const std::string& task, std::vector<std::string> methods) {
  Study study = Study::OfPlane();
  study.tasks = {"planar-" + task};
  study.controllers = std::move(methods);
  study.demonstrations = 60;
  study.trials = 2;
  study.episodes = 20;
  study.seed = 11;
  return RunStudy(study);
}

TEST(PlanarTest, GuidedRecoveryCompletesTheCorridorWithoutCollisions) {
  const auto rows = RunPlane("corridor", {"controller", "certified-direction"});
  EXPECT_GE(rows[1].completed, 38);
  EXPECT_EQ(rows[1].collided, 0);
  EXPECT_GE(rows[2].completed, 36);
  EXPECT_EQ(rows[2].collided, 0);
}

// In contact the Jacobian is wrong, and a certificate must include the error.
TEST(PlanarTest, TheDirectionCertificateCompletesPushingWithoutAViolation) {
  for (const char* task : {"push", "push-weak"}) {
    SCOPED_TRACE(task);
    const Row row = RunPlane(task, {"certified-direction"})[1];
    EXPECT_GE(row.completed, 28);
    EXPECT_EQ(row.collided, 0);
    EXPECT_EQ(
        row.causes.count(std::string("halted: ") + control::Name(control::HaltCause::kViolated)),
        0u);
  }
}

TEST(PlanarTest, GuidedRecoveryBeatsAWeakPolicyAtPushing) {
  const auto rows = RunPlane("push-weak", {"controller"});
  EXPECT_GT(rows[1].completed, rows[0].completed);
  EXPECT_LT(rows[1].collided, rows[0].collided);
}

// Tests the corrected Prop. IV.3 over 150 000 controls. `study prove --steps 10000000` is the long
// version. A wrong certificate fails once in thousands of controls.
TEST(ProofTest, NeverLeavesTheUnionOfSupports) {
  const ProofResult result = Prove({.steps = 150'000});
  EXPECT_EQ(result.controls, 150'000);
  EXPECT_EQ(result.left, 0);
  EXPECT_EQ(result.violations, 0);
  EXPECT_GT(result.probes, 500);
  EXPECT_GT(result.recoveries, 500);
  EXPECT_GT(result.phases, 300);
}

// The stress test finds each deliberate mistake of a controller. Some take tens of thousands of
// controls.
TEST(ProofTest, EveryMutationIsFound) {
  for (const Mutation mutation : kMutations) {
    if (mutation == Mutation::kNone) continue;
    SCOPED_TRACE(Name(mutation));
    const ProofResult result = Prove({.steps = 60'000, .mutation = mutation});
    EXPECT_GT(result.left, 0);
  }
}

// States are observed with an error that the certificate includes: no violation occurs.
TEST(ProofTest, NoisyStatesStayInsideToo) {
  const ProofResult result = Prove({.steps = 30'000, .state_error = 0.05});
  EXPECT_EQ(result.left, 0);
  EXPECT_EQ(result.violations, 0);
}

// With half of the true eps, states leave the supports. The controller detects each exit at the
// control that causes it. A hundred exits need hundreds of worlds.
TEST(ProofTest, AWrongConstantEndsInAViolation) {
  const ProofResult result = Prove({.steps = 30'000, .assumed = 0.5});
  EXPECT_GT(result.violations, 100);
  EXPECT_LE(result.left, result.violations + 1) << "the last control is not checked";
}

// With held-out demonstrations, the counts agree with the law of order statistics.
TEST(CoverageTest, HeldOutDemonstrationsKeepThePromises) {
  constexpr int kFits = 80;
  for (const std::string world : {"reach", "heavy-tails"}) {
    SCOPED_TRACE(world);
    const CoverageResult result = MeasureCoverage({.world = world,
                                                   .demonstrations = 20,
                                                   .hold_out = 0.5,
                                                   .confidence = 0.8,
                                                   .fits = kFits,
                                                   .further = 60});
    EXPECT_EQ(result.promised, 0.2);
    EXPECT_EQ(result.confidence, 0.8);
    EXPECT_GT(result.kept_chance, 0.8);
    // The tolerance is three and a half standard deviations.
    const auto near = [&](int count, double chance) {
      EXPECT_NEAR(count, kFits * chance, 3.5 * std::sqrt(kFits * chance * (1.0 - chance)));
    };
    near(result.kept, result.kept_chance);
    near(result.error_short, result.short_chance);
    near(result.gain_short, result.short_chance);
    // On average, an eleventh of further demonstrations exceed the worst of ten.
    EXPECT_NEAR(result.mean, 1.0 / 11.0, 3.5 * result.mean_error);
  }
}

}  // namespace
}  // namespace dfr::study::planar
