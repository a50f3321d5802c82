#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "dfr/guard.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::safety {
namespace {

using testing::HasSubstr;

class CGuardTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(2, 6, 4),
                    {.features = "tip"})
        ->Save(file_);
  }
  static void TearDownTestSuite() { std::filesystem::remove(file_); }
  void SetUp() override {
    guard_ = dfr_guard_load(file_.c_str());
    ASSERT_NE(guard_, nullptr) << dfr_guard_last_error();
    state_.assign(static_cast<std::size_t>(dfr_guard_state_dim(guard_)), 0.0);
    action_.assign(static_cast<std::size_t>(dfr_guard_action_dim(guard_)), 0.05);
    safe_.assign(action_.size(), 7.0);
    verdict_.size = sizeof(verdict_);
  }
  void TearDown() override { dfr_guard_free(guard_); }

  int Filter(int t) {
    return dfr_guard_filter(guard_, t, state_.data(), state_.size(), action_.data(), action_.size(),
                            safe_.data(), &verdict_);
  }

  inline static const std::string file_ = dfr::test::ProcessFolder() / "c_guard_test.guard";
  dfr_guard* guard_ = nullptr;
  std::vector<double> state_;
  std::vector<double> action_;
  std::vector<double> safe_;
  dfr_guard_verdict verdict_{};
};

TEST_F(CGuardTest, DecidesAsTheCppGuardDoesAndAllocatesNothing) {
  Guard peer = Guard::Load(file_);
  EXPECT_EQ(dfr_guard_num_steps(guard_), peer.model().num_steps());
  dfr_guard_reset(guard_, 5);
  peer.Reset(5);
  std::vector<double> expected(action_.size());
  for (int t = 0; t < 30; ++t) {
    const Verdict verdict = peer.Filter(t, state_, action_, expected);
    int mode = DFR_GUARD_HALT;
    {
      const test::NoAlloc no_alloc;
      mode = Filter(t);
    }
    EXPECT_EQ(mode, static_cast<int>(verdict.mode));
    EXPECT_EQ(safe_, expected);
    EXPECT_EQ(verdict_.mode, static_cast<int>(verdict.mode));
    EXPECT_EQ(verdict_.changed != 0, verdict.changed);
    EXPECT_EQ(verdict_.alarm != 0, verdict.alarm);
    EXPECT_EQ(verdict_.step, verdict.step);
    EXPECT_EQ(verdict_.alarm_step, verdict.alarm_step);
    EXPECT_EQ(std::bit_cast<std::uint64_t>(verdict_.g), std::bit_cast<std::uint64_t>(verdict.g));
    EXPECT_STREQ(verdict_.reason, verdict.reason());
    for (std::size_t k = 0; k < state_.size(); ++k) state_[k] += 0.03 * (k % 2 == 0 ? 1.0 : -0.5);
  }
}

TEST_F(CGuardTest, EveryInvalidCallHaltsWithZero) {
  const auto expect_halt = [this](const char* reason, int t, const double* state,
                                  std::size_t state_size, const double* action) {
    safe_.assign(safe_.size(), 7.0);
    EXPECT_EQ(dfr_guard_filter(guard_, t, state, state_size, action, action_.size(), safe_.data(),
                               &verdict_),
              DFR_GUARD_HALT);
    EXPECT_EQ(verdict_.mode, DFR_GUARD_HALT);
    EXPECT_STREQ(verdict_.reason, reason);
    EXPECT_THAT(safe_, testing::Each(0.0));
    EXPECT_EQ(Filter(1), DFR_GUARD_HALT) << "until the next reset";
    dfr_guard_reset(guard_, 0);
  };
  const std::size_t size = state_.size();
  expect_halt("not-reset", 0, state_.data(), size, action_.data());
  EXPECT_NE(Filter(0), DFR_GUARD_HALT);
  expect_halt("step-skipped", 5, state_.data(), size, action_.data());
  expect_halt("state-invalid", 0, nullptr, size, action_.data());
  expect_halt("state-invalid", 0, state_.data(), size - 1, action_.data());
  expect_halt("control-invalid", 0, state_.data(), size, nullptr);
  dfr_guard_stop(guard_);
  expect_halt("stop-requested", 0, state_.data(), size, action_.data());
  // For an action of the wrong size, only that number of entries is written.
  safe_.assign(safe_.size(), 7.0);
  EXPECT_EQ(
      dfr_guard_filter(guard_, 0, state_.data(), size, action_.data(), 1, safe_.data(), &verdict_),
      DFR_GUARD_HALT);
  EXPECT_EQ(safe_[0], 0.0);
  EXPECT_EQ(safe_.back(), 7.0);
  EXPECT_TRUE(std::isnan(verdict_.g) && std::isnan(verdict_.threshold)) << "nothing was judged";
  EXPECT_EQ(verdict_.changed, 1);
  EXPECT_EQ(Filter(0), DFR_GUARD_HALT);
  EXPECT_EQ(dfr_guard_filter(nullptr, 0, nullptr, 0, nullptr, 0, nullptr, nullptr), DFR_GUARD_HALT);
}

