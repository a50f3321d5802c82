#include "dfr/imitation/mlp_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <thread>
#include <vector>

#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using testing::Each;
using testing::HasSubstr;

core::StateLayout ArmAndObject() {
  core::StateLayout layout;
  layout.Add("arm", 2);
  layout.Add("object", 3);
  return layout;
}

Whitening TheWhitening() { return {Eigen::Vector2d(1, -1), Eigen::Vector2d(2, 0.5)}; }

MlpPolicy NetworkPolicy(double limit = 1.0) {
  core::Random random(1);
  return {ArmAndObject(), "object[1:3]", TheWhitening(), Mlp({2, 6, 2}, random),
          Eigen::Vector2d::Constant(limit)};
}

TEST(MlpPolicyTest, ControlIsTheNetworkOfWhitenedFeaturesWithoutAllocation) {
  const MlpPolicy policy = NetworkPolicy(100.0);
  const std::vector<double> x = {9, 9, 9, 0.3, -0.7};
  const std::vector<double> z = {(0.3 - 1) / 2, (-0.7 + 1) / 0.5};
  std::vector<double> u(2), expected(2);
  policy.mlp().Forward(z, expected);
  {
    const test::NoAlloc guard;
    policy.Control(0, x, u);
  }
  EXPECT_EQ(u, expected);
}

TEST(MlpPolicyTest, ControlsStayWithinTheirLimits) {
  Mlp mlp({5, 3});
  Eigen::VectorXd parameters = Eigen::VectorXd::Zero(mlp.num_parameters());
  parameters.tail(3) << 4.0, -4.0, 0.25;  // the biases
  mlp.SetParameters(parameters);
  const MlpPolicy policy(ArmAndObject(), "", Whitening::Identity(5), mlp, Eigen::Vector3d(1, 2, 3));
  std::vector<double> u(3);
  policy.Control(0, std::vector<double>(5, 0.0), u);
  EXPECT_THAT(u, testing::ElementsAre(1.0, -2.0, 0.25));
  policy.Unlimited(std::vector<double>(5, 0.0), u);
  EXPECT_THAT(u, testing::ElementsAre(4.0, -4.0, 0.25));
}

TEST(MlpPolicyTest, BrokenStatesGiveNan) {
  const MlpPolicy policy = NetworkPolicy();
  const auto is_nan = testing::Truly([](double v) { return std::isnan(v); });
  for (const double broken :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    for (std::size_t i = 0; i < 5; ++i) {
      std::vector<double> x(5, 0.1), u(2, 0.0);
      x[i] = broken;
      policy.Control(0, x, u);
      EXPECT_THAT(u, Each(is_nan)) << "entry " << i;
    }
  }
  std::vector<double> u(2, 0.0);
  policy.Control(0, std::vector<double>(4, 0.1), u);
  EXPECT_THAT(u, Each(is_nan));
}

TEST(MlpPolicyTest, ThreadsShareAPolicy) {
  const MlpPolicy policy = NetworkPolicy();
  const auto run = [&policy](std::vector<double>& controls) {
    core::Random random(3);
    std::vector<double> x(5), u(2);
    for (int i = 0; i < 500; ++i) {
      for (double& entry : x) entry = random.Normal();
      policy.Control(0, x, u);
      controls.insert(controls.end(), u.begin(), u.end());
    }
  };
  std::vector<double> alone;
  run(alone);
  std::vector<std::vector<double>> together(4);
  {
    std::vector<std::jthread> threads;
    threads.reserve(together.size());
    for (auto& controls : together) threads.emplace_back([&] { run(controls); });
  }
  EXPECT_THAT(together, Each(alone));
}

// The state also has a picture, which the policy does not use.
TEST(MlpPolicyTest, AFileRestoresThePolicyToTheLastBit) {
  const test::TempFolder folder;
  core::StateLayout layout = ArmAndObject();
  layout.Add("camera", core::PictureShape{2, 3, 1});
  const MlpPolicy policy(layout, "object[1:3]", TheWhitening(), NetworkPolicy().mlp(),
                         Eigen::Vector2d(1.0, 0.5));
  policy.Save(folder / "policy.dfr");
  const MlpPolicy loaded = MlpPolicy::Load(folder / "policy.dfr");
  EXPECT_EQ(loaded.layout(), policy.layout());
  EXPECT_EQ(loaded.layout().state_dim(), 11);
  EXPECT_EQ(loaded.selection().spec(), "object[1:3]");
  EXPECT_EQ(loaded.control_limit(), policy.control_limit());
  core::Random random(2);
  for (int i = 0; i < 100; ++i) {
    std::vector<double> x(11), u(2), expected(2);
    for (double& entry : x) entry = random.Normal();
    policy.Control(0, x, expected);
    loaded.Control(0, x, u);
    EXPECT_EQ(u, expected);
  }
}

TEST(MlpPolicyTest, AFileWithInconsistentPartsIsRefusedByName) {
  const test::TempFolder folder;
  core::ArchiveWriter writer("mlp-policy", 1);
  writer.Integer(1);
  writer.Text("object");
  writer.Integer(3);
  writer.Text("object");
  Whitening::Identity(3).Save(writer);
  Mlp({2, 2}).Save(writer);
  writer.Numbers(std::vector<double>{1, 1});
  writer.Save(folder / "unfit.dfr");
  EXPECT_THAT(
      test::MessageOf<std::runtime_error>([&] { MlpPolicy::Load(folder / "unfit.dfr"); }),
      testing::AllOf(HasSubstr("unfit.dfr"), HasSubstr("3 features, but its network takes 2")));
}

TEST(MlpPolicyTest, ErrorsNameThePartThatDoesNotFit) {
  const auto message = [](const char* features, Mlp mlp, Eigen::VectorXd limit) {
    return test::MessageOf<std::invalid_argument>([&] {
      MlpPolicy(ArmAndObject(), features, TheWhitening(), std::move(mlp), std::move(limit));
    });
  };
  const Eigen::Vector2d ones = Eigen::Vector2d::Ones();
  EXPECT_THAT(message("tip", Mlp({2, 2}), ones), HasSubstr("'tip'"));
  EXPECT_THAT(message("object", Mlp({3, 2}), ones),
              HasSubstr("3 features, but its whitening has 2"));
  EXPECT_THAT(message("arm", Mlp({3, 2}), ones), HasSubstr("network takes 3"));
  EXPECT_THAT(message("arm", Mlp({2, 3}), ones), HasSubstr("3 outputs, and 2 control limits"));
  EXPECT_THAT(message("arm", Mlp({2, 2}), Eigen::Vector2d(1, 0)), HasSubstr("limit 1 is 0"));
}

}  // namespace
}  // namespace dfr::imitation
