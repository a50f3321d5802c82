#include "dfr/experiment/ledger.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/experiment/episodes.h"
#include "dfr/experiment/status.h"
#include "ledger/ledger_line.h"
#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"

namespace {

// Faults of the next calls of write() and fdatasync(), as on a failing disk: an error, or a short
// write. The functions below replace the C library's in this program.
struct Fault {
  int after = -1;  // calls that still succeed; negative: all
  int error = 0;   // 0: short writes from then on
};
thread_local Fault fault;

bool Fails() {
  if (fault.after < 0) return false;
  return fault.after-- == 0;
}

}  // namespace

extern "C" ssize_t write(int file, const void* bytes, size_t size) {
  if (Fails()) {
    if (fault.error != 0) {
      errno = fault.error;
      return -1;
    }
    fault.after = 0;
    size = std::min<size_t>(size, 7);
  }
  return syscall(SYS_write, file, bytes, size);
}

extern "C" int fdatasync(int file) {
  if (fault.error != 0 && Fails()) {
    errno = fault.error;
    return -1;
  }
  return static_cast<int>(syscall(SYS_fdatasync, file));
}

namespace dfr::experiment {
namespace {

using test::EmptyFolder;
using test::FakePlan;
using test::MakeFakeTrialRunner;
using test::Read;
using testing::AllOf;
using testing::HasSubstr;

void Write(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

class LedgerTest : public testing::Test {
 protected:
  EvaluationOptions Options() const {
    return {.threads = 1, .ledger = ledger, .settings = {{"nu", "0.05"}, {"gamma", "5"}}};
  }
  std::filesystem::path ledger =
      EmptyFolder(std::string("ledger_") +
                  testing::UnitTest::GetInstance()->current_test_info()->name()) /
      "ledger.jsonl";
};

TEST_F(LedgerTest, AResumedRunEqualsAnUninterruptedOne) {
  const auto whole = Evaluate(FakePlan(), MakeFakeTrialRunner);
  int made = 0;
  const auto dies = [&](const EvaluationUnit& unit) {
    if (made == 8) throw std::runtime_error("killed");
    ++made;
    return MakeFakeTrialRunner(unit);
  };
  EXPECT_THROW((void)Evaluate(FakePlan(), dies, Options()), std::runtime_error);
  made = -100;
  std::int64_t first_done = -1;
  EvaluationOptions options = Options();
  options.progress = [&](const Progress& p) {
    first_done = first_done < 0 ? p.done : first_done;
    EXPECT_EQ(p.total, 20 * 24);
  };
  EXPECT_EQ(Evaluate(FakePlan(), dies, options), whole);
  EXPECT_EQ(made, -100 + 20 - 8) << "finished units are not run again";
  EXPECT_EQ(first_done, 8 * 24 + 1);
  made = -100;
  EXPECT_EQ(Evaluate(FakePlan(), dies, Options()), whole);
  EXPECT_EQ(made, -100);
}

TEST_F(LedgerTest, NamesInALedgerDoNotControlTheTerminal) {
  EvaluationPlan plan = FakePlan();
  plan.learners = {"8\x1b[2J"};
  EvaluationOptions options = Options();
  options.ledger = ledger.parent_path() / "run\x1b[2J" / "ledger.jsonl";
  std::filesystem::create_directory(options.ledger.parent_path());
  (void)Evaluate(plan, MakeFakeTrialRunner, options);
  std::ostringstream episodes;
  PrintEpisodes({options.ledger}, {}, 1, episodes);
  for (const std::string& text :
       {episodes.str(), ToText(StatusesOf({options.ledger.parent_path()}))}) {
    EXPECT_THAT(text, AllOf(HasSubstr("\\x1b[2J"), testing::Not(HasSubstr("\x1b"))));
  }
}

TEST_F(LedgerTest, AUnitWhoseLineIsIncompleteRunsAgain) {
  const auto whole = Evaluate(FakePlan(), MakeFakeTrialRunner, Options());
  const std::string text = Read(ledger);
  for (const std::size_t cut : {std::size_t{1}, std::size_t{100}, text.size() - 20}) {
    Write(ledger, text.substr(0, text.size() - cut));
    EXPECT_EQ(Evaluate(FakePlan(), MakeFakeTrialRunner, Options()), whole) << cut;
    EXPECT_EQ(std::ranges::count(Read(ledger), '\n'), std::ranges::count(text, '\n')) << cut;
  }
}

TEST_F(LedgerTest, OtherSettingsAreRefusedWithTheFirstDifference) {
  (void)Evaluate(FakePlan(), MakeFakeTrialRunner, Options());
  const std::string before = Read(ledger);
  EvaluationOptions options = Options();
  options.settings["gamma"] = "7";
  EXPECT_THAT(test::MessageOf([&] { (void)Evaluate(FakePlan(), MakeFakeTrialRunner, options); }),
              testing::AllOf(HasSubstr(ledger.string()),
                             HasSubstr("settings.gamma is \"5\" there and \"7\" now")));
  EvaluationPlan plan = FakePlan();
  plan.seed = 4;
  EXPECT_THAT(test::MessageOf([&] { (void)Evaluate(plan, MakeFakeTrialRunner, Options()); }),
              HasSubstr("seed is 3 there and 4 now"));
  EXPECT_EQ(Read(ledger), before);
}

TEST_F(LedgerTest, DamageAndForeignFilesAreRefused) {
  (void)Evaluate(FakePlan(), MakeFakeTrialRunner, Options());
  const std::string text = Read(ledger);
  const auto message = [&](const std::string& content) {
    Write(ledger, content);
    return test::MessageOf([&] { (void)Evaluate(FakePlan(), MakeFakeTrialRunner, Options()); });
  };
  const std::size_t second = text.find('\n') + 1;
  const std::size_t third = text.find('\n', second) + 1;
  EXPECT_THAT(message(text.substr(0, second) + "nonsense\n" + text.substr(second)),
              HasSubstr("line 2 is damaged"));
  std::string other = text;
  other.replace(other.find("\"outcomes\":\"") + 12, 1, "X");
  EXPECT_THAT(message(other), HasSubstr("line 2 is damaged: its checksum does not match"));
  for (const std::string& foreign :
       {std::string("shopping list\n"), std::string("{\"format\":3}\n"), std::string("3\n"),
        std::string(1'000'000, '[') + "\n"}) {
    EXPECT_THAT(message(foreign), HasSubstr("is not a ledger")) << foreign.substr(0, 20);
  }
  EXPECT_THAT(message("{\"format\":\"dfr paired evaluation\",\"version\":1}\n"),
              testing::AllOf(HasSubstr("format version 1, which an older dfr wrote"),
                             HasSubstr("--restart")));
  // A repeated unit with the same results is accepted.
  EXPECT_EQ(message(text + text.substr(second, third - second)), "nothing thrown");
}

// The first read of this file fails, as on a failing disk. A shorter ledger would lose results.
TEST_F(LedgerTest, AnUnreadableLedgerIsAnError) {
  EXPECT_THAT(test::MessageOf([] { (void)ReadLedger("/proc/self/mem"); }),
              HasSubstr("cannot be read to its end"));
}

TEST_F(LedgerTest, AFolderThatDoesNotExistIsNamed) {
  EvaluationOptions options = Options();
  options.ledger = ledger.parent_path() / "missing" / "ledger.jsonl";
  EXPECT_THAT(test::MessageOf([&] { (void)Evaluate(FakePlan(), MakeFakeTrialRunner, options); }),
              testing::AllOf(HasSubstr("missing"), HasSubstr("cannot be written")));
}

// Flips a bit of every third byte.
TEST_F(LedgerTest, NoFlippedBitPasses) {
  EvaluationPlan plan = FakePlan();
  plan.trials = 1;
  plan.episodes = 2;
  plan.demonstrations = {6};
  (void)Evaluate(plan, MakeFakeTrialRunner, Options());
  const std::string text = Read(ledger);
  ASSERT_LT(text.size(), 4000u);
  int accepted = 0;
  for (std::size_t i = 0; i < text.size(); i += 3) {
    std::string flipped = text;
    flipped[i] = static_cast<char>(flipped[i] ^ (1 << (i % 8)));
    Write(ledger, flipped);
    try {
      const LedgerContents contents = ReadLedger(ledger);
      // Without the last newline the last line is incomplete.
      accepted += contents.cut && i + 1 == text.size() ? 0 : 1;
    } catch (const std::runtime_error&) {
    }
  }
  EXPECT_EQ(accepted, 0) << "of " << text.size();
}

TEST_F(LedgerTest, AUnitOfAnotherRunIsRefused) {
  (void)Evaluate(FakePlan(), MakeFakeTrialRunner, Options());
  const std::string ours = Read(ledger);
  const auto with_line_of = [&](const EvaluationPlan& plan, const EvaluationOptions& options) {
    std::filesystem::remove(ledger);
    (void)Evaluate(plan, MakeFakeTrialRunner, options);
    const std::string theirs = Read(ledger);
    const std::size_t begin = ours.find('\n') + 1;
    const std::size_t end = ours.find('\n', begin);
    const std::size_t from = theirs.find('\n') + 1;
    Write(ledger, ours.substr(0, begin) + theirs.substr(from, theirs.find('\n', from) - from) +
                      ours.substr(end));
    return test::MessageOf([&] { (void)Evaluate(FakePlan(), MakeFakeTrialRunner, Options()); });
  };
  EvaluationPlan seeded = FakePlan();
  seeded.seed = 4;
  EXPECT_THAT(with_line_of(seeded, Options()), HasSubstr("it belongs to another run"));
  EvaluationOptions other = Options();
  other.settings["gamma"] = "5.0000001";
  EXPECT_THAT(with_line_of(FakePlan(), other), HasSubstr("it belongs to another run"));
  Write(ledger, ours);
  LedgerContents contents = ReadLedger(ledger);
  LedgerRecord& forged = contents.records.front();
  forged.result.starts.front() ^= 1;
  for (const int redrawn : {-1, 2'000'000'000}) {
    forged.result.redrawn = redrawn;
    Write(ledger, ours.substr(0, ours.find('\n') + 1) +
                      internal::UnitLine(forged, internal::IdentityHash(contents.header)));
    EXPECT_THAT(test::MessageOf([&] { (void)ReadLedger(ledger); }), HasSubstr("another seed"));
  }
}

TEST_F(LedgerTest, SalvageMovesDamagedLinesAsideAndNamesThem) {
  const auto whole = Evaluate(FakePlan(), MakeFakeTrialRunner, Options());
  const std::string text = Read(ledger);
  std::vector<std::string> notices;
  int made = 0;
  const auto counts = [&](const EvaluationUnit& unit) {
    ++made;
    return MakeFakeTrialRunner(unit);
  };
  EvaluationOptions options = Options();
  options.salvage = true;
  options.notice = [&](const std::string& notice) { notices.push_back(notice); };
  const std::size_t second = text.find('\n') + 1;
  for (const std::size_t place : {text.find("trials"), second + 5}) {  // in the header, in a unit
    std::string damaged = text;
    damaged[place] ^= 1;
    Write(ledger, damaged);
    notices.clear();
    made = 0;
    EXPECT_EQ(Evaluate(FakePlan(), counts, options), whole);
    EXPECT_EQ(made, place < second ? 0 : 1);
    ASSERT_EQ(notices.size(), 1u);
    EXPECT_THAT(notices[0], HasSubstr(place < second ? "line 1 is d" : "line 2 is dropped"));
    EXPECT_EQ(ReadLedger(ledger).records.size(), whole.size());
  }
  const std::string dropped = Read(ledger.string() + ".dropped");
  EXPECT_EQ(std::ranges::count(dropped, '\n'), 2);

  std::filesystem::remove(ledger.string() + ".dropped");
  std::filesystem::create_directory(ledger.string() + ".dropped");
  std::string damaged = text;
  damaged[second + 5] ^= 1;
  Write(ledger, damaged);
  EXPECT_THAT(test::MessageOf<std::runtime_error>(
                  [&] { static_cast<void>(Evaluate(FakePlan(), counts, options)); }),
              HasSubstr(".dropped: cannot be written: Is a directory"));
  EXPECT_EQ(Read(ledger), damaged);
}

TEST_F(LedgerTest, AnotherWriterIsRefusedAndLosesNothing) {
  EvaluationOptions options = Options();
  std::string message;
  const auto opens_again = [&](const EvaluationUnit& unit) {
    if (message.empty()) {
      message =
          test::MessageOf([&] { (void)Evaluate(FakePlan(), MakeFakeTrialRunner, Options()); });
    }
    return MakeFakeTrialRunner(unit);
  };
  const auto results = Evaluate(FakePlan(), opens_again, options);
  EXPECT_THAT(message, HasSubstr("another process is writing it"));
  EXPECT_EQ(ReadLedger(ledger).records.size(), results.size());
}

// ENOSPC, EIO and short writes at every call, also in the resumed run: no result is lost, and no
// unit that was written runs again.
TEST_F(LedgerTest, WriteErrorsLoseAndRepeatNothing) {
  EvaluationPlan plan = FakePlan();
  plan.trials = 1;
  const auto whole = Evaluate(plan, MakeFakeTrialRunner);
  const auto units = std::ssize(whole);
  for (const int error : {ENOSPC, EIO, 0}) {
    for (int after = 0; after < 12; ++after) {
      SCOPED_TRACE(testing::Message() << "error " << error << " after " << after << " calls");
      std::filesystem::remove(ledger);
      std::string kept;  // whole lines
      std::vector<UnitResult> results;
      for (const Fault& next : {Fault{after, error}, Fault{after / 2, error}, Fault()}) {
        int made = 0;
        const auto counts = [&](const EvaluationUnit& unit) {
          ++made;
          return MakeFakeTrialRunner(unit);
        };
        fault = next;
        const std::string message =
            test::MessageOf([&] { results = Evaluate(plan, counts, Options()); });
        const bool failed = next.after >= 0 && error != 0 && fault.after < 0;
        fault = {};
        ASSERT_THAT(message, HasSubstr(failed ? "Earlier units are kept" : "nothing thrown"));
        const auto left = units - std::max<std::ptrdiff_t>(0, std::ranges::count(kept, '\n') - 1);
        ASSERT_LE(made, left) << "a unit that was written ran again";
        ASSERT_TRUE(failed || made == left);
        const std::string now = Read(ledger);
        ASSERT_TRUE(now.starts_with(kept)) << "a unit that was written is lost";
        kept = now.substr(0, now.rfind('\n') + 1);
      }
      ASSERT_EQ(results, whole);
      ASSERT_EQ(std::ranges::count(kept, '\n'), units + 1);
    }
  }
}

class MergeTest : public testing::Test {
 protected:
  // Creates a ledger of shard index/count in a separate file.
  std::filesystem::path Run(int index, int count, const EvaluationPlan& plan = FakePlan(),
                            const std::string& gamma = "5") const {
    std::filesystem::path path =
        folder / (std::to_string(index) + "of" + std::to_string(count) + ".jsonl");
    std::filesystem::remove(path);
    (void)Evaluate(
        plan, MakeFakeTrialRunner,
        {.threads = 1, .shard = {index, count}, .ledger = path, .settings = {{"gamma", gamma}}});
    return path;
  }
  std::filesystem::path folder = EmptyFolder(
      std::string("merge_") + testing::UnitTest::GetInstance()->current_test_info()->name());
  std::filesystem::path whole = folder / "whole.jsonl";
};

TEST_F(MergeTest, AnySplitGivesTheSameResultsInAnyOrder) {
  const auto expected = Evaluate(FakePlan(), MakeFakeTrialRunner);
  for (const int count : {1, 7, 33}) {  // of 20 units
    std::vector<std::filesystem::path> shards;
    for (int index = 1; index <= count; ++index) shards.push_back(Run(index, count));
    MergeLedgers(shards, whole);
    const std::string text = Read(whole);
    std::ranges::reverse(shards);
    shards.push_back(shards.front());
    MergeLedgers(shards, whole);
    EXPECT_EQ(Read(whole), text);
    const LedgerContents contents = ReadLedger(whole);
    ASSERT_EQ(contents.records.size(), expected.size());
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_EQ(contents.records[i].result, expected[i]);
    }
    EXPECT_EQ(contents.header.shard, Shard());
  }
}

TEST_F(MergeTest, LedgersOfDifferentRunsAreRefusedByName) {
  const auto first = Run(1, 2);
  EXPECT_THAT(test::MessageOf([&] { MergeLedgers({first}, whole); }),
              HasSubstr("10 of 20 units are missing; the first is trial 2, 60 demonstrations, 8."));
  EXPECT_THAT(test::MessageOf([&] {
                MergeLedgers({first, Run(2, 2, FakePlan(), "7")}, whole);
              }),
              HasSubstr("settings.gamma is \"5\" there and \"7\" now"));
  EvaluationPlan plan = FakePlan();
  plan.episodes = 13;
  EXPECT_THAT(test::MessageOf([&] {
                MergeLedgers({first, Run(2, 2, plan)}, whole);
              }),
              HasSubstr("episodes is 12 there and 13 now"));
  EXPECT_FALSE(std::filesystem::exists(whole));
}

TEST_F(MergeTest, AUnitWithDifferentResultsIsRefused) {
  const auto first = Run(1, 1);
  const std::filesystem::path second = folder / "second.jsonl";
  const auto differs = [](const EvaluationUnit& unit) -> std::unique_ptr<TrialRunner> {
    EvaluationUnit other = unit;
    if (unit.trial == 3) other.learner += "x";
    return MakeFakeTrialRunner(other);
  };
  (void)Evaluate(FakePlan(), differs, {.ledger = second, .settings = {{"gamma", "5"}}});
  EXPECT_THAT(test::MessageOf([&] {
                MergeLedgers({first, second}, whole);
              }),
              HasSubstr("has results of trial 3"));
}

TEST_F(MergeTest, EpisodesOfShardsAreThoseOfOneRunAndCountOnce) {
  const auto first = Run(1, 1);
  const auto printed = [](const std::vector<std::filesystem::path>& ledgers) {
    std::ostringstream text;
    PrintEpisodes(ledgers, {}, 1, text);
    return text.str();
  };
  Write(folder / "empty.jsonl", "");
  EXPECT_EQ(printed({folder / "empty.jsonl", first, Run(3, 7)}), printed({first}));
  EXPECT_THAT(test::MessageOf([&] { (void)printed({folder / "empty.jsonl"}); }),
              HasSubstr("no unit is finished yet"));
  EXPECT_THAT(test::MessageOf([&] {
                (void)printed({first, Run(2, 2, FakePlan(), "7")});
              }),
              testing::AllOf(HasSubstr("2of2.jsonl: does not belong to the run of"),
                             HasSubstr("name the folder of one run")));
}

TEST(SettingsTest, NumbersKeepAllTheirDigits) {
  EXPECT_EQ(Exactly(5.0), "5");
  EXPECT_EQ(Exactly(0.1), "0.1");
  EXPECT_EQ(Exactly(5.0000001), "5.0000001");
  const double third = 1.0 / 3.0;
  EXPECT_EQ(std::stod(Exactly(third)), third);
}

TEST(SettingsTest, AFilesHashFollowsItsContent) {
  const auto folder = EmptyFolder("hash");
  Write(folder / "a", "one");
  Write(folder / "b", "one");
  Write(folder / "c", "onf");
  EXPECT_EQ(HashOfFile(folder / "a"), HashOfFile(folder / "b"));
  EXPECT_NE(HashOfFile(folder / "a"), HashOfFile(folder / "c"));
  EXPECT_EQ(HashOfFile(folder / "a").size(), 16u);
  EXPECT_THAT(test::MessageOf([&] { (void)HashOfFile(folder / "absent"); }), HasSubstr("absent"));
}

}  // namespace
}  // namespace dfr::experiment
