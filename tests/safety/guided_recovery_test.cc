#include "dfr/safety/guided_recovery.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <vector>

#include "dfr/control/guided/jacobian_estimate.h"
#include "dfr/core/folds.h"
#include "dfr/kernel/whitened_support.h"
#include "tests/safety/corridor.h"

namespace dfr::safety {
namespace {

core::FeatureSelection Tip() { return {test::CorridorLayout(), "tip"}; }

// Built by hand from the parts that docs/recovery.md names.
TEST(GuidedRecoveryTest, PutsTogetherWhatTheLibrariesMake) {
  const auto demonstrations = test::CorridorDemonstrations(3, 12);
  const GuidedRecovery recovery(Tip(), demonstrations);

  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const auto& d : core::InContentOrder(demonstrations)) states.push_back(d.states);
  const auto features = core::FeatureTransform::Whitening(Tip(), states);
  std::vector<core::Matrix> points;
  points.reserve(states.size());
  for (const auto& s : states) points.push_back(features.Apply(s));
  const auto support = kernel::WhitenedSupport::Fit(points);
  const control::GuidedModel model(features, support, core::InContentOrder(demonstrations),
                                   {.slack = control::SlackFrom(kernel::HeldOutLevels(points))});

  EXPECT_EQ(recovery.features().scale(), features.scale());
  EXPECT_EQ(recovery.model().slack(), model.slack());
  EXPECT_EQ(recovery.model().largest_control(), model.largest_control());
  for (const int t : {0, 7, 20}) {
    EXPECT_EQ(recovery.model().gate_level(t), model.gate_level(t));
    for (const double x : {-0.3, 0.0, 1.1}) {
      const std::vector<double> z = {x, 0.2};
      EXPECT_EQ(recovery.support().Decision(t, z), support.Decision(t, z));
    }
  }
}

TEST(GuidedRecoveryTest, AFileKeepsAllBits) {
  const auto demonstrations = test::CorridorDemonstrations(3, 12);
  for (const bool single_precision : {false, true}) {
    kernel::WhitenedSupportOptions options;
    options.single_precision = single_precision;
    const GuidedRecovery recovery(Tip(), demonstrations, options);
    const auto path = std::filesystem::path(testing::TempDir()) /
                      (single_precision ? "recovery_float.dfr" : "recovery.dfr");
    core::ArchiveWriter writer("recovery", 1);
    recovery.Save(writer);
    writer.Save(path);
    core::ArchiveReader reader(path, "recovery", 1);
    const auto loaded = GuidedRecovery::Load(reader, Tip());
    reader.End();
    std::filesystem::remove(path);

    EXPECT_EQ(loaded->model().control_unit(), recovery.model().control_unit());
    EXPECT_EQ(loaded->model().slack(), recovery.model().slack());
    EXPECT_EQ(loaded->model().largest_control(), recovery.model().largest_control());
    control::JacobianEstimate ours(recovery.model().prior());
    control::JacobianEstimate theirs(loaded->model().prior());
    core::Random random(5);
    for (int i = 0; i < 50; ++i) {
      const int t = i % 25;
      const std::vector<double> z = {random.Normal(), random.Normal()};
      EXPECT_EQ(loaded->support().LogDecision(t, z, {}), recovery.support().LogDecision(t, z, {}));
      EXPECT_EQ(loaded->support().lipschitz_bound(t), recovery.support().lipschitz_bound(t));
      EXPECT_EQ(loaded->model().gate_level(t), recovery.model().gate_level(t));
      EXPECT_EQ(loaded->model().median_level(t), recovery.model().median_level(t));
      EXPECT_LT(recovery.model().median_level(t), recovery.model().gate_level(t));
      ours.Compute(t, z);
      theirs.Compute(t, z);
      EXPECT_EQ(ours.jacobian(), theirs.jacobian());
      EXPECT_EQ(ours.own_motion(), theirs.own_motion());
    }
  }
}

}  // namespace
}  // namespace dfr::safety
