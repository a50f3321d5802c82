#include "dfr/control/response/response.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/control/response/response_estimate.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "tests/control/guided/linear_demonstrations.h"
#include "tests/control/rightwards.h"
#include "tests/control/task.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

TEST(ResponseTest, ControlUnitAndLargestControlComeFromDemonstrations) {
  const auto demonstrations = test::Rightwards();
  const Response response({test::IdentityFeatures(), demonstrations});
  double squares = 0.0;
  double largest = 0.0;
  for (const auto& d : demonstrations) {
    squares += d.controls.squaredNorm();
    largest = std::max(largest, d.controls.rowwise().norm().maxCoeff());
  }
  const double unit = std::sqrt(squares / (30.0 * test::kSteps));
  EXPECT_NEAR(response.control_unit(), unit, 1e-12);
  EXPECT_NEAR(response.largest_control(), largest / unit, 1e-12);
  EXPECT_EQ(response.feature_dim(), 2);
  EXPECT_EQ(response.control_dim(), 2);
  EXPECT_FALSE(response.has_drift()) << "the point rests without a control";
}

// Thirty thrown points. Each keeps its speed unless a force changes it.
TEST(ResponseTest, HasADriftIfItExplainsHeldOutDemonstrations) {
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
  EXPECT_TRUE(Response({test::IdentityFeatures(), thrown}).has_drift());
  EXPECT_FALSE(Response({test::IdentityFeatures(), {thrown.data(), 1}}).has_drift())
      << "one demonstration leaves none to hold out";
  for (core::Trajectory& d : thrown) d.states.setZero();
  EXPECT_FALSE(Response({test::IdentityFeatures(), thrown}).has_drift()) << "nothing moves";
}

// A point drives right and steers to the middle with unsteady hands. Steps are .4 long. Sensors
// have noise of standard deviation `noise`.
FeatureTrajectories Drives(double noise) {
  core::Random random(11);
  const auto seen = test::Simulate(
      40, 45, 2, 2, [&](int, auto z) { z << 0.5 * random.Normal(), random.Uniform(-3.0, 3.0); },
      [&](int, const auto& z, auto v, auto next) {
        v << 0.4 + 0.02 * random.Normal(), -0.1 * z[1] + 0.02 * random.Normal();
        next = z + v;
      });
  FeatureTrajectories drives;
  drives.points = seen.features;
  drives.controls = seen.controls;
  for (core::Matrix& points : drives.points) {
    for (double& entry : points.reshaped()) entry += noise * random.Normal();
  }
  return drives;
}

TEST(ResponseTest, NoiseOfStatesBarelyChangesTheNominalControl) {
  const auto path = dfr::test::ProcessFolder() / "drives.dfr";
  for (const double noise : {0.0, 0.2}) {
    SCOPED_TRACE(noise);
    const FeatureTrajectories drives = Drives(noise);
    const Response fitted(drives);
    EXPECT_EQ(fitted.prior()->options().measured_changes, noise == 0.0);
    core::ArchiveWriter archive("response", 1);
    fitted.Save(archive);
    archive.Save(path);
    core::ArchiveReader reader(path, "response", 1);
    const Response response = Response::Load(reader);
    EXPECT_EQ(response.prior()->options().measured_changes, noise == 0.0);
    const ResponseEstimate estimate(response.prior(), {}, response.has_drift());
    LocalFit fit = estimate.MakeFit();
    double missed = 0.0;
    Eigen::ArrayXXd controls(0, 2);
    for (std::size_t d = 0; d < drives.points.size(); d += 5) {
      for (Eigen::Index t = 0; t < drives.controls[d].rows(); ++t) {
        estimate.FitAt(static_cast<int>(t), core::Row(drives.points[d], t), fit);
        Eigen::VectorXd v(2);
        ASSERT_TRUE(fit.NominalControl(v));
        const Eigen::VectorXd control = drives.controls[d].row(t) / response.control_unit();
        missed += (v - control).squaredNorm();
        controls.conservativeResize(controls.rows() + 1, 2);
        controls.bottomRows(1) = control.transpose().array();
      }
    }
    const double variance = (controls.rowwise() - controls.colwise().mean()).square().sum();
    EXPECT_LT(missed, 0.25 * variance);
  }
  std::filesystem::remove(path);
}

// The first entry has three values, and the second has many. With `extra` = 5, five of 30
// demonstrations add a fourth value.
TEST(ResponseTest, ValuesAreListedForEntriesThatHaveFew) {
  auto demonstrations = test::Rightwards();
  const auto stepped = [&](int extra) {
    for (std::size_t d = 0; d < demonstrations.size(); ++d) {
      for (Eigen::Index t = 0; t < demonstrations[d].controls.rows(); ++t) {
        const auto last = static_cast<int>(d) < extra && t < 2 ? static_cast<double>(t) : 0.0;
        demonstrations[d].controls(t, 0) = 0.1 * static_cast<double>(t % 3) - 0.1 + last;
      }
    }
    return Response({test::IdentityFeatures(), demonstrations});
  };
  const Response response = stepped(0);
  ASSERT_EQ(response.values().size(), 2u);
  const double size = 0.1 / response.control_unit();
  ASSERT_EQ(response.values()[0].size(), 3u);
  EXPECT_NEAR(response.values()[0][0], -size, 1e-12);
  EXPECT_NEAR(response.values()[0][1], 0.0, 1e-12);
  EXPECT_NEAR(response.values()[0][2], size, 1e-12);
  EXPECT_TRUE(response.values()[1].empty());
  EXPECT_EQ(stepped(5).values()[0].size(), 4u);
  for (core::Trajectory& d : demonstrations) d.controls.col(0).setConstant(0.1);
  const Response constant({test::IdentityFeatures(), demonstrations});
  EXPECT_TRUE(constant.values()[0].empty()) << "there is one value";
}

