#include "dfr/kernel/time_varying_support.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "dfr/kernel/model_selection.h"
#include "tests/kernel/support/walks.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::kernel {
namespace {

using dfr::test::Walks;
using testing::HasSubstr;

class TimeVaryingSupportFileTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    path_ = dfr::test::ProcessFolder() / (std::string("dfr_") + test->name());
  }
  void TearDown() override { std::filesystem::remove(path_); }
  std::filesystem::path path_;
};

TEST(TimeVaryingSupportTest, EachStepIsTheFitOfTheStatesAtThatStep) {
  const auto walks = Walks(40, 41);
  const auto support = TimeVaryingSupport::Fit(walks, {.svm = {.nu = 0.1, .gamma = 2.0}});
  EXPECT_EQ(support.num_steps(), 13);
  EXPECT_EQ(support.state_dim(), 2);
  for (const int t : {0, 5, 11}) {
    core::Matrix states(40, 2);
    for (Eigen::Index d = 0; d < 40; ++d) {
      const auto& walk = walks[static_cast<std::size_t>(d)];
      // Ended walks hold their last state.
      states.row(d) = walk.row(std::min<Eigen::Index>(t, walk.rows() - 1));
    }
    const auto expected = OneClassSvm::Fit(states, {.nu = 0.1, .gamma = 2.0});
    const std::vector<double> x = {t + 0.2, -0.1};
    std::vector<double> gradient(2), expected_gradient(2);
    EXPECT_EQ(support.Decision(t, x), expected.Decision(x));
    EXPECT_EQ(support.Gradient(t, x, gradient), expected.Gradient(x, expected_gradient));
    EXPECT_EQ(gradient, expected_gradient);
  }
}

TEST(TimeVaryingSupportTest, TimesOutOfRangeUseTheNearestEstimate) {
  const auto walks = Walks(20, 42);
  const auto few = TimeVaryingSupport::Fit(walks, {.num_steps = 6});
  EXPECT_EQ(few.num_steps(), 6);
  const std::vector<double> x = {5.1, 0.0};
  EXPECT_EQ(few.Decision(100, x), few.Decision(5, x));
  EXPECT_EQ(few.Decision(-3, x), few.Decision(0, x));
  // Time steps beyond the demonstrations use their last states.
  const auto many = TimeVaryingSupport::Fit(walks, {.num_steps = 30});
  const std::vector<double> end = {9.0, 0.0};
  EXPECT_EQ(many.num_steps(), 30);
  EXPECT_EQ(many.Decision(29, end), many.Decision(12, end));
}

TEST(TimeVaryingSupportTest, TheResultDoesNotDependOnTheThreadCount) {
  const auto walks = Walks(60, 44);
  std::vector<FitSummary> one_summaries, many_summaries;
  const auto one = TimeVaryingSupport::Fit(walks, {.threads = 1}, &one_summaries);
  const auto many = TimeVaryingSupport::Fit(walks, {.threads = 5}, &many_summaries);
  ASSERT_EQ(one_summaries.size(), many_summaries.size());
  for (int t = 0; t < one.num_steps(); ++t) {
    EXPECT_EQ(one.at(t).alpha(), many.at(t).alpha());
    EXPECT_EQ(one.at(t).rho(), many.at(t).rho());
    EXPECT_EQ(one_summaries[static_cast<std::size_t>(t)].iterations,
              many_summaries[static_cast<std::size_t>(t)].iterations);
  }
}

// Checks that calls do not overlap, share their state and end with the first false.
TEST(TimeVaryingSupportTest, OneThreadAtATimeReportsProgress) {
  const auto demonstrations = dfr::test::Walks(60, 1, 0.3);
  struct Count {
    int own = 0;
    std::atomic<int>* inside;
    bool* overlapped;
    int* most;
    int stop;
    bool operator()(const FitProgress&) {
      if ((*inside)++ != 0) *overlapped = true;
      for (int i = 0; i < 50; ++i) std::this_thread::yield();
      --*inside;
      *most = std::max(*most, ++own);
      return own != stop;
    }
  };
  for (const int stop : {-1, 5}) {
    std::atomic<int> inside = 0;
    bool overlapped = false;
    int most = 0;
    const auto count = [&] {
      inside = most = 0;
      return Count{0, &inside, &overlapped, &most, stop};
    };
    TimeVaryingSupportOptions options{.svm = {.nu = 0.3, .tolerance = 1e-9}, .threads = 4};
    options.svm.progress = count();
    const auto support = TimeVaryingSupport::Fit(demonstrations, options);
    if (stop > 0) {
      EXPECT_EQ(most, stop);
    } else {
      EXPECT_GE(most, support.num_steps());
    }
    for (const bool pooled : {false, true}) {
      options.svm.progress = count();
      options.pooled = pooled;
      (void)SelectModel(demonstrations, {.gammas = {1.0, 5.0}, .support = options});
      if (stop > 0) {
        EXPECT_EQ(most, stop);
      } else {
        EXPECT_GE(most, 2 * 4);
      }
    }
    EXPECT_FALSE(overlapped);
  }
}

