#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/experiment/paired_evaluation.h"

namespace dfr::experiment {

/// What a ledger's first line says: all that decides the results.
struct LedgerHeader {
  EvaluationPlan plan;  ///< But for max_redraws, which decides no result.
  std::map<std::string, std::string> settings;
  std::string commit;
  Shard shard;  ///< Which units the file is for.
};

/// One finished unit, and how it came about.
struct LedgerRecord {
  UnitResult result;
  std::string host;
  double wall_s = 0.0;        ///< How long the unit took, on one thread.
  std::int64_t finished = 0;  ///< Seconds since 1970, UTC.
};

struct LedgerContents {
  LedgerHeader header;
  std::vector<LedgerRecord> records;  ///< In the order of the file, each unit once.
  bool cut = false;  ///< The last line has no end: its writer was killed, or is at it.
};

/// Reads a ledger, one line of JSON a finished unit behind a header. Each line ends with a checksum
/// of its bytes and of the header's, so that neither a flipped bit nor a line of another run
/// passes; start states have to be those that follow from the plan's seed. Needs no lock.
/// @throws std::runtime_error naming file, line and remedy for a file that is no ledger, one of
///   another format version, or a damaged one.
[[nodiscard]] LedgerContents ReadLedger(const std::filesystem::path& path);

/// The first entry that decides results in which two ledgers differ, as "seed is 3 there and 4
/// now"; empty where they may be merged. Shards may differ.
[[nodiscard]] std::string Difference(const LedgerHeader& there, const LedgerHeader& now);

/// The plan's units in the order in which Evaluate() returns them.
[[nodiscard]] std::vector<EvaluationUnit> UnitsOf(const EvaluationPlan& plan);

/// Writes the ledger of the whole plan from those of its shards, in the plan's order; the same file
/// for any split. Shards without a finished unit are left out. A unit that several of them have
/// must have the same results in each.
/// @throws std::runtime_error naming the field, the unit or the units that are missing; and as
///   ReadLedger().
void MergeLedgers(const std::vector<std::filesystem::path>& shards,
                  const std::filesystem::path& whole);

/// 16 hexadecimal digits that change with the file's content, for settings: what a run has read.
/// @throws std::runtime_error naming a file that cannot be read.
[[nodiscard]] std::string HashOfFile(const std::filesystem::path& path);

/// The shortest text that reads back as the same number, for settings.
[[nodiscard]] std::string Exactly(double value);

}  // namespace dfr::experiment
