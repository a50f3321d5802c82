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
  std::filesystem::path path;  ///< Where nothing is yet, if its program failed at once.
  std::string shard;           ///< "2/7", empty before the first unit.
  int done = 0;
  int units = 0;         ///< Those of its shard; 0 before the first unit.
  bool running = false;  ///< A process has it, or its folder.
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

/// Looks at the ledgers in these folders, or in folders below, which may be written at the same
/// time. Shards of one run are together, runs of a grid apart; a task without a unit is with those
/// beside it. The rate is that of all units in the time from the first one's begin to the last
/// one's end.
/// @returns at least one.
/// @throws std::runtime_error naming a folder with neither ledgers nor logs; as ReadLedger().
[[nodiscard]] std::vector<Status> StatusesOf(const std::vector<std::filesystem::path>& folders);

/// For a terminal: of several runs first how far all of them are.
[[nodiscard]] std::string ToText(const std::vector<Status>& statuses);

/// The same as JSON: {"done", "units", "by_host", "mean_wall_s", "longest_wall_s", "remaining_s",
/// "ledgers": [{"path", "shard", "done", "units", "running", "last_words"}, ...]}; of several runs
/// a list of these.
[[nodiscard]] std::string ToJson(const std::vector<Status>& statuses);

}  // namespace dfr::experiment