TEST_F(CGuardTest, WritesNoMoreOfAVerdictThanItsSize) {
  dfr_guard_reset(guard_, 0);
  std::memset(&verdict_, 0x5a, sizeof(verdict_));
  verdict_.size = offsetof(dfr_guard_verdict, alarm);
  const int mode = Filter(0);
  EXPECT_EQ(verdict_.mode, mode);
  EXPECT_EQ(verdict_.alarm, 0x5a5a5a5a);
  EXPECT_EQ(verdict_.size, offsetof(dfr_guard_verdict, alarm));
}

TEST_F(CGuardTest, DecisionEvaluatesEachState) {
  const Guard peer = Guard::Load(file_);
  const auto dim = state_.size();
  std::vector<double> states(3 * dim, 0.1);
  std::fill_n(states.begin() + static_cast<std::ptrdiff_t>(2 * dim), dim,
              std::numeric_limits<double>::quiet_NaN());
  const std::int32_t t[] = {0, 4, 2};
  double g[3];
  ASSERT_EQ(dfr_guard_decision(guard_, 3, t, states.data(), g), 0);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(g[i], peer.model().support().Decision(t[i], {states.data() + i * dim, dim}));
  }
  EXPECT_EQ(g[2], -std::numeric_limits<double>::infinity());
  EXPECT_EQ(dfr_guard_decision(guard_, 3, t, nullptr, g), -1);
  EXPECT_THAT(dfr_guard_last_error(), HasSubstr("states is NULL"));
  const std::int32_t negative[] = {0, 4, -1};
  EXPECT_EQ(dfr_guard_decision(guard_, 3, negative, states.data(), g), -1);
  EXPECT_THAT(dfr_guard_last_error(), HasSubstr("t[2] is negative"));
}

// The first error of a thread must not need memory either.
TEST_F(CGuardTest, ErrorsOfArgumentsAllocateNothing) {
  std::size_t allocations = 1;
  std::string error;
  std::thread([&] {
    const std::int32_t negative = -1;
    double g = 0.0;
    {
      const test::NoAlloc no_alloc;
      dfr_guard_decision(nullptr, 1, nullptr, nullptr, nullptr);
      dfr_guard_decision(guard_, 1, &negative, state_.data(), &g);
      static_cast<void>(dfr_guard_load(nullptr));
      allocations = no_alloc.count();
    }
    error = dfr_guard_last_error();
  }).join();
  EXPECT_EQ(allocations, 0U);
  EXPECT_EQ(error, "dfr_guard_load: path is NULL");
  const std::string longest(5000, 'x');
  EXPECT_EQ(dfr_guard_load(longest.c_str()), nullptr);
  EXPECT_EQ(std::string(dfr_guard_last_error()), longest.substr(0, 1023));
}

TEST(CGuardErrorsTest, NameTheFileOrTheArgument) {
  EXPECT_EQ(dfr_guard_load("absent.guard"), nullptr);
  EXPECT_THAT(dfr_guard_last_error(), HasSubstr("absent.guard"));
  EXPECT_EQ(dfr_guard_load(nullptr), nullptr);
  EXPECT_THAT(dfr_guard_last_error(), HasSubstr("path is NULL"));
  EXPECT_STREQ(dfr_guard_version(), DFR_VERSION);
  EXPECT_EQ(dfr_guard_state_dim(nullptr), 0);
  dfr_guard_free(nullptr);
}

}  // namespace
}  // namespace dfr::safety
