#include "dfr/experiment/status.h"

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "dfr/core/text/format.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/progress.h"
#include "ledger/ledger_file.h"

namespace dfr::experiment {
namespace {

using Span = std::pair<double, double>;  // start and end of a unit, s

// Returns the time during which at least one unit ran. Also counts gaps of up to 2 s, because a
// ledger stores end times in whole seconds.
double TotalLength(std::vector<Span> spans) {
  std::ranges::sort(spans);
  double total = 0.0;
  double until = spans.empty() ? 0.0 : spans.front().first;
  for (const auto& [begin, end] : spans) {
    if (end <= until) continue;
    total += end - (begin > until + 2.0 ? begin : until);
    until = end;
  }
  return total;
}

bool IsLog(const std::filesystem::directory_entry& entry) {
  const std::filesystem::path ending = entry.path().extension();
  return entry.is_regular_file() && (ending == ".log" || ending == ".out");
}

// Returns the name and the last non-blank line of the newest *.log or *.out beside the ledger.
std::string LastWords(const std::filesystem::path& folder) {
  std::filesystem::path newest;
  std::filesystem::file_time_type time;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (!IsLog(entry)) continue;
    if (newest.empty() || entry.last_write_time() > time) {
      newest = entry.path();
      time = entry.last_write_time();
    }
  }
  if (newest.empty()) return "";
  std::string last;
  std::ifstream in(newest);
  for (std::string line; std::getline(in, line);) {
    if (line.find_first_not_of(" \t\r") != std::string::npos) last = line;
  }
  return newest.filename().string() + ": " + last;
}

// Appends the ledgers in `folder` and below it, down to the depth of a grid's shards. A folder with
// only logs is a task that failed before it created a ledger.
void Collect(const std::filesystem::path& folder, int depth,
             std::vector<std::filesystem::path>& ledgers) {
  constexpr int kDeepestFolder = 2;
  const std::filesystem::path ledger = folder / "ledger.jsonl";
  if (std::filesystem::is_regular_file(ledger)) {
    ledgers.push_back(ledger);
    return;
  }
  if (!std::filesystem::is_directory(folder)) return;
  std::vector<std::filesystem::path> below;
  bool has_log = false;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.is_directory()) below.push_back(entry.path());
    has_log = has_log || IsLog(entry);
  }
  // dfr-cluster writes the folder cluster, which belongs to no task.
  std::erase_if(below, [](const auto& path) { return path.filename() == "cluster"; });
  if (below.empty() && has_log) ledgers.push_back(ledger);
  if (depth == kDeepestFolder) return;
  std::ranges::sort(below);
  for (const std::filesystem::path& path : below) Collect(path, depth + 1, ledgers);
}

// Accumulates the ledgers of one run.
class Run {
 public:
  explicit Run(const std::filesystem::path& folder) : folder_(folder) {}

  [[nodiscard]] bool Has(const LedgerHeader& header) const {
    return header_ && Difference(*header_, header).empty();
  }
  // Only the folder identifies a task without a unit.
  [[nodiscard]] bool IsIn(const std::filesystem::path& folder) const { return folder_ == folder; }

  // Adds a ledger; `contents` is nullptr if none of its units is finished yet.
  void Add(const std::filesystem::path& path, const LedgerContents* contents) {
    LedgerStatus& one = status_.ledgers.emplace_back();
    one.path = path;
    one.running = internal::IsLocked(path) || internal::IsLocked(path.parent_path() / "lock");
    if (contents != nullptr) Count(*contents, one);
    const bool unfinished = one.units == 0 || one.done < one.units;
    if (unfinished && !one.running) one.last_words = LastWords(path.parent_path());
  }

  [[nodiscard]] Status Result() && {
    status_.done = static_cast<int>(units_.size());
    if (status_.done > 0) status_.mean_wall_s = wall_ / status_.done;
    if (status_.done > 0 && std::ranges::any_of(status_.ledgers, &LedgerStatus::running)) {
      status_.remaining_s = TotalLength(spans_) / status_.done * (status_.units - status_.done);
    }
    return std::move(status_);
  }

 private:
  void Count(const LedgerContents& contents, LedgerStatus& one) {
    if (!header_) header_ = contents.header;
    const Shard& shard = contents.header.shard;
    const std::int64_t all = std::ssize(UnitsOf(contents.header.plan));
    one.shard = std::to_string(shard.index) + "/" + std::to_string(shard.count);
    one.units =
        static_cast<int>(all * shard.index / shard.count - all * (shard.index - 1) / shard.count);
    one.done = static_cast<int>(contents.records.size());
    status_.units = static_cast<int>(all);
    for (const LedgerRecord& record : contents.records) {
      const EvaluationUnit& unit = record.result.unit;
      if (!units_.emplace(unit.trial, unit.demonstrations, unit.learner).second) continue;
      ++status_.by_host[record.host];
      wall_ += record.wall_s;
      status_.longest_wall_s = std::max(status_.longest_wall_s, record.wall_s);
      const auto end = static_cast<double>(record.finished);
      spans_.emplace_back(end - record.wall_s, end);
    }
  }