// Sec. IV-A: at each time step the supervisor is in one of two places, rarely in B_0 and often in
// B_1 over the whole trajectory. The smallest set with 1 - nu of the pooled states excludes B_0.
// The estimate of time step 0 includes B_0.
TEST(TimeVaryingSupportTest, PooledEstimateMissesRareEarlyStatesThatTheTimeVaryingOneHolds) {
  core::Random random(45);
  std::vector<core::Matrix> demonstrations;
  for (int d = 0; d < 60; ++d) {
    core::Matrix states(50, 1);
    states(0, 0) = -3.0 + 0.05 * random.Normal();                              // B_0, once
    for (int t = 1; t < 50; ++t) states(t, 0) = 3.0 + 0.05 * random.Normal();  // B_1, ever after
    demonstrations.push_back(states);
  }
  const TimeVaryingSupportOptions options{.svm = {.nu = 0.1, .gamma = 1.0}};
  TimeVaryingSupportOptions pooled_options = options;
  pooled_options.pooled = true;
  const auto varying = TimeVaryingSupport::Fit(demonstrations, options);
  const auto pooled = TimeVaryingSupport::Fit(demonstrations, pooled_options);
  EXPECT_EQ(pooled.num_steps(), 1);
  const double b0[] = {-3.0};
  const double b1[] = {3.0};
  EXPECT_LT(pooled.Decision(0, b0), 0.0);
  EXPECT_GT(pooled.Decision(0, b1), 0.0);
  EXPECT_GT(varying.Decision(0, b0), 0.0);
  EXPECT_LT(varying.Decision(0, b1), 0.0);
  EXPECT_GT(varying.Decision(1, b1), 0.0);
  EXPECT_LT(varying.Decision(1, b0), 0.0);
}

TEST(TimeVaryingSupportTest, DecisionNeverAllocates) {
  const auto support = TimeVaryingSupport::Fit(Walks(20, 46), {});
  const std::vector<double> x = {1.0, 0.0};
  const std::vector<double> broken = {1.0, std::numeric_limits<double>::quiet_NaN()};
  std::vector<double> gradient(2);
  const dfr::test::NoAlloc guard;
  EXPECT_TRUE(std::isfinite(support.Decision(1, x)));
  support.Gradient(1, x, gradient);
  EXPECT_EQ(support.Decision(1, broken), -std::numeric_limits<double>::infinity());
}

TEST(TimeVaryingSupportTest, ErrorsNameTheDemonstration) {
  auto walks = Walks(5, 47);
  const auto fit = [&](const TimeVaryingSupportOptions& options) {
    return dfr::test::MessageOf([&] { (void)TimeVaryingSupport::Fit(walks, options); });
  };
  EXPECT_THAT(fit({.num_steps = -1}), HasSubstr("num_steps"));
  EXPECT_THAT(fit({.threads = -1}), HasSubstr("threads"));
  EXPECT_THAT(fit({.svm = {.nu = 2.0}, .threads = 3}), HasSubstr("nu must lie in (0, 1]"));
  walks[3](2, 1) = std::nan("");
  EXPECT_THAT(fit({}), HasSubstr("demonstration 3, state 2"));
  walks[3] = core::Matrix::Zero(4, 3);
  EXPECT_THAT(fit({}),
              HasSubstr("demonstration 3 has states of 3 entries, but demonstration 0 has 2"));
  walks[3] = core::Matrix(0, 2);
  EXPECT_THAT(fit({}), HasSubstr("demonstration 3 has no states"));
  walks.resize(1);
  EXPECT_THAT(fit({}), HasSubstr("at least 2 demonstrations"));
  walks.clear();
  EXPECT_THAT(fit({}), HasSubstr("no demonstrations"));
}

TEST_F(TimeVaryingSupportFileTest, LoadRestoresEveryBit) {
  const auto saved = TimeVaryingSupport::Fit(Walks(30, 48), {.svm = {.gamma = 1.3}});
  saved.Save(path_);
  const auto loaded = TimeVaryingSupport::Load(path_);
  ASSERT_EQ(loaded.num_steps(), saved.num_steps());
  for (int t = 0; t < saved.num_steps(); ++t) {
    EXPECT_EQ(loaded.at(t).support_vectors(), saved.at(t).support_vectors());
    EXPECT_EQ(loaded.at(t).alpha(), saved.at(t).alpha());
    EXPECT_EQ(loaded.at(t).libsvm_scale(), saved.at(t).libsvm_scale());
    const std::vector<double> x = {t + 0.3, 0.1};
    EXPECT_EQ(loaded.Decision(t, x), saved.Decision(t, x));
  }
}

TEST_F(TimeVaryingSupportFileTest, ADamagedFileIsRefusedByName) {
  TimeVaryingSupport::Fit(Walks(10, 49), {}).Save(path_);
  const auto load = [&] {
    return dfr::test::MessageOf([&] { (void)TimeVaryingSupport::Load(path_); });
  };
  for (const double rho : {0.0, -0.1, std::nan("")}) {
    core::ArchiveWriter archive("time-varying-support", 1);
    archive.Integer(1);
    archive.Number(1.0);
    archive.Number(rho);
    archive.Number(1.0);
    archive.Numbers(std::vector{1.0});
    archive.MatrixBlock(core::Matrix::Zero(1, 2));
    const auto damaged = path_.string() + ".rho";
    archive.Save(damaged);
    EXPECT_THAT(dfr::test::MessageOf([&] { (void)TimeVaryingSupport::Load(damaged); }),
                HasSubstr("rho must be positive"));
    std::filesystem::remove(damaged);
  }
  std::filesystem::resize_file(path_, std::filesystem::file_size(path_) - 9);
  EXPECT_THAT(load(), HasSubstr(path_.string()));
  std::filesystem::remove(path_);
  EXPECT_THAT(load(), HasSubstr(path_.string()));
}

}  // namespace
}  // namespace dfr::kernel
