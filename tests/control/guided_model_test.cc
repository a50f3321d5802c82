#include "dfr/control/guided/guided_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/control/guided/jacobian_estimate.h"
#include "dfr/core/archive.h"
#include "dfr/core/matrix.h"
#include "tests/control/rightwards.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

TEST(GuidedModelTest, LevelsAndControlsAreThoseOfTheDemonstrations) {
  const auto demonstrations = test::Rightwards();
  const auto support = test::MovingDisk();
  const GuidedModel model(test::IdentityFeatures(), support, demonstrations);
  double squares = 0.0;
  double largest = 0.0;
  for (const auto& d : demonstrations) {
    squares += d.controls.squaredNorm();
    largest = std::max(largest, d.controls.rowwise().norm().maxCoeff());
  }
  const double unit = std::sqrt(squares / (30.0 * test::kSteps));
  EXPECT_NEAR(model.control_unit(), unit, 1e-12);
  EXPECT_NEAR(model.largest_control(), largest / unit, 1e-12);
  EXPECT_FALSE(model.own_motion()) << "the point rests without a control";
  for (const int t : {0, 7, test::kSteps}) {
    // By counting: as many of the thirty states are below a quantile as it says.
    int below_gate = 0;
    int below_median = 0;
    for (const auto& d : demonstrations) {
      const double l = support.LogDecision(t, core::Row(d.states, t), {});
      below_gate += l < model.gate_level(t) ? 1 : 0;
      below_median += l < model.median_level(t) ? 1 : 0;
    }
    EXPECT_NEAR(below_gate, 0.75 * 30, 1.0) << t;
    EXPECT_NEAR(below_median, 0.5 * 30, 1.0) << t;
  }
  EXPECT_EQ(model.gate_level(-3), model.gate_level(0));
  EXPECT_EQ(model.gate_level(99), model.gate_level(test::kSteps));
}

// Thirty points that are thrown: each goes on at its speed, which a force changes.
TEST(GuidedModelTest, OwnMotionIsFoundWhereItExplainsUnseenDemonstrations) {
  core::Random random(2);
  std::vector<core::Trajectory> thrown(30);
  for (core::Trajectory& d : thrown) {
    d.states.resize(test::kSteps + 1, 2);
    d.controls.resize(test::kSteps, 1);
    d.states.row(0) << random.Normal(), random.Normal();
    for (Eigen::Index t = 0; t < test::kSteps; ++t) {
      d.controls(t, 0) = 0.3 * random.Normal();
      d.states(t + 1, 0) = d.states(t, 0) + 0.5 * d.states(t, 1);
      d.states(t + 1, 1) = d.states(t, 1) + 0.5 * d.controls(t, 0);
    }
  }
  const test::GaussianSupport support({{0.0, 0.0}}, 0.1, 0.1, {}, test::kSteps + 1);
  EXPECT_TRUE(GuidedModel(test::IdentityFeatures(), support, thrown).own_motion());
  EXPECT_FALSE(GuidedModel(test::IdentityFeatures(), support, {thrown.data(), 1}).own_motion())
      << "there is none that it has not seen";
}

TEST(GuidedModelTest, AFileKeepsAllThatItKnows) {
  const auto path = std::filesystem::path(testing::TempDir()) / "guided_model_kept.dfr";
  const auto support = test::MovingDisk();
  const GuidedModel model(test::IdentityFeatures(), support, test::Rightwards(), {.slack = 0.3});
  core::ArchiveWriter archive("guided", 1);
  model.Save(archive);
  archive.Save(path);
  core::ArchiveReader reader(path, "guided", 1);
  const GuidedModel loaded = GuidedModel::Load(reader, test::IdentityFeatures(), support);
  reader.End();
  std::filesystem::remove(path);
  EXPECT_EQ(loaded.control_unit(), model.control_unit());
  EXPECT_EQ(loaded.largest_control(), model.largest_control());
  EXPECT_EQ(loaded.slack(), 0.3);
  EXPECT_EQ(loaded.own_motion(), model.own_motion());
  JacobianEstimate kept(loaded.prior());
  JacobianEstimate made(model.prior());
  for (int t = 0; t < test::kSteps; ++t) {
    EXPECT_EQ(loaded.gate_level(t), model.gate_level(t));
    EXPECT_EQ(loaded.median_level(t), model.median_level(t));
    const std::vector<double> z = {t * test::kSpeed, 0.1};
    kept.Compute(t, z);
    made.Compute(t, z);
    EXPECT_EQ(kept.jacobian(), made.jacobian());
    EXPECT_EQ(kept.own_motion(), made.own_motion());
  }
}

