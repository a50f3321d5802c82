#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/experiment/experiment.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/status.h"
#include "ledger/ledger_file.h"
#include "ledger/ledger_line.h"
#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"

namespace dfr::experiment {
namespace {

using test::EmptyFolder;
using test::FakePlan;
using test::MakeFakeTrialRunner;
using testing::AllOf;
using testing::HasSubstr;

void WriteText(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

class LedgerReaderTest : public testing::Test {
 protected:
  std::filesystem::path folder =
      EmptyFolder(std::string("ledger_reader_") +
                  testing::UnitTest::GetInstance()->current_test_info()->name());
  std::filesystem::path ledger = folder / "ledger.jsonl";
};

// A build outside a git repository cannot detect that the code has changed since the run began.
TEST_F(LedgerReaderTest, ABuildOfUnknownCommitIsReportedWhenItResumes) {
  const EvaluationPlan plan = FakePlan();
  (void)Evaluate(plan, MakeFakeTrialRunner, {.threads = 1, .ledger = ledger});
  const LedgerContents contents = ReadLedger(ledger);
  for (const char* commit : {"unknown", "0123abc"}) {
    const std::filesystem::path path = folder / commit;
    const LedgerHeader header{plan, {}, commit, {}};
    std::vector<std::string> notices;
    EvaluationOptions options;
    options.notice = [&](const std::string& text) { notices.push_back(text); };
    internal::LedgerWriter(path, header, options).Append(contents.records[0]);
    EXPECT_TRUE(notices.empty()) << notices[0];
    EXPECT_EQ(internal::LedgerWriter(path, header, options).finished().size(), 1U);
    if (std::string(commit) == "unknown") {
      EXPECT_THAT(notices, testing::ElementsAre(AllOf(HasSubstr(path.string() + ": "),
                                                      HasSubstr("knows its commit"),
                                                      HasSubstr("start over with --restart"))));
    } else {
      EXPECT_TRUE(notices.empty()) << notices[0];
    }
  }
}

// A runner whose real numbers are scaled, as by the rounding of another instruction set.
class ScaledRunner final : public TrialRunner {
 public:
  ScaledRunner(const EvaluationUnit& unit, double factor) : fake_(unit), factor_(factor) {}
  bool Accepts(std::uint64_t start_seed) override { return fake_.Accepts(start_seed); }
  EpisodeResult Run(int method, std::uint64_t start_seed, std::uint64_t controller_seed) override {
    EpisodeResult result = fake_.Run(method, start_seed, controller_seed);
    result.changed_controls = result.sized_changes = result.recovery_controls;
    result.change = 0.137 * result.sized_changes * factor_;
    return result;
  }
  std::map<std::string, double> Measures() override {
    return {{"overlap", fake_.Measures().at("overlap") * factor_}};
  }

 private:
  test::FakeTrialRunner fake_;
  double factor_;
};

MakeTrialRunner Scaled(double factor) {
  return
      [factor](const EvaluationUnit& unit) { return std::make_unique<ScaledRunner>(unit, factor); };
}

TEST_F(LedgerReaderTest, RoundingOfAnotherInstructionSetIsNoOtherResult) {
  (void)Evaluate(FakePlan(), Scaled(1.0), {.threads = 1, .ledger = ledger});
  const auto merge_with = [&](double factor) {
    const std::filesystem::path other = folder / "other.jsonl";
    std::filesystem::remove(other);
    (void)Evaluate(FakePlan(), Scaled(factor), {.threads = 1, .ledger = other});
    return test::MessageOf([&] { MergeLedgers({ledger, other}, folder / "whole.jsonl"); });
  };
  EXPECT_EQ(merge_with(1.0 + 1e-15), "nothing thrown");
  const std::string instructions = ReadLedger(ledger).records.at(0).instructions;
  EXPECT_NE(instructions, "");
  EXPECT_THAT(merge_with(1.0 + 1e-6),
              AllOf(HasSubstr("has results of trial 0"),
                    HasSubstr("(" + instructions + " here, " + instructions + " there)")));
  const auto rerun_with = [&](double factor) {
    ExperimentOptions options;
    options.out = folder;
    options.rerun.episode = "1/60/8/dfr/3";
    return test::MessageOf(
        [&] { (void)RunExperiment("fake", FakePlan(), Scaled(factor), {}, options); });
  };
  EXPECT_EQ(rerun_with(1.0 + 1e-15), "nothing thrown");
  EXPECT_THAT(rerun_with(1.0 + 1e-6), HasSubstr("something other than the settings"));
}

TEST_F(LedgerReaderTest, TheRemainingTimeIgnoresPausesBetweenRuns) {
  (void)Evaluate(FakePlan(), MakeFakeTrialRunner, {.threads = 1, .ledger = ledger});
  LedgerContents contents = ReadLedger(ledger);
  contents.records.resize(4);  // of 20 units
  const auto remaining = [&](double wall_s, const std::vector<std::int64_t>& finished) {
    std::string text = internal::HeaderLine(contents.header);
    for (std::size_t i = 0; i < finished.size(); ++i) {
      contents.records[i].wall_s = wall_s;
      contents.records[i].finished = 1'000'000'000 + finished[i];
      text += internal::UnitLine(contents.records[i], internal::IdentityHash(contents.header));
    }
    WriteText(ledger, text);
    const internal::Descriptor running = internal::OpenLocked(ledger);
    return StatusesOf({folder}).front().remaining_s.value_or(-1.0);
  };
  EXPECT_NEAR(remaining(3600.0, {0, 3600, 58'000, 61'600}), 16 * 3600.0, 1e-3);
  EXPECT_NEAR(remaining(3600.0, {0, 0, 1800, 61'600}), 16 * 2250.0, 1e-3) << "two threads";
  // `finished` is in whole seconds.
  EXPECT_NEAR(remaining(0.001, {0, 1, 2, 3}), 4 * 3.001, 1e-3);
}

TEST_F(LedgerReaderTest, AnyDamageOfTheFirstLineIsNamedAndSalvaged) {
  EvaluationPlan plan = FakePlan();
  plan.trials = 1;
  plan.learners = {"8"};
  plan.demonstrations = {6};
  (void)Evaluate(plan, MakeFakeTrialRunner, {.threads = 1, .ledger = ledger});
  const std::string text = test::Read(ledger);
  const std::size_t version = text.find("\"version\":") + 10;
  const auto unused = [](const EvaluationUnit&) -> std::unique_ptr<TrialRunner> {
    throw std::logic_error("a unit runs again");
  };
  for (std::size_t i = 0; i < text.find('\n'); ++i) {
    if (i == version) continue;  // a different digit is another version
    std::string damaged = text;
    damaged[i] = static_cast<char>(damaged[i] ^ (1 << (i % 8)));
    if (damaged[i] == '\n') continue;
    WriteText(ledger, damaged);
    EXPECT_THAT(test::MessageOf([&] { (void)ReadLedger(ledger); }),
                AllOf(HasSubstr("line 1 is damaged"), HasSubstr("--salvage")))
        << i;
    EXPECT_EQ(test::MessageOf([&] {
                (void)Evaluate(plan, unused, {.threads = 1, .ledger = ledger, .salvage = true});
              }),
              "nothing thrown")
        << i;
    ASSERT_EQ(test::Read(ledger), text) << i;
  }
}

// Accepts every 10 001st start state.
class RarelyAcceptingRunner final : public TrialRunner {
 public:
  explicit RarelyAcceptingRunner(const EvaluationUnit& unit) : fake_(unit) {}
  bool Accepts(std::uint64_t /*start_seed*/) override { return ++calls_ % 10'001 == 0; }
  EpisodeResult Run(int method, std::uint64_t start_seed, std::uint64_t controller_seed) override {
    return fake_.Run(method, start_seed, controller_seed);
  }

 private:
  test::FakeTrialRunner fake_;
  int calls_ = 0;
};

TEST_F(LedgerReaderTest, ALedgerWithMoreRedrawsThanTheDefaultIsRead) {
  EvaluationPlan plan = FakePlan();
  plan.trials = 1;
  plan.learners = {"8"};
  plan.demonstrations = {6};
  plan.episodes = 2;
  plan.max_redraws = 20'000;
  const auto make = [](const EvaluationUnit& unit) {
    return std::make_unique<RarelyAcceptingRunner>(unit);
  };
  (void)Evaluate(plan, make, {.threads = 1, .ledger = ledger});
  const LedgerContents contents = ReadLedger(ledger);
  EXPECT_EQ(contents.header.plan.max_redraws, 20'000);
  ASSERT_EQ(contents.records.size(), 1u);
  EXPECT_EQ(contents.records.front().result.redrawn, 20'000);
  MergeLedgers({ledger}, folder / "whole.jsonl");
  EXPECT_EQ(ReadLedger(folder / "whole.jsonl").records.size(), 1u);
  plan.max_redraws = EvaluationPlan().max_redraws;
  EXPECT_THAT(
      test::MessageOf([&] { (void)Evaluate(plan, make, {.threads = 1, .ledger = ledger}); }),
      HasSubstr("max_redraws is 20000 there"));
}

TEST_F(LedgerReaderTest, AMergeNamesTheLedgerThatItComparedWith) {
  const std::filesystem::path empty = folder / "empty.jsonl";
  WriteText(empty, "");
  (void)Evaluate(FakePlan(), MakeFakeTrialRunner, {.threads = 1, .ledger = ledger});
  EvaluationPlan seeded = FakePlan();
  seeded.seed = 4;
  const std::filesystem::path other = folder / "other.jsonl";
  (void)Evaluate(seeded, MakeFakeTrialRunner, {.threads = 1, .ledger = other});
  EXPECT_THAT(test::MessageOf([&] {
                MergeLedgers({empty, ledger, other}, folder / "whole.jsonl");
              }),
              HasSubstr(other.string() + ": does not belong to " + ledger.string() + ":"));
}

}  // namespace
}  // namespace dfr::experiment
