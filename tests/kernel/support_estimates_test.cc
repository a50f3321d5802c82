#include "dfr/kernel/support_estimates.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <ostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/time_varying_support.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::kernel {
namespace {

using testing::HasSubstr;

// Normal, with variances 4 and 0.25 and a correlation.
core::Matrix Cloud(int m, core::Random& random) {
  core::Matrix samples(m, 2);
  for (int i = 0; i < m; ++i) {
    const double a = random.Normal();
    samples.row(i) << 2.0 * a + 1.0, 0.3 * a + 0.4 * random.Normal() - 2.0;
  }
  return samples;
}

struct Named {
  std::string name;
  std::function<std::shared_ptr<const SupportEstimate>(const core::Matrix&, double nu)> fit;

  friend std::ostream& operator<<(std::ostream& out, const Named& n) { return out << n.name; }
};

class SupportEstimatesTest : public testing::TestWithParam<Named> {
 protected:
  core::Random random_{71};
  core::Matrix samples_ = Cloud(300, random_);
};

TEST_P(SupportEstimatesTest, LeavesAboutAShareNuOfItsSamplesOutside) {
  for (const double nu : {0.05, 0.3}) {
    const auto estimate = GetParam().fit(samples_, nu);
    int outside = 0;
    for (Eigen::Index i = 0; i < samples_.rows(); ++i) {
      outside += estimate->Decision(core::Row(samples_, i)) < -1e-9 ? 1 : 0;
    }
    EXPECT_LE(outside, 300 * nu);
    // The share of new samples, within four standard errors and the error of 300 samples.
    const core::Matrix fresh = Cloud(2000, random_);
    int fresh_outside = 0;
    for (Eigen::Index i = 0; i < fresh.rows(); ++i) {
      fresh_outside += estimate->Decision(core::Row(fresh, i)) < 0.0 ? 1 : 0;
    }
    EXPECT_NEAR(fresh_outside / 2000.0, nu, 4.0 * std::sqrt(nu * (1.0 - nu) / 300.0));
  }
}

TEST_P(SupportEstimatesTest, GradientIsTheDerivativeAndBelowTheLipschitzBound) {
  const auto estimate = GetParam().fit(samples_, 0.1);
  std::vector<double> gradient(2);
  for (int i = 0; i < 50; ++i) {
    std::vector<double> x = {random_.Uniform(-5.0, 7.0), random_.Uniform(-4.0, 0.0)};
    const double g = estimate->Gradient(x, gradient);
    EXPECT_EQ(g, estimate->Decision(x));
    EXPECT_LE(std::hypot(gradient[0], gradient[1]), estimate->lipschitz_bound() * (1.0 + 1e-12));
    constexpr double kStep = 1e-6;
    for (std::size_t k = 0; k < 2; ++k) {
      const double at = x[k];
      x[k] = at + kStep;
      const double ahead = estimate->Decision(x);
      x[k] = at - kStep;
      // Second derivatives reach 1 / distance, about 30 here; rounding is 1e-15 / step.
      EXPECT_NEAR(gradient[k], (ahead - estimate->Decision(x)) / (2.0 * kStep), 1e-4);
      x[k] = at;
    }
  }
}

TEST_P(SupportEstimatesTest, BrokenSensorsReadAsOutsideAndNothingAllocates) {
  const auto estimate = GetParam().fit(samples_, 0.1);
  std::vector<double> gradient(2);
  const std::vector<double> broken = {0.0, std::nan("")}, wide(3, 0.0), fine = {1.0, -2.0};
  std::vector<double> wide_gradient(3, 7.0);
  const dfr::test::NoAlloc guard;
  EXPECT_EQ(estimate->state_dim(), 2);
  EXPECT_EQ(estimate->Decision(broken), -std::numeric_limits<double>::infinity());
  EXPECT_EQ(estimate->Gradient(broken, gradient), -std::numeric_limits<double>::infinity());
  EXPECT_EQ(gradient[0], 0.0);
  EXPECT_EQ(estimate->Decision(wide), -std::numeric_limits<double>::infinity());
  EXPECT_EQ(estimate->Gradient(fine, wide_gradient), -std::numeric_limits<double>::infinity());
  for (const double slope : wide_gradient) EXPECT_EQ(slope, 0.0);
  EXPECT_EQ(estimate->Gradient(wide, wide_gradient), -std::numeric_limits<double>::infinity());
  EXPECT_GT(estimate->Gradient(fine, gradient), 0.0);
}

INSTANTIATE_TEST_SUITE_P(
    Methods, SupportEstimatesTest,
    testing::Values(Named{"Svm",
                          [](const core::Matrix& s, double nu) {
                            return std::make_shared<SvmEstimate>(
                                OneClassSvm::Fit(s, {.nu = nu, .gamma = 0.1, .tolerance = 1e-7}));
                          }},
                    Named{"KernelDensity",
                          [](const core::Matrix& s, double nu) {
                            return std::make_shared<SvmEstimate>(FitKernelDensity(s, nu, 1.0));
                          }},
                    Named{"Gaussian",
                          [](const core::Matrix& s, double nu) {
                            return std::make_shared<GaussianEstimate>(GaussianEstimate::Fit(s, nu));
                          }},
                    Named{"Neighbours",
                          [](const core::Matrix& s, double nu) {
                            return std::make_shared<NeighbourEstimate>(
                                NeighbourEstimate::Fit(s, nu, 5));
                          }}),
    [](const auto& test) { return test.param.name; });

TEST(FitKernelDensityTest, IsTheMeanOfTheKernelsWithEachSampleJudgedByTheOthers) {
  core::Matrix samples(4, 1);
  samples << 0.0, 1.0, 1.5, 10.0;
  const auto density = FitKernelDensity(samples, 0.25, 0.5);
  const auto k = [](double d) { return std::exp(-0.5 * d * d); };
  // Without themselves: 10 stands alone; next comes 0.
  EXPECT_NEAR(density.rho(), (k(1.0) + k(1.5) + k(10.0)) / 3.0, 1e-15);
  const double x[] = {0.5};
  EXPECT_NEAR(density.Decision(x) + density.rho(), (2.0 * k(0.5) + k(1.0) + k(9.5)) / 4.0, 1e-15);
}

TEST(GaussianEstimateTest, IsTheMahalanobisDistance) {
  core::Matrix samples(4, 2);
  samples << 2, 0, -2, 0, 0, 1, 0, -1;  // mean 0, covariance diag(2, 0.5)
  const auto estimate = GaussianEstimate::Fit(samples, 1e-9, 0.0);
  EXPECT_NEAR(estimate.radius(), std::sqrt(2.0), 1e-14);
  const double x[] = {1.0, 1.0};
  EXPECT_NEAR(estimate.Decision(x), std::sqrt(2.0) - std::sqrt(1.0 / 2.0 + 1.0 / 0.5), 1e-14);
  EXPECT_NEAR(estimate.lipschitz_bound(), std::sqrt(2.0), 1e-14);
}

TEST(NeighbourEstimateTest, IsTheDistanceToTheKthNearest) {
  core::Matrix samples(5, 1);
  samples << 0, 1, 3, 6, 10;
  const auto estimate = NeighbourEstimate::Fit(samples, 0.2, 2);
  // Second nearest others at 3, 2, 3, 4, 7: one of five may lie beyond.
  EXPECT_EQ(estimate.radius(), 4.0);
  const double x[] = {5.0};
  double slope = 0.0;
  EXPECT_EQ(estimate.Gradient(x, {&slope, 1}), 2.0);  // 3 is second nearest, after 6
  EXPECT_EQ(slope, -1.0);
}

// The end of a range is valid.
TEST(SupportEstimatesEndsTest, TheFewestSamplesAndTheLargestNuAreTaken) {
  core::Matrix two(2, 1);
  two << -1.0, 1.0;
  // With nu = 1 rho is the least value of all samples, each judged by the other.
  EXPECT_NEAR(FitKernelDensity(two, 1.0, 0.5).rho(), std::exp(-2.0), 1e-15);
  EXPECT_NEAR(GaussianEstimate::Fit(two, 1.0, 0.0).radius(), 1.0, 1e-15);
  EXPECT_EQ(NeighbourEstimate::Fit(two, 1.0, 1).radius(), 2.0);
  core::Matrix three(3, 1);
  three << 0.0, 1.0, 3.0;
  // Nearest others at 1, 1, 2.
  EXPECT_EQ(NeighbourEstimate::Fit(three, 1.0, 1).radius(), 1.0);
  EXPECT_EQ(NeighbourEstimate::Fit(three, 0.3, 1).radius(), 2.0);
  EXPECT_EQ(NeighbourEstimate::Fit(three, 0.4, 1).radius(), 1.0);
}

TEST(EstimatePerStepTest, FollowsTheTimeStepsAsTheSvmsDo) {
  core::Random random(73);
  std::vector<core::Matrix> demonstrations;
  for (int d = 0; d < 40; ++d) {
    core::Matrix states = Cloud(6 + d % 3, random);
    for (Eigen::Index t = 0; t < states.rows(); ++t) states(t, 0) += 20.0 * static_cast<double>(t);
    demonstrations.push_back(states);
  }
  const auto neighbours = EstimatePerStep::Fit(demonstrations, [](const core::Matrix& s) {
    return std::make_shared<NeighbourEstimate>(NeighbourEstimate::Fit(s, 0.1, 3));
  });
  const auto svms = EstimatePerStep::Fit(
      demonstrations,
      [](const core::Matrix& s) { return std::make_shared<SvmEstimate>(OneClassSvm::Fit(s, {})); },
      5);
  const auto expected = TimeVaryingSupport::Fit(demonstrations, {.num_steps = 5});
  EXPECT_EQ(neighbours.num_steps(), 8);
  EXPECT_EQ(svms.num_steps(), 5);
  for (int t = 0; t < 5; ++t) {
    const std::vector<double> here = {20.0 * t + 1.0, -2.0};
    const std::vector<double> there = {20.0 * t + 15.0, -2.0};
    EXPECT_EQ(svms.Decision(t, here), expected.Decision(t, here));
    EXPECT_GT(neighbours.Decision(t, here), 0.0);
    EXPECT_LT(neighbours.Decision(t, there), 0.0);
  }
  EXPECT_EQ(svms.Decision(99, std::vector<double>{81.0, -2.0}),
            svms.Decision(4, std::vector<double>{81.0, -2.0}));
}

TEST(SupportEstimatesErrorsTest, NameTheCulprit) {
  const core::Matrix few = core::Matrix::Random(3, 2);
  const core::Matrix equal = core::Matrix::Ones(5, 2);
  core::Matrix broken = core::Matrix::Random(9, 2);
  broken(4, 1) = std::nan("");
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>(
                  [&] { (void)NeighbourEstimate::Fit(few, 0.1, 5); }),
              HasSubstr("at least 6 samples are needed; there are 3"));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>(
                  [&] { (void)NeighbourEstimate::Fit(few, 0.1, 0); }),
              HasSubstr("k must"));
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { (void)GaussianEstimate::Fit(equal, 0.1); }),
      HasSubstr("singular"));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>(
                  [&] { (void)GaussianEstimate::Fit(broken, 0.1); }),
              HasSubstr("sample 4"));
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { (void)GaussianEstimate::Fit(few, 0.0); }),
      HasSubstr("nu must"));
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { (void)GaussianEstimate::Fit(few, 1.1); }),
      HasSubstr("nu must"));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>(
                  [&] { (void)GaussianEstimate::Fit(few, 0.1, -1.0); }),
              HasSubstr("ridge"));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>(
                  [&] { (void)NeighbourEstimate::Fit(few, 0.1, 1000); }),
              HasSubstr("k must"));
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { (void)FitKernelDensity(few, 0.1, -1.0); }),
      HasSubstr("gamma"));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>([&] {
                (void)EstimatePerStep::Fit({&few, 1}, {}, -1);
              }),
              HasSubstr("num_steps must not be negative: -1"));
  EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>([&] {
                (void)EstimatePerStep::Fit({&few, 1}, [](const auto&) { return nullptr; });
              }),
              HasSubstr("the fit of time step 0 returned no estimate"));
}

}  // namespace
}  // namespace dfr::kernel