  std::filesystem::path folder_;  // parent of the first ledger's folder
  std::optional<LedgerHeader> header_;
  Status status_;
  std::set<std::tuple<int, int, std::string>> units_;
  double wall_ = 0.0;
  std::vector<Span> spans_;
};

std::string TextOf(const Status& status) {
  std::string text =
      std::to_string(status.done) + " of " + std::to_string(status.units) + " units are finished";
  for (const auto& [host, count] : status.by_host) {
    text.append(&host == &status.by_host.begin()->first ? ": " : ", ")
        .append(std::to_string(count))
        .append(" by ")
        .append(host);
  }
  text += "\n";
  if (status.done > 0) {
    text += core::Format("a unit takes %.3g s of one thread, the longest took %.3g s\n",
                         status.mean_wall_s, status.longest_wall_s);
  }
  if (status.remaining_s && status.done < status.units) {
    text.append(FormatDuration(*status.remaining_s)).append(" remaining at the current rate\n");
  }
  for (const LedgerStatus& ledger : status.ledgers) {
    const bool finished = ledger.units > 0 && ledger.done >= ledger.units;
    text += core::Format("  %-10s %s",
                         finished         ? "finished"
                         : ledger.running ? "running"
                                          : "stopped",
                         ledger.path.c_str());
    if (ledger.units > 0) {
      text += core::Format("  shard %s: %d of %d", ledger.shard.c_str(), ledger.done, ledger.units);
    }
    if (!ledger.last_words.empty()) text.append("\n             ").append(ledger.last_words);
    text += "\n";
  }
  return text;
}

using Json = nlohmann::ordered_json;

Json JsonOf(const Status& status) {
  Json json = {{"done", status.done},
               {"units", status.units},
               {"by_host", status.by_host},
               {"mean_wall_s", status.mean_wall_s},
               {"longest_wall_s", status.longest_wall_s},
               {"remaining_s", status.remaining_s ? Json(*status.remaining_s) : Json()},
               {"ledgers", Json::array()}};
  for (const LedgerStatus& ledger : status.ledgers) {
    json["ledgers"].push_back({{"path", ledger.path.string()},
                               {"shard", ledger.shard},
                               {"done", ledger.done},
                               {"units", ledger.units},
                               {"running", ledger.running},
                               {"last_words", ledger.last_words}});
  }
  return json;
}

}  // namespace

std::vector<Status> StatusesOf(const std::vector<std::filesystem::path>& folders) {
  std::vector<std::filesystem::path> ledgers;
  for (const std::filesystem::path& folder : folders) {
    const std::size_t before = ledgers.size();
    Collect(folder, 0, ledgers);
    if (ledgers.size() == before) {
      throw std::runtime_error(
          folder.string() +
          ": contains no ledger.jsonl, nor do the folders in it; name the --out of a run");
    }
  }
  std::vector<Run> runs;
  std::vector<std::filesystem::path> without_units;
  const auto run_with = [&](const std::filesystem::path& path, const auto& is_it) -> Run& {
    const auto found = std::ranges::find_if(runs, is_it);
    return found != runs.end() ? *found : runs.emplace_back(path.parent_path().parent_path());
  };
  for (const std::filesystem::path& path : ledgers) {
    if (!std::filesystem::exists(path) || std::filesystem::file_size(path) == 0) {
      without_units.push_back(path);
      continue;
    }
    const LedgerContents contents = ReadLedger(path);
    run_with(path, [&](const Run& run) { return run.Has(contents.header); }).Add(path, &contents);
  }
  for (const std::filesystem::path& path : without_units) {
    const std::filesystem::path beside = path.parent_path().parent_path();
    run_with(path, [&](const Run& run) { return run.IsIn(beside); }).Add(path, nullptr);
  }
  std::vector<Status> statuses;
  statuses.reserve(runs.size());
  for (Run& run : runs) statuses.push_back(std::move(run).Result());
  return statuses;
}

std::string ToText(const std::vector<Status>& statuses) {
  std::string text;
  if (statuses.size() > 1) {
    int done = 0;
    int units = 0;
    for (const Status& status : statuses) {
      done += status.done;
      units += status.units;
    }
    text = core::Format("%zu runs, %d of %d units are finished\n", statuses.size(), done, units);
  }
  for (const Status& status : statuses) {
    text.append(text.empty() ? "" : "\n").append(TextOf(status));
  }
  return core::Printable(text);
}

std::string ToJson(const std::vector<Status>& statuses) {
  Json json = JsonOf(statuses.front());
  if (statuses.size() > 1) {
    json = Json::array();
    for (const Status& status : statuses) json.push_back(JsonOf(status));
  }
  // A folder's name can contain any bytes.
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace dfr::experiment
