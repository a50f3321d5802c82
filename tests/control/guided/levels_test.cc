#include "dfr/control/guided/levels.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "tests/control/rightwards.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

std::vector<core::Matrix> Points() {
  std::vector<core::Matrix> points;
  for (const core::Trajectory& d : test::Rightwards()) points.push_back(d.states);
  return points;
}

TEST(LevelsTest, AreQuantilesOfTheDemonstrations) {
  const auto points = Points();
  const auto support = test::MovingDisk();
  const Levels levels(support, points);
  for (const int t : {0, 7, test::kSteps}) {
    // Counts the states of the thirty demonstrations below each quantile.
    int below_gate = 0;
    int below_edge = 0;
    int below_median = 0;
    for (const core::Matrix& z : points) {
      const double l = support.LogDecision(t, core::Row(z, t), {});
      below_gate += l < levels.gate(t) ? 1 : 0;
      below_edge += l < levels.edge(t) ? 1 : 0;
      below_median += l < levels.median(t) ? 1 : 0;
    }
    EXPECT_NEAR(below_gate, 0.75 * 30, 1.0) << t;
    EXPECT_NEAR(below_edge, 0.25 * 30, 1.0) << t;
    EXPECT_NEAR(below_median, 0.5 * 30, 1.0) << t;
    EXPECT_LE(levels.pass(t), levels.gate(t));
  }
  EXPECT_EQ(levels.gate(-3), levels.gate(0));
  EXPECT_EQ(levels.gate(99), levels.gate(test::kSteps));
}

TEST(LevelsTest, AFileKeepsAllLevels) {
  const auto path = dfr::test::ProcessFolder() / "levels_kept.dfr";
  Levels levels(test::MovingDisk(), Points(), {.slack = 0.3});
  // All states are at the edge.
  levels.SetHeldOut(
      std::vector{HeldOutLevels{.levels = std::vector(20, -1.0), .phases = std::vector(20, 0)}});
  core::ArchiveWriter archive("levels", 1);
  levels.Save(archive);
  archive.Save(path);
  core::ArchiveReader reader(path, "levels", 1);
  const Levels loaded = Levels::Load(reader);
  reader.End();
  std::filesystem::remove(path);
  EXPECT_EQ(loaded.slack(), 0.3);
  EXPECT_EQ(loaded.edge_stay(), levels.edge_stay());
  EXPECT_GT(loaded.edge_stay(), 10.0);
  EXPECT_EQ(loaded.pass_depth(), 1.0);
  for (int t = 0; t < test::kSteps; ++t) {
    EXPECT_EQ(loaded.gate(t), levels.gate(t));
    EXPECT_EQ(loaded.pass(t), levels.pass(t));
    EXPECT_EQ(loaded.edge(t), levels.edge(t));
    EXPECT_EQ(loaded.median(t), levels.median(t));
  }
}

TEST(LevelsTest, AFileWithAnInvalidLevelIsRefused) {
  const auto path = dfr::test::ProcessFolder() / "levels.dfr";
  const auto message = [&](const std::vector<double>& gate, const std::vector<double>& pass,
                           const std::vector<double>& edge, const std::vector<double>& median,
                           double slack, double edge_stay = 10.0, double pass_depth = 0.0) {
    core::ArchiveWriter archive("levels", 1);
    archive.Numbers(gate);
    archive.Numbers(pass);
    archive.Numbers(edge);
    archive.Numbers(median);
    archive.Number(slack);
    archive.Number(edge_stay);
    archive.Number(pass_depth);
    archive.Save(path);
    core::ArchiveReader reader(path, "levels", 1);
    return test::MessageOf<std::runtime_error>([&] { static_cast<void>(Levels::Load(reader)); });
  };
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const std::vector<double> good = {0.5, 0.0};
  for (const double bad : {-0.1, kInfinity, -kInfinity, std::nan("")}) {
    SCOPED_TRACE(bad);
    EXPECT_THAT(message({0.5, bad}, good, good, good, 0.2), HasSubstr("gate levels"));
    EXPECT_THAT(message(good, {bad}, good, good, 0.2), HasSubstr("pass levels"));
    EXPECT_THAT(message(good, good, {0.5, bad}, good, 0.2), HasSubstr("edge levels"));
    EXPECT_THAT(message(good, good, good, {bad, 0.5}, 0.2), HasSubstr("median levels"));
    EXPECT_THAT(message(good, good, good, good, bad), HasSubstr("slack"));
    EXPECT_THAT(message(good, good, good, good, 0.2, bad), HasSubstr("stay at the edge"));
    EXPECT_THAT(message(good, good, good, good, 0.2, 10.0, bad), HasSubstr("pass depth"));
  }
  EXPECT_THAT(message({}, good, good, good, 0.2), HasSubstr("gate levels"));
  const std::vector<double> more = {0.5, 0.0, 0.0};
  for (int longer = 0; longer < 4; ++longer) {
    EXPECT_THAT(message(longer == 0 ? more : good, longer == 1 ? more : good,
                        longer == 2 ? more : good, longer == 3 ? more : good, 0.2),
                HasSubstr("the same number of time steps"));
  }
  EXPECT_THAT(message(good, {0.5, 0.1}, good, good, 0.2),
              HasSubstr("a pass level must not exceed the gate level"));
  EXPECT_THAT(message(good, good, good, good, 0.0), testing::Not(HasSubstr("slack")));
  std::filesystem::remove(path);
}