TEST(GuidedModelTest, AFileWithALevelThatCannotBeIsRefused) {
  const auto path = std::filesystem::path(testing::TempDir()) / "guided_model.dfr";
  const auto support = test::MovingDisk();
  const auto message = [&](const std::vector<double>& gate, const std::vector<double>& edge,
                           const std::vector<double>& median, double largest, double slack,
                           double unit) -> std::string {
    core::ArchiveWriter archive("guided", 1);
    archive.Numbers(gate);
    archive.Numbers(gate);  // where the learned control may pass
    archive.Numbers(edge);
    archive.Numbers(median);
    archive.Number(largest);
    archive.Number(slack);
    archive.Number(unit);
    archive.Integer(0);
    archive.Save(path);  // without the prior, which is read last
    core::ArchiveReader reader(path, "guided", 1);
    try {
      static_cast<void>(GuidedModel::Load(reader, test::IdentityFeatures(), support));
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const std::vector<double> good = {0.5, 0.0};
  for (const double bad : {-0.1, kInfinity, -kInfinity, std::nan("")}) {
    SCOPED_TRACE(bad);
    EXPECT_THAT(message({0.5, bad}, good, good, 1.0, 0.2, 1.0), HasSubstr("gate levels"));
    EXPECT_THAT(message(good, {0.5, bad}, good, 1.0, 0.2, 1.0), HasSubstr("edge levels"));
    EXPECT_THAT(message(good, good, {bad, 0.5}, 1.0, 0.2, 1.0), HasSubstr("median levels"));
    EXPECT_THAT(message(good, good, good, bad, 0.2, 1.0), HasSubstr("the largest control"));
    EXPECT_THAT(message(good, good, good, 1.0, bad, 1.0), HasSubstr("slack and the unit"));
    EXPECT_THAT(message(good, good, good, 1.0, 0.2, bad), HasSubstr("slack and the unit"));
  }
  EXPECT_THAT(message({}, good, good, 1.0, 0.2, 1.0), HasSubstr("gate levels"));
  EXPECT_THAT(message(good, good, good, 1.0, 0.2, 0.0), HasSubstr("slack and the unit"));
  EXPECT_THAT(message(good, good, good, 1.0, 0.0, 1.0),
              testing::Not(HasSubstr("slack and the unit")));
  std::filesystem::remove(path);
}

TEST(GuidedModelTest, ErrorsNameTheCulprit) {
  const auto support = test::MovingDisk();
  const auto message = [&](const std::function<void(std::vector<core::Trajectory>&)>& change,
                           const GuidedModelOptions& options) -> std::string {
    auto demonstrations = test::Rightwards();
    change(demonstrations);
    try {
      const GuidedModel model(test::IdentityFeatures(), support, demonstrations, options);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  const auto nothing = [](std::vector<core::Trajectory>&) {};
  EXPECT_THAT(message(nothing, {.gate_quantile = 1.1}), HasSubstr("gate_quantile"));
  EXPECT_THAT(message(nothing, {.gate_quantile = -0.1}), HasSubstr("gate_quantile"));
  EXPECT_THAT(message(nothing, {.slack = -0.1}), HasSubstr("slack"));
  EXPECT_THAT(message([](auto& d) { d.clear(); }, {}), HasSubstr("no demonstrations"));
  EXPECT_THAT(message([](auto& d) { d[2].states(3, 0) = std::nan(""); }, {}),
              HasSubstr("demonstration 2 has a non-finite entry"));
  EXPECT_THAT(message([](auto& d) { d[4].controls.conservativeResize(3, 2); }, {}),
              HasSubstr("demonstration 4"));
  EXPECT_THAT(message(
                  [](auto& demonstrations) {
                    for (auto& d : demonstrations) d.controls.setZero();
                  },
                  {}),
              HasSubstr("no demonstrated control differs from zero"));
}

TEST(GuidedModelTest, SlackIsWhatUnseenDemonstrationsNeedAndNoLessThanTheDefault) {
  EXPECT_EQ(SlackFrom({0.3, 0.2, 0.1}), GuidedModelOptions().slack);
  // The 0.2-quantile of -1, -0.9, ..., 0 is the third of eleven.
  std::vector<double> levels;
  for (int i = 0; i <= 10; ++i) levels.push_back(-1.0 + 0.1 * i);
  EXPECT_NEAR(SlackFrom(levels), 0.8, 1e-12);
  EXPECT_NEAR(SlackFrom({0.0, -2.0}), 1.6, 1e-12) << "between the two";
  EXPECT_THROW((void)SlackFrom({}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::control
