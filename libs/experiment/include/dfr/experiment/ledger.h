#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/experiment/paired_evaluation.h"

namespace dfr::experiment {

/// Header line of a ledger: everything that determines the results.
struct LedgerHeader {
  EvaluationPlan plan;  ///< The file omits supervisors, and a default max_redraws.
  std::map<std::string, std::string> settings;
  std::string commit;
  Shard shard;  ///< Units covered by the file.
};

/// One finished unit and its origin.
struct LedgerRecord {
  UnitResult result;
  std::string host;
  double wall_s = 0.0;        ///< Duration of the unit on one thread.
  std::int64_t finished = 0;  ///< Time of completion, seconds since 1970, UTC.
  /// Widest instruction set of the machine, such as "AVX2", which decides the rounding; "unknown"
  /// in older files.
  std::string instructions = "unknown";
};

struct LedgerContents {
  LedgerHeader header;
  std::vector<LedgerRecord> records;  ///< Records in the order of the file, each unit once.
  /// True if the last line is incomplete: its writer was killed, or is still writing it.
  bool cut = false;
};

/// Reads a ledger: a header and one line of JSON per finished unit. Each line ends with a checksum
/// of its bytes and of the header, which detects flipped bits and lines of another run. The start
/// states must follow from the plan's seed. Needs no lock.
/// @throws std::runtime_error naming the file, line and remedy for a file that is not a ledger, has
/// another format version, or is damaged.
[[nodiscard]] LedgerContents ReadLedger(const std::filesystem::path& path);

/// Returns the first difference between two headers that affects results, such as "seed is 3 there
/// and 4 now"; empty if the ledgers may be merged. Shards may differ.
[[nodiscard]] std::string Difference(const LedgerHeader& there, const LedgerHeader& now);

/// Returns the plan's units in the order of Evaluate()'s results.
[[nodiscard]] std::vector<EvaluationUnit> UnitsOf(const EvaluationPlan& plan);

/// Merges the ledgers of the shards into one ledger of the whole plan, in the plan's order. The
/// file is identical for any split. Skips shards without a finished unit. A unit in several shards
/// must have the same results in each, up to rounding.
/// @throws std::runtime_error naming the field, the unit or the missing units; and as ReadLedger().
void MergeLedgers(const std::vector<std::filesystem::path>& shards,
                  const std::filesystem::path& whole);

/// Returns 16 hexadecimal digits that change with the file's content, for settings that identify
/// input files.
/// @throws std::runtime_error naming a file that cannot be read.
[[nodiscard]] std::string HashOfFile(const std::filesystem::path& path);

/// Returns the shortest text that reads back as the same number, for settings.
[[nodiscard]] std::string Exactly(double value);

}  // namespace dfr::experiment
