// Kills runs at each write, with part of a line written.
#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
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

using test::EmptyFolder;
using test::FakePlan;
using test::MakeFakeTrialRunner;

TEST(LedgerKillTest, EveryWrittenUnitIsKeptAndNoneRunsTwice) {
  const auto whole = Evaluate(FakePlan(), MakeFakeTrialRunner);
  const std::filesystem::path ledger = EmptyFolder("ledger_kill") / "ledger.jsonl";
  const EvaluationOptions options = {.threads = 1, .ledger = ledger};
  for (int writes = 0; writes <= 20; ++writes) {  // the writes of the header and of 20 units
    SCOPED_TRACE(testing::Message() << "killed at write " << writes);
    std::filesystem::remove(ledger);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      writes_left = writes;
      (void)Evaluate(FakePlan(), MakeFakeTrialRunner, options);
      _exit(0);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));
    int made = 0;
    const auto counts = [&](const EvaluationUnit& unit) {
      ++made;
      return MakeFakeTrialRunner(unit);
    };
    ASSERT_EQ(Evaluate(FakePlan(), counts, options), whole);
    EXPECT_EQ(made, 20 - std::max(0, writes - 1));
    EXPECT_EQ(ReadLedger(ledger).records.size(), 20U);
  }
}

}  // namespace
}  // namespace dfr::experiment
