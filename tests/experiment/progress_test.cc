#include "dfr/experiment/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <vector>

namespace dfr::experiment {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST(ProgressMeterTest, CountsFromManyThreadsAndEndsWithTheWhole) {
  int calls = 0;
  Progress last;
  ProgressMeter meter(
      4000,
      [&](const Progress& progress) {
        EXPECT_GT(progress.done, last.done);
        last = progress;
        ++calls;
      },
      /*already_done=*/1000, /*interval_s=*/0.0);
  {
    std::array<std::jthread, 3> threads;
    for (std::jthread& thread : threads) {
      thread = std::jthread([&] {
        for (int k = 0; k < 1000; ++k) meter.Advance(1, "label");
      });
    }
  }
  EXPECT_EQ(calls, 3000);
  EXPECT_EQ(last.done, 4000);
  EXPECT_EQ(last.remaining_s.value(), 0.0);
  EXPECT_EQ(last.label, "label");
}

TEST(ProgressMeterTest, CallsAtMostOncePerIntervalAndAtTheEnd) {
  double now_s = 1000.0;
  std::vector<std::int64_t> done;
  ProgressMeter meter(
      10, [&](const Progress& progress) { done.push_back(progress.done); }, 0,
      /*interval_s=*/1.0, [&] { return now_s; });
  for (int i = 0; i < 10; ++i, now_s += 0.375) meter.Advance();
  EXPECT_THAT(done, testing::ElementsAre(1, 4, 7, 10));
}

TEST(ProgressMeterTest, ResumedUnitsDoNotCountForTheRemainingTime) {
  Progress last;
  double now_s = 1000.0;
  ProgressMeter meter(
      100, [&](const Progress& progress) { last = progress; }, /*already_done=*/97, 0.0,
      [&] { return now_s; });
  now_s += 16.0;
  meter.Advance();
  EXPECT_EQ(last.elapsed_s, 16.0);
  EXPECT_EQ(last.remaining_s, 32.0) << "one done, two to go";
}

TEST(ProgressMeterTest, AcceptsAnEmptyCallbackAndRefusesMoreDoneThanTheTotal) {
  ProgressMeter meter(1, {});
  meter.Advance();
  EXPECT_THROW(ProgressMeter(1, {}, 2), std::invalid_argument);
}

TEST(ProgressBarTest, DrawsABarOnATerminal) {
  std::ostringstream out;
  ProgressBar bar("fit", out, /*is_terminal=*/true);
  bar.Show({50, 100, 7.0, 187.0, "trial 1"});
  EXPECT_EQ(out.str().front(), '\r');
  EXPECT_THAT(out.str(), HasSubstr("50 %  50/100  3:07 min left  trial 1"));
  EXPECT_THAT(out.str(), Not(HasSubstr("\n")));
  bar.Show({100, 100, 9.0, 0.0, "trial 1"});
  EXPECT_THAT(out.str(), HasSubstr("100 %  100/100  done in 9 s"));
  EXPECT_EQ(out.str().back(), '\n');
}

TEST(ProgressBarTest, EndsAnUnfinishedLine) {
  std::ostringstream out;
  { ProgressBar("fit", out, true).Show({1, 2, 0.0, {}, ""}); }
  EXPECT_EQ(out.str().back(), '\n');
}

TEST(ProgressBarTest, PrintsPlainLinesAtIntervalsElsewhere) {
  std::ostringstream out;
  ProgressBar bar("fit", out, /*is_terminal=*/false, /*line_interval_s=*/10.0);
  bar.Show({1, 100, 1.0, {}, ""});
  bar.Show({2, 100, 10.9, 500.0, ""});
  bar.Show({3, 100, 11.0, 500.0, ""});
  bar.Show({100, 100, 12.0, 0.0, ""});
  EXPECT_EQ(out.str(),
            "fit   1 %  1/100\n"
            "fit   3 %  3/100  8:20 min left\n"
            "fit 100 %  100/100  done in 12 s\n");
}

TEST(FormatDurationTest, TakesTheUnitThatFits) {
  EXPECT_EQ(FormatDuration(7.4), "7 s");
  EXPECT_EQ(FormatDuration(59.6), "1:00 min");
  EXPECT_EQ(FormatDuration(187.0), "3:07 min");
  EXPECT_EQ(FormatDuration(7387.0), "2:03:07 h");
  EXPECT_EQ(FormatDuration(-1.0), "?");
}

}  // namespace
}  // namespace dfr::experiment
