// Kills runs of two threads at random moments.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <string>
#include <thread>

#include "dfr/core/random.h"
#include "dfr/experiment/ledger.h"
#include "tests/experiment/fake_trial_runner.h"

namespace dfr::experiment {
namespace {

using test::EmptyFolder;
using test::FakePlan;
using test::MakeFakeTrialRunner;
using test::Read;

// DFR_KILLS: number of kills. The ledger keeps every unit that a killed process wrote, and no unit
// runs twice.
TEST(KilledLedgerTest, KilledProcessesLoseAndRepeatNothing) {
  const char* const wanted = std::getenv("DFR_KILLS");
  const int kills = wanted != nullptr ? std::atoi(wanted) : 30;
  const std::filesystem::path ledger = EmptyFolder("killed_ledger") / "ledger.jsonl";
  const EvaluationOptions one_thread = {.threads = 1, .ledger = ledger};
  const auto whole = Evaluate(FakePlan(), MakeFakeTrialRunner);
  core::Random random(1);
  int finished = 0;
  for (int k = 0; k < kills; ++k) {
    const std::string before = Read(ledger);
    const pid_t child = fork();
    if (child == 0) {
      const auto slowly = [](const EvaluationUnit& unit) {
        std::this_thread::sleep_for(std::chrono::microseconds(300));
        return MakeFakeTrialRunner(unit);
      };
      EvaluationOptions options = one_thread;
      options.threads = 2;
      (void)Evaluate(FakePlan(), slowly, options);
      _exit(0);
    }
    std::this_thread::sleep_for(std::chrono::microseconds(random.Below(40'000)));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    const std::string after = Read(ledger);
    const std::size_t whole_lines =
        before.rfind('\n') == std::string::npos ? 0 : before.rfind('\n') + 1;
    ASSERT_TRUE(after.starts_with(before.substr(0, whole_lines))) << "kill " << k;
    if (WIFEXITED(status)) {
      ++finished;
      EXPECT_EQ(ReadLedger(ledger).records.size(), 20u);
      EXPECT_EQ(std::ranges::count(after, '\n'), 21) << "a unit was repeated";
      std::filesystem::remove(ledger);
    }
  }
  int made = 0;
  const auto lines = std::ranges::count(Read(ledger), '\n');
  const auto counts = [&](const EvaluationUnit& unit) {
    ++made;
    return MakeFakeTrialRunner(unit);
  };
  EXPECT_EQ(Evaluate(FakePlan(), counts, one_thread), whole);
  EXPECT_EQ(made, 20 - std::max<std::ptrdiff_t>(0, lines - 1));
  std::cout << kills << " kills, " << finished << " runs finished" << std::endl;
}

}  // namespace
}  // namespace dfr::experiment
