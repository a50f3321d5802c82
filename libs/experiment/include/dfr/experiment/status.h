#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace dfr::experiment {

/// State of one ledger of a run.
struct LedgerStatus {
  /// Path of the ledger. The file is missing or empty if its program failed at start.
  std::filesystem::path path;
  std::string shard;  ///< "2/7", empty before the first unit.
  int done = 0;
  int units = 0;         ///< Number of units of the shard; 0 before the first unit.
  bool running = false;  ///< True if a process has locked the ledger or its folder.
  /// For an unfinished ledger without a writer: the last line of the newest log beside it.
  std::string last_words;
};

/// State of a run of one or more shards.
struct Status {
  int done = 0;  ///< Number of units finished in at least one of the ledgers.
  int units = 0;
  std::map<std::string, int> by_host;  ///< Number of units by the host that finished them.
  double mean_wall_s = 0.0;            ///< Mean duration of a unit on one thread.
  double longest_wall_s = 0.0;         ///< Maximum duration of a unit.
  /// Remaining time at the current rate; absent if no process is running or no unit is finished.
  std::optional<double> remaining_s = {};
  std::vector<LedgerStatus> ledgers;
};

/// Reads the ledgers in these folders or their subfolders, while programs may write them. Shards of
/// one run are combined; runs of a grid are separate. A shard without a finished unit belongs to
/// the run of the shards beside it. The rate is the number of finished units divided by the time
/// during which at least one of them ran. Pauses between runs do not count.
/// @returns at least one status.
/// @throws std::runtime_error naming a folder with neither ledgers nor logs; and as ReadLedger().
[[nodiscard]] std::vector<Status> StatusesOf(const std::vector<std::filesystem::path>& folders);

/// Formats the statuses for a terminal. For several runs, the first line gives the totals.
[[nodiscard]] std::string ToText(const std::vector<Status>& statuses);

/// Returns the statuses as JSON: {"done", "units", "by_host", "mean_wall_s", "longest_wall_s",
/// "remaining_s", "ledgers": [{"path", "shard", "done", "units", "running", "last_words"}, ...]}; a
/// list of such objects for several runs.
[[nodiscard]] std::string ToJson(const std::vector<Status>& statuses);

}  // namespace dfr::experiment
