// Kills runs at each write, with part of a line written.
#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <filesystem>

#include "dfr/experiment/ledger.h"
#include "tests/experiment/fake_trial_runner.h"

namespace {

// Number of writes until the process kills itself. -1: unlimited.
int writes_left = -1;  // NOLINT(cppcoreguidelines-avoid-non-const-global-variables)

}  // namespace

// Replaces the C library's function in this program.
extern "C" ssize_t write(int file, const void* bytes, size_t size) {
  if (writes_left == 0) {
    syscall(SYS_write, file, bytes, size / 2);
    raise(SIGKILL);
  }
  if (writes_left > 0) --writes_left;
  return syscall(SYS_write, file, bytes, size);
}

namespace dfr::experiment {
namespace {

using test::MakeFakeTrialRunner;

TEST(LedgerKillTest, EveryWrittenUnitIsKeptAndNoneRunsTwice) {
  EvaluationPlan plan = test::FakePlan();
  plan.trials = 1;
  const auto whole = Evaluate(plan, MakeFakeTrialRunner);
  const int units = static_cast<int>(whole.size());
  const std::filesystem::path ledger = test::EmptyFolder("ledger_kill") / "ledger.jsonl";
  for (const int threads : {1, 2}) {
    const EvaluationOptions options = {.threads = threads, .ledger = ledger};
    for (int writes = 0; writes <= units; ++writes) {  // the writes of the header and of all units
      SCOPED_TRACE(testing::Message() << threads << " threads, killed at write " << writes);
      std::filesystem::remove(ledger);
      const pid_t child = fork();
      ASSERT_GE(child, 0);
      if (child == 0) {
        writes_left = writes;
        (void)Evaluate(plan, MakeFakeTrialRunner, options);
        _exit(0);
      }
      int status = 0;
      ASSERT_EQ(waitpid(child, &status, 0), child);
      ASSERT_TRUE(WIFSIGNALED(status));
      std::atomic<int> made = 0;
      const auto counts = [&](const EvaluationUnit& unit) {
        ++made;
        return MakeFakeTrialRunner(unit);
      };
      ASSERT_EQ(Evaluate(plan, counts, options), whole);
      EXPECT_EQ(made, units - std::max(0, writes - 1));
      EXPECT_EQ(ReadLedger(ledger).records.size(), whole.size());
    }
  }
}

}  // namespace
}  // namespace dfr::experiment