TEST(LevelsTest, ErrorsNameTheCulprit) {
  const auto message = [](const std::vector<core::Matrix>& points, const LevelOptions& options) {
    return test::MessageOf<std::invalid_argument>(
        [&] { const Levels levels(test::MovingDisk(), points, options); });
  };
  EXPECT_THAT(message(Points(), {.gate_quantile = 1.1}), HasSubstr("gate_quantile"));
  EXPECT_THAT(message(Points(), {.gate_quantile = -0.1}), HasSubstr("gate_quantile"));
  EXPECT_THAT(message(Points(), {.pass_quantile = 0.9}), HasSubstr("pass_quantile"));
  EXPECT_EQ(message(Points(), {.gate_quantile = 0.5, .pass_quantile = 0.5}), "nothing thrown");
  EXPECT_THAT(message(Points(), {.edge_quantile = 1.5}), HasSubstr("edge_quantile"));
  for (const double bad : {-0.1, std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(message(Points(), {.slack = bad}), HasSubstr("slack"));
  }
  EXPECT_THAT(message({}, {}), HasSubstr("no demonstrations"));
  EXPECT_THAT(message({core::Matrix::Zero(4, 3)}, {}),
              HasSubstr("there are 3 features, but the support takes 2"));
}

// Demonstration k = 10, ..., 20 is at the edge in k consecutive steps and in no other step.
TEST(LevelsTest, EdgeStayIsAQuantileOfHeldOutStays) {
  Levels levels(test::MovingDisk(), Points());
  EXPECT_EQ(levels.edge_stay(), 10.0);
  std::vector<HeldOutLevels> held_out;
  for (int k = 10; k <= 20; ++k) {
    HeldOutLevels& one = held_out.emplace_back();
    for (int t = 0; t < 30; ++t) {
      const bool at_edge = t >= 3 && t < 3 + k;
      one.levels.push_back(levels.edge(t) + (at_edge ? -1e-9 : 0.0));
      one.phases.push_back(t);
    }
  }
  levels.SetHeldOut(held_out);
  EXPECT_NEAR(levels.edge_stay(), (1.0 - std::pow(0.98, 19)) / 0.02, 1e-12);
  levels.SetHeldOut(std::vector{HeldOutLevels{.levels = {-1.0, -1.0}, .phases = {0, 1}}});
  EXPECT_EQ(levels.edge_stay(), 10.0) << "two steps show too little";
  // One demonstration is always inside, and one is at the edge for 20 steps.
  held_out = {{.levels = std::vector(20, 9.0), .phases = std::vector(20, 0)},
              {.levels = std::vector(20, -1.0), .phases = std::vector(20, 0)}};
  levels.SetHeldOut(held_out);
  EXPECT_NEAR(levels.edge_stay(), 0.9 * (1.0 - std::pow(0.98, 20)) / 0.02, 1e-12);
  EXPECT_THROW(levels.SetHeldOut({}), std::invalid_argument);
}

// Two demonstrations have the 101 levels 0, -.01, ..., -1: 5 % are below -.95.
TEST(LevelsTest, PassDepthIsALowQuantileOfAllHeldOutLevels) {
  Levels levels(test::MovingDisk(), Points());
  EXPECT_EQ(levels.pass_depth(), 0.0);
  std::vector<HeldOutLevels> held_out(2);
  for (int k = 0; k <= 100; ++k) {
    HeldOutLevels& one = held_out[k < 30 ? 0 : 1];
    one.levels.push_back(-0.01 * k);
    one.phases.push_back(0);
  }
  levels.SetHeldOut(held_out);
  EXPECT_NEAR(levels.pass_depth(), 0.95, 1e-12);
  for (HeldOutLevels& one : held_out) {
    for (double& l : one.levels) l += 2.0;
  }
  levels.SetHeldOut(held_out);
  EXPECT_EQ(levels.pass_depth(), 0.0) << "states inside give no depth";
}

// 5 % of the errors 0, .01, ..., 1 exceed .95.
TEST(LevelsTest, PredictionErrorIsAHighQuantileOfTheErrors) {
  Levels levels(test::MovingDisk(), Points());
  EXPECT_EQ(levels.prediction_error(), 0.0);
  std::vector<double> errors;
  for (int k = 100; k >= 0; --k) errors.push_back(0.01 * k);
  levels.SetPredictionErrors(errors);
  EXPECT_NEAR(levels.prediction_error(), 0.95, 1e-12);
  levels.SetPredictionErrors({});
  EXPECT_EQ(levels.prediction_error(), 0.0);
  for (const double bad : {-1e-9, std::nan("")}) {
    EXPECT_THROW(levels.SetPredictionErrors(std::vector{bad}), std::invalid_argument) << bad;
  }
}

TEST(LevelsTest, SlackIsAQuantileOfHeldOutLevelsAndAtLeastTheDefault) {
  EXPECT_EQ(EstimateSlack({0.3, 0.2, 0.1}), LevelOptions().slack);
  // The 0.2-quantile of -1, -0.9, ..., 0 is the third of eleven.
  std::vector<double> levels;
  for (int i = 0; i <= 10; ++i) levels.push_back(-1.0 + 0.1 * i);
  EXPECT_NEAR(EstimateSlack(levels), 0.8, 1e-12);
  EXPECT_NEAR(EstimateSlack({0.0, -2.0}), 1.6, 1e-12) << "a level between the two";
  EXPECT_THROW((void)EstimateSlack({}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::control
