#include "dfr/control/response/transition_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "tests/support/message_of.h"

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
  EXPECT_THAT(message({.slope_ridge = -1.0}), testing::HasSubstr("slope_ridge"));
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  EXPECT_THAT(message({.ridge = kInfinity}), testing::HasSubstr("ridge"));
  EXPECT_THAT(message({.drift_ridge = kInfinity}), testing::HasSubstr("drift_ridge"));
  EXPECT_THAT(message({.slope_ridge = kInfinity}), testing::HasSubstr("slope_ridge"));
  EXPECT_THAT(message({.prior_weight = kInfinity}), testing::HasSubstr("prior_weight"));
  EXPECT_THAT(message({.prior_weight = -1.0}), testing::HasSubstr("prior_weight"));
  EXPECT_THAT(message({.forgetting = 1.0}), testing::HasSubstr("forgetting"));
  EXPECT_THAT(message({.max_per_step = 0}), testing::HasSubstr("max_per_step"));
  controls[1] = core::Matrix::Ones(4, 2);
  EXPECT_THAT(message({}), testing::HasSubstr("demonstration 1"));
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

TEST(TransitionStoreTest, AFileWithInvalidTimeStepsIsRefused) {
  const auto path = std::filesystem::path(testing::TempDir()) / "broken_prior.dfr";
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
    archive.Integer(1);
    archive.Integer(1);
    archive.Integers(begin);
    archive.MatrixBlock(core::Matrix::Ones(60, 4));
    archive.MatrixBlock(core::Matrix::Zero(contexts, 1));
    archive.Save(path);
    core::ArchiveReader reader(path, "prior", 1);
    return test::MessageOf<std::runtime_error>(
        [&] { static_cast<void>(TransitionStore::Load(reader)); });
  };
  EXPECT_EQ(message({0, 30, 60}), "nothing thrown");
  EXPECT_THAT(message({0, 60, 60}), testing::HasSubstr("time step 0 of the transitions has 60"));
  EXPECT_THAT(message({0, -1, 30, 60}), testing::HasSubstr("time step 0 of"));
  EXPECT_THAT(message({0, 30, 20, 60}), testing::HasSubstr("time step 1 of"));
  EXPECT_THAT(message({0, 30, 40, 35, 60}), testing::HasSubstr("time step 2 of"));
  EXPECT_THAT(message({0, 30, 50}), testing::HasSubstr("begin at row 0"));
  EXPECT_THAT(message({1, 30, 60}), testing::HasSubstr("begin at row 0"));
  EXPECT_THAT(message({0}), testing::HasSubstr("begin at row 0"));
  EXPECT_THAT(message({0, 30, 60}, 59), testing::HasSubstr("contexts do not match"));
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace dfr::control
