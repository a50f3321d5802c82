#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace dfr::experiment {

/// One ledger of a run, seen from outside.
struct LedgerStatus {
  std::filesystem::path path;
  std::string shard;  ///< "2/7", empty before the first unit.
  int done = 0;
  int units = 0;         ///< Those of its shard; 0 before the first unit.
  bool running = false;  ///< A process has it open.
  /// Where it is unfinished and nobody writes it: the last line of the newest log beside it.
  std::string last_words;
};

/// How far a run of one or more shards is.
struct Status {
  int done = 0;  ///< Units finished in at least one of the ledgers.
  int units = 0;
  std::map<std::string, int> by_host;      ///< Units, by who finished them.
  double mean_wall_s = 0.0;                ///< What a unit takes, on one thread.
  double longest_wall_s = 0.0;             ///< The most that one took.
  std::optional<double> remaining_s = {};  ///< At the rate so far; absent unless one is running.
  std::vector<LedgerStatus> ledgers;
};

/// Looks at ledgers that may be written at the same time. The rate is that of all units in the time
/// from the first one's begin to the last one's end.
/// @throws std::runtime_error as ReadLedger(), and naming the field in which two ledgers differ.
[[nodiscard]] Status StatusOf(const std::vector<std::filesystem::path>& ledgers);

/// For a terminal.
[[nodiscard]] std::string ToText(const Status& status);

/// The same as JSON: {"done", "units", "by_host", "mean_wall_s", "longest_wall_s", "remaining_s",
/// "ledgers": [{"path", "shard", "done", "units", "running", "last_words"}, ...]}.
[[nodiscard]] std::string ToJson(const Status& status);

}  // namespace dfr::experiment
