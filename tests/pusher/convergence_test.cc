#include "convergence/convergence.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace dfr::apps::pusher {
namespace {

TEST(ConvergenceTest, MeanOverModelsHasTheErrorBetweenModels) {
  const ConvergenceCurve first{
      .method = "dfr", .mean = {0.5, 0.75}, .standard_error = {0.1, 0.1}, .reached = 40};
  const ConvergenceCurve second{
      .method = "dfr", .mean = {0.75, 0.75}, .standard_error = {0.1, 0.1}, .reached = 45};
  const ConvergenceCurve mean = MeanOverModels({first, second});
  EXPECT_EQ(mean.method, "dfr");
  EXPECT_EQ(mean.reached, 85);
  EXPECT_EQ(mean.mean, (std::vector<double>{0.625, 0.75}));
  EXPECT_EQ(mean.standard_error, (std::vector<double>{0.125, 0.0}));
  EXPECT_EQ(MeanOverModels({first}).standard_error[0], 0.0);
  EXPECT_THROW(static_cast<void>(MeanOverModels({})), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::apps::pusher
