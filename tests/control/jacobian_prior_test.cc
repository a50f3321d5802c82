#include "dfr/control/jacobian_prior.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/control/jacobian_estimate.h"
#include "dfr/core/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "tests/support/all_close.h"

namespace dfr::control {
namespace {

// What files of all versions begin with.
void WriteOptions(core::ArchiveWriter& archive) {
  const JacobianOptions options;
  archive.Number(options.ridge);
  archive.Number(options.prior_weight);
  archive.Integer(options.window);
  archive.Integer(options.max_per_step);
  archive.Number(options.forgetting);
}

TEST(JacobianPriorTest, ErrorsNameTheCulprit) {
  const std::vector<core::Matrix> features(3, core::Matrix::Ones(6, 3));
  std::vector<core::Matrix> controls(3, core::Matrix::Ones(5, 2));
  const auto message = [&](const JacobianOptions& options) -> std::string {
    try {
      const JacobianPrior prior(features, controls, options);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  EXPECT_EQ(message({}), "nothing thrown");
  EXPECT_THAT(message({.ridge = 0.0}), testing::HasSubstr("ridge"));
  EXPECT_THAT(message({.motion_ridge = 0.0}), testing::HasSubstr("motion_ridge"));
  EXPECT_THAT(message({.slope_ridge = -1.0}), testing::HasSubstr("slope_ridge"));
  EXPECT_THAT(message({.forgetting = 1.0}), testing::HasSubstr("forgetting"));
  EXPECT_THAT(message({.max_per_step = 0}), testing::HasSubstr("max_per_step"));
  controls[1] = core::Matrix::Ones(4, 2);
  EXPECT_THAT(message({}), testing::HasSubstr("demonstration 1"));
}

// Files of before version 4 keep the products v v' and v dz' of each transition, those of before
// version 3 no controls.
TEST(JacobianPriorTest, OldFilesGiveTheSameAnswerToControls) {
  constexpr int kFewSteps = 4;
  constexpr int kDemonstrations = 6;
  const core::Matrix truth = (core::Matrix(3, 2) << 0.2, 0.1, -0.1, 0.3, 0.05, -0.4).finished();
  core::Random random(21);
  const auto draw = [&](Eigen::Index rows, Eigen::Index cols) {
    core::Matrix m(rows, cols);
    for (double& entry : m.reshaped()) entry = random.Normal();
    return m;
  };
  std::vector<core::Matrix> features;
  std::vector<core::Matrix> controls;
  for (int d = 0; d < kDemonstrations; ++d) {
    controls.push_back(draw(kFewSteps, 2));
    features.push_back(draw(kFewSteps + 1, 3));
    for (Eigen::Index t = 0; t < kFewSteps; ++t) {
      features[d].row(t + 1) = features[d].row(t) + controls[d].row(t) * truth.transpose();
    }
  }
  const std::vector<double> z = {0.3, -0.2, 0.1};
  const auto answer = [&](const JacobianPrior& prior) -> Eigen::MatrixXd {
    JacobianEstimate estimate(std::make_shared<const JacobianPrior>(prior), {}, false);
    estimate.Compute(1, z);
    return estimate.jacobian();
  };
  const Eigen::MatrixXd expected = answer(JacobianPrior(features, controls, {}));

  const auto path = std::filesystem::path(testing::TempDir()) / "old_prior.dfr";
  for (const int version : {2, 3}) {
    SCOPED_TRACE(version);
    std::vector<int> begin;
    core::Matrix points(kFewSteps * kDemonstrations, 3);
    core::Matrix signs(kFewSteps * kDemonstrations, 2);
    core::Matrix products(kFewSteps * kDemonstrations, 3 + 6);
    Eigen::Index row = 0;
    for (Eigen::Index t = 0; t < kFewSteps; ++t) {
      begin.push_back(static_cast<int>(row));
      for (std::size_t d = 0; d < kDemonstrations; ++d, ++row) {
        const auto v = controls[d].row(t);
        const auto dz = features[d].row(t + 1) - features[d].row(t);
        points.row(row) = features[d].row(t);
        signs.row(row) = v;
        products.row(row) << v[0] * v[0], v[0] * v[1], v[1] * v[1], v[0] * dz[0], v[1] * dz[0],
            v[0] * dz[1], v[1] * dz[1], v[0] * dz[2], v[1] * dz[2];
      }
    }
    begin.push_back(static_cast<int>(row));
    core::ArchiveWriter archive("prior", version);
    WriteOptions(archive);
    archive.Integer(3);
    archive.Integer(2);
    archive.Integers(begin);
    archive.MatrixBlock(points);
    if (version == 3) archive.MatrixBlock(signs);
    archive.MatrixBlock(products);
    archive.Save(path);
    core::ArchiveReader reader(path, "prior", 5);
    const JacobianPrior old = JacobianPrior::Load(reader);
    EXPECT_EQ(old.has_controls(), version == 3);
    EXPECT_TRUE(test::AllClose(answer(old), expected, 1e-6));
  }
  std::filesystem::remove(path);
}

TEST(JacobianPriorTest, TimeStepsThatDoNotFollowEachOtherAreRefused) {
  const auto path = std::filesystem::path(testing::TempDir()) / "broken_prior.dfr";
  const auto message = [&](const std::vector<int>& begin) -> std::string {
    core::ArchiveWriter archive("prior", 5);
    WriteOptions(archive);
    archive.Number(1.0);   // motion_ridge
    archive.Number(10.0);  // slope_ridge
    archive.Integer(1);
    archive.Integer(1);
    archive.Integer(1);
    archive.Integers(begin);
    archive.MatrixBlock(core::Matrix::Ones(60, 4));
    archive.Save(path);
    core::ArchiveReader reader(path, "prior", 5);
    try {
      static_cast<void>(JacobianPrior::Load(reader));
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  EXPECT_EQ(message({0, 30, 60}), "nothing thrown");
  EXPECT_THAT(message({0, 60, 60}), testing::HasSubstr("time step 0 of the Jacobian prior has 60"));
  EXPECT_THAT(message({0, -1, 30, 60}), testing::HasSubstr("time step 0 of"));
  EXPECT_THAT(message({0, 30, 20, 60}), testing::HasSubstr("time step 1 of"));
  EXPECT_THAT(message({0, 30, 40, 35, 60}), testing::HasSubstr("time step 2 of"));
  EXPECT_THAT(message({0, 30, 50}), testing::HasSubstr("begin and end"));
  EXPECT_THAT(message({1, 30, 60}), testing::HasSubstr("begin and end"));
  EXPECT_THAT(message({0}), testing::HasSubstr("begin and end"));
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace dfr::control
