#include "dfr/control/response/transition_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "tests/support/message_of.h"
#include "tests/support/random_matrix.h"
#include "tests/support/temp_folder.h"

namespace dfr::control {
namespace {

TEST(TransitionStoreTest, ErrorsNameTheCulprit) {
  const std::vector<core::Matrix> features(3, core::Matrix::Ones(6, 3));
  std::vector<core::Matrix> controls(3, core::Matrix::Ones(5, 2));
  const auto message = [&](const ResponseOptions& options) {
    return test::MessageOf<std::invalid_argument>(
        [&] { const TransitionStore prior(features, controls, options); });
  };
  EXPECT_EQ(message({}), "nothing thrown");
  EXPECT_THAT(message({.ridge = 0.0}), testing::HasSubstr("ridge"));
  EXPECT_THAT(message({.drift_ridge = 0.0}), testing::HasSubstr("drift_ridge"));
  EXPECT_THAT(message({.slope_ridge = 0.0}), testing::HasSubstr("slope_ridge"));
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  EXPECT_THAT(message({.ridge = kInfinity}), testing::HasSubstr("ridge"));
  EXPECT_THAT(message({.drift_ridge = kInfinity}), testing::HasSubstr("drift_ridge"));
  EXPECT_THAT(message({.slope_ridge = kInfinity}), testing::HasSubstr("slope_ridge"));
  EXPECT_THAT(message({.prior_weight = kInfinity}), testing::HasSubstr("prior_weight"));
  EXPECT_THAT(message({.prior_weight = -1.0}), testing::HasSubstr("prior_weight"));
  EXPECT_THAT(message({.forgetting = 1.0}), testing::HasSubstr("forgetting"));
  EXPECT_THAT(message({.max_per_step = 0}), testing::HasSubstr("max_per_step"));
  EXPECT_EQ(message({.window = 5, .max_per_step = 93}), "nothing thrown") << "1023 transitions";
  EXPECT_THAT(message({.window = 5, .max_per_step = 94}), testing::HasSubstr("at most 1024"));
  for (const auto& [n, m] : {std::pair(0, 2), std::pair(257, 2), std::pair(3, 0)}) {
    const std::vector<core::Matrix> states(1, core::Matrix::Ones(6, n));
    const std::vector<core::Matrix> actions(1, core::Matrix::Ones(5, m));
    EXPECT_THAT(test::MessageOf<std::invalid_argument>(
                    [&] { const TransitionStore prior(states, actions, {}); }),
                testing::HasSubstr("1 to 256 are supported"));
  }
  controls[1] = core::Matrix::Ones(4, 2);
  EXPECT_THAT(message({}), testing::HasSubstr("demonstration 1"));
}

// With a narrow window, the transitions of all time steps are measured in several blocks.
TEST(TransitionStoreTest, TheNearestStateMayBelongToAnyTimeStep) {
  core::Random random(5);
  const core::Matrix states = test::RandomMatrix(random, 60, 3);
  const TransitionStore prior({{states}}, {{core::Matrix::Ones(59, 1)}}, {.window = 1});
  TransitionStore::Workspace workspace = prior.MakeWorkspace();
  for (const int t : {0, 7, 58}) {
    const Eigen::Vector3d z = states.row(t).transpose() + Eigen::Vector3d(0.3, -0.2, 0.1);
    const double least = (states.topRows(59).rowwise() - z.transpose()).rowwise().norm().minCoeff();
    EXPECT_NEAR(prior.Distance(core::AsSpan(z), workspace), least, 1e-6);
  }
  EXPECT_TRUE(std::isnan(prior.Distance(std::vector{0.0, std::nan(""), 0.0}, workspace)));
}

TEST(TransitionStoreTest, SurroundingsAreTheBoxOfAllStatesEnlargedByItsDiagonal) {
  core::Matrix states(3, 2);
  states << 1, 10, 4, 10, 2, 14;  // a box of 3 x 4 with its corners at (1, 10) and (4, 14)
  core::Matrix controls = core::Matrix::Ones(2, 1);
  const TransitionStore prior({{states}}, {{controls}}, {});
  const auto surrounds = [&](double x, double y) {
    return prior.Surrounds(std::vector<double>{x, y});
  };
  EXPECT_TRUE(surrounds(2.5, 12.0));
  EXPECT_TRUE(surrounds(-3.99, 12.0));
  EXPECT_FALSE(surrounds(-4.01, 12.0));
  EXPECT_TRUE(surrounds(2.5, 18.99));
  EXPECT_FALSE(surrounds(2.5, 19.01));
  EXPECT_FALSE(surrounds(std::nan(""), 12.0));
  EXPECT_TRUE(prior.Reaches(std::vector<double>{1e17, 1e17}));
  EXPECT_FALSE(prior.Reaches(std::vector<double>{0.0, 3.4e38}));
  EXPECT_FALSE(prior.Reaches(std::vector<double>{1e300, 0.0}));
}

// All transitions begin at z = 0 with v = (2, 0) and dz = 3: both have the same weight.
TEST(TransitionStoreTest, AShareComparesWhatAnEntryExplainsWithTheRest) {
  core::Matrix states(2, 1);
  states << 0, 3;
  core::Matrix controls(1, 2);
  controls << 2, 0;
  const TransitionStore prior(std::vector(2, states), std::vector(2, controls), {});
  TransitionStore::Workspace workspace = prior.MakeWorkspace();
  ASSERT_TRUE(prior.SumControls(0, std::vector{0.0}, workspace));
  EXPECT_EQ(prior.Share(1, 1.5, workspace), 1.0) << "the entry is unused, and nothing is left";
  // The residual is 3 dz = 9, and entry 0 explains 1.5 * 2 = 3.
  workspace.residual[4] = 3.0F;
  EXPECT_NEAR(prior.Share(0, 1.5, workspace), 9.0 / (9.0 + 81.0), 1e-6);
  EXPECT_EQ(prior.Share(1, 1.5, workspace), 0.0);
}

TEST(TransitionStoreTest, WithoutControlsThereAreNoSums) {
  const TransitionStore prior(std::vector(2, core::Matrix(core::Matrix::Ones(3, 1))),
                              std::vector(2, core::Matrix(core::Matrix::Zero(2, 1))), {});
  TransitionStore::Workspace workspace = prior.MakeWorkspace();
  EXPECT_FALSE(prior.SumControls(0, std::vector{1.0}, workspace));
  EXPECT_EQ(prior.mean_square_change(), 0.0);
}

TEST(TransitionStoreTest, AnInvalidFileIsRefused) {
  const auto path = dfr::test::ProcessFolder() / "broken_prior.dfr";
  core::Matrix rows = core::Matrix::Ones(60, 4);
  int features = 1;
  int entries = 1;
  const auto message = [&](const std::vector<int>& begin, int contexts = 60) {
    core::ArchiveWriter archive("prior", 1);
    const ResponseOptions options;
    archive.Number(options.ridge);
    archive.Number(options.prior_weight);
    archive.Integer(options.window);
    archive.Integer(options.max_per_step);
    archive.Number(options.forgetting);
    archive.Number(options.drift_ridge);
    archive.Number(options.slope_ridge);
    archive.Integer(options.measured_changes ? 1 : 0);
    archive.Integer(features);
    archive.Integer(entries);
    archive.Integers(begin);
    archive.MatrixBlock(rows);
    archive.MatrixBlock(core::Matrix::Zero(contexts, 1));
    archive.Save(path);
    core::ArchiveReader reader(path, "prior", 1);
    return test::MessageOf<std::runtime_error>(
        [&] { static_cast<void>(TransitionStore::Load(reader)); });
  };
  EXPECT_EQ(message({0, 30, 60}), "nothing thrown");
  EXPECT_EQ(message({0, 30, 30, 60}), "nothing thrown") << "a time step without a transition";
  EXPECT_THAT(message({0, 60, 60}), testing::HasSubstr("time step 0 of the transitions has 60"));
  EXPECT_THAT(message({0, -1, 30, 60}), testing::HasSubstr("time step 0 of"));
  EXPECT_THAT(message({0, 30, 20, 60}), testing::HasSubstr("time step 1 of"));
  EXPECT_THAT(message({0, 30, 40, 35, 60}), testing::HasSubstr("time step 2 of"));
  EXPECT_THAT(message({0, 30, 50}), testing::HasSubstr("begin at row 0"));
  EXPECT_THAT(message({1, 30, 60}), testing::HasSubstr("begin at row 0"));
  EXPECT_THAT(message({0}), testing::HasSubstr("begin at row 0"));
  EXPECT_THAT(message({0, 30, 60}, 59), testing::HasSubstr("contexts do not match"));
  for (const auto& [column, bad] : {std::pair(3, std::nan("")), std::pair(1, 2.0)}) {
    rows(7, column) = bad;
    EXPECT_THAT(message({0, 30, 60}), testing::HasSubstr("invalid entry")) << column;
    rows(7, column) = 1.0;
  }
  rows = core::Matrix::Ones(60, 3);
  entries = 0;
  EXPECT_NE(message({0, 30, 60}), "nothing thrown") << "no control entries";
  rows = core::Matrix::Ones(60, 2);
  std::swap(features, entries);
  EXPECT_NE(message({0, 30, 60}), "nothing thrown") << "no features";
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace dfr::control
