#include "dfr/kernel/incremental_support.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::kernel {
namespace {

using testing::HasSubstr;

core::Matrix Walk(core::Random& random, int length) {
  core::Matrix states(length, 2);
  for (Eigen::Index t = 0; t < length; ++t) {
    states.row(t) << static_cast<double>(t) + random.Normal(), random.Normal();
  }
  return states;
}

// The two supports decide alike, up to what two fits to the tolerance may differ.
void ExpectSame(const TimeVaryingSupport& a, const TimeVaryingSupport& b, double tolerance) {
  ASSERT_EQ(a.num_steps(), b.num_steps());
  core::Random random(81);
  for (int t = 0; t < a.num_steps(); ++t) {
    for (int i = 0; i < 20; ++i) {
      const std::vector<double> x = {t + 2.0 * random.Normal(), 2.0 * random.Normal()};
      EXPECT_NEAR(a.Decision(t, x), b.Decision(t, x), tolerance) << "at t = " << t;
    }
  }
}

TEST(IncrementalSupportTest, AnyRunOfChangesEndsWhereAFreshFitDoes) {
  core::Random random(82);
  std::vector<core::Matrix> demonstrations;
  demonstrations.reserve(50);
  for (int d = 0; d < 30; ++d) demonstrations.push_back(Walk(random, 8));
  const TimeVaryingSupportOptions options{.svm = {.nu = 0.2, .gamma = 0.5, .tolerance = 1e-7}};
  IncrementalSupport incremental(demonstrations, options);
  for (int change = 0; change < 20; ++change) {
    if (random.Uniform() < 0.5) {
      demonstrations.push_back(Walk(random, 6 + static_cast<int>(random.Below(5))));
      incremental.Add(demonstrations.back());
    } else {
      const auto index = static_cast<int>(random.Below(demonstrations.size()));
      demonstrations.erase(demonstrations.begin() + index);
      incremental.Remove(index);
    }
    ASSERT_EQ(incremental.num_demonstrations(), static_cast<int>(demonstrations.size()));
  }
  // The tolerance over nu m = 6, with a margin of ten.
  ExpectSame(incremental.support(), TimeVaryingSupport::Fit(demonstrations, options), 2e-7);
}

TEST(IncrementalSupportTest, AChangeTakesFewerStepsThanAFreshFit) {
  core::Random random(83);
  std::vector<core::Matrix> demonstrations;
  demonstrations.reserve(201);
  for (int d = 0; d < 200; ++d) demonstrations.push_back(Walk(random, 5));
  const TimeVaryingSupportOptions options{.svm = {.nu = 0.1, .gamma = 0.2}};
  IncrementalSupport incremental(demonstrations, options);
  demonstrations.push_back(Walk(random, 5));
  incremental.Add(demonstrations.back());
  std::vector<FitSummary> fresh;
  (void)TimeVaryingSupport::Fit(demonstrations, options, &fresh);
  std::int64_t fresh_steps = 0;
  std::int64_t steps = 0;
  for (std::size_t t = 0; t < fresh.size(); ++t) {
    fresh_steps += fresh[t].iterations;
    steps += incremental.summaries()[t].iterations;
  }
  EXPECT_LT(steps, fresh_steps / 2);
}

TEST(IncrementalSupportTest, AFailedChangeChangesNothing) {
  core::Random random(84);
  IncrementalSupport incremental({Walk(random, 4), Walk(random, 4)}, {});
  const std::vector<double> x = {1.0, 0.0};
  const double before = incremental.support().Decision(1, x);
  const auto message = [](const std::function<void()>& call) -> std::string {
    try {
      call();
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  core::Matrix broken = Walk(random, 4);
  broken(2, 0) = std::nan("");
  EXPECT_THAT(message([&] { incremental.Add(broken); }), HasSubstr("demonstration 2, state 2"));
  EXPECT_THAT(message([&] { incremental.Add(core::Matrix(0, 2)); }), HasSubstr("no states"));
  EXPECT_THAT(message([&] { incremental.Remove(0); }), HasSubstr("at least 2 demonstrations"));
  EXPECT_THAT(message([&] { incremental.Remove(7); }), HasSubstr("no demonstration 7 of 2"));
  EXPECT_EQ(incremental.num_demonstrations(), 2);
  EXPECT_EQ(incremental.support().Decision(1, x), before);
  EXPECT_THAT(message([&] {
                (void)IncrementalSupport({Walk(random, 4), Walk(random, 4)}, {.pooled = true});
              }),
              HasSubstr("pooled"));
}

}  // namespace
}  // namespace dfr::kernel