TEST(ResponseTest, AFileKeepsTheResponse) {
  const auto path = dfr::test::ProcessFolder() / "response_kept.dfr";
  auto demonstrations = test::Rightwards();
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t) d.controls(t, 0) = t % 2 == 0 ? 0.1 : 0.0;
  }
  const Response response({test::IdentityFeatures(), demonstrations});
  core::ArchiveWriter archive("response", 1);
  response.Save(archive);
  archive.Save(path);
  core::ArchiveReader reader(path, "response", 1);
  const Response loaded = Response::Load(reader);
  reader.End();
  std::filesystem::remove(path);
  EXPECT_EQ(loaded.control_unit(), response.control_unit());
  EXPECT_EQ(loaded.largest_control(), response.largest_control());
  EXPECT_EQ(loaded.has_drift(), response.has_drift());
  EXPECT_EQ(loaded.values(), response.values());
  EXPECT_EQ(loaded.values()[0].size(), 2u);
  const ResponseEstimate kept_estimate(loaded.prior());
  const ResponseEstimate made_estimate(response.prior());
  for (int t = 0; t < test::kSteps; ++t) {
    const std::vector<double> z = {t * test::kSpeed, 0.1};
    const LocalFit kept = kept_estimate.FitAt(t, z);
    const LocalFit made = made_estimate.FitAt(t, z);
    EXPECT_EQ(kept.jacobian(), made.jacobian());
    EXPECT_EQ(kept.drift(), made.drift());
  }
}

TEST(ResponseTest, AFileWithAnInvalidControlIsRefused) {
  const auto path = dfr::test::ProcessFolder() / "response.dfr";
  const auto message = [&](double largest, double unit) {
    core::ArchiveWriter archive("response", 1);
    archive.Number(largest);
    archive.Number(unit);
    archive.Integer(0);
    archive.Save(path);  // without the transitions, which are read last
    core::ArchiveReader reader(path, "response", 1);
    return test::MessageOf<std::runtime_error>([&] { static_cast<void>(Response::Load(reader)); });
  };
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  for (const double bad : {-0.1, kEndless, -kEndless, std::nan("")}) {
    SCOPED_TRACE(bad);
    EXPECT_THAT(message(bad, 1.0), HasSubstr("the largest control"));
    EXPECT_THAT(message(1.0, bad), HasSubstr("the unit of controls"));
  }
  EXPECT_THAT(message(1.0, 0.0), HasSubstr("the unit of controls"));
  EXPECT_THAT(message(0.0, 1.0), testing::Not(HasSubstr("the largest control")));
  std::filesystem::remove(path);
}

TEST(ResponseTest, ErrorsNameTheCulprit) {
  const auto message = [](const std::function<void(std::vector<core::Trajectory>&)>& change) {
    auto demonstrations = test::Rightwards();
    change(demonstrations);
    return test::MessageOf<std::invalid_argument>([&] {
      const Response response({test::IdentityFeatures(), demonstrations});
    });
  };
  EXPECT_THAT(message([](auto& d) { d.clear(); }), HasSubstr("no demonstrations"));
  EXPECT_THAT(message([](auto& d) { d[2].states(3, 0) = std::nan(""); }),
              HasSubstr("demonstration 2 has a non-finite entry"));
  EXPECT_THAT(message([](auto& d) { d[4].controls.conservativeResize(3, 2); }),
              HasSubstr("demonstration 4"));
  EXPECT_THAT(message([](auto& demonstrations) {
                for (auto& d : demonstrations) d.controls.setZero();
              }),
              HasSubstr("all demonstrated controls are zero"));
}

TEST(ResponseTest, ShapesAreCheckedBeforeAnyUse) {
  const FeatureTrajectories drives = Drives(0.0);
  const std::function<void(FeatureTrajectories&)> changes[] = {
      [](auto& d) { d.controls.pop_back(); },
      [](auto& d) { d.points.pop_back(); },
      [](auto& d) { d.controls[39].conservativeResize(45, 1); },
      [](auto& d) { d.points[39].conservativeResize(4, 2); },
      [](auto& d) { d.points[39].conservativeResize(46, 1); },
      [](auto& d) { d.contexts.assign(3, core::Matrix::Zero(45, 1)); }};
  for (const auto& change : changes) {
    FeatureTrajectories wrong = drives;
    change(wrong);
    EXPECT_THROW(Response{wrong}, std::invalid_argument) << &change - changes;
  }
}

TEST(TaskViewTest, PartsThatDoNotFitEachOtherAreRefused) {
  const auto support = test::MovingDisk();
  const test::Task task(test::IdentityFeatures(), support, test::Rightwards());
  EXPECT_NO_THROW(CheckFits(task));
  const auto one = core::FeatureTransform::Identity(core::FeatureSelection::All(1));
  EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] {
                CheckFits({one, support, task.levels, task.response});
              }),
              HasSubstr("there are 1 features, but the support takes 2"));
  const test::GaussianSupport narrow({{0.0}}, 1.0, 0.5);
  EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] {
                CheckFits({one, narrow, task.levels, task.response});
              }),
              HasSubstr("the response has 2"));
}

}  // namespace
}  // namespace dfr::control
