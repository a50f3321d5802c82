#include "dfr/experiment/status.h"

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <tuple>

#include "dfr/core/format.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/progress.h"
#include "ledger_file.h"

namespace dfr::experiment {
namespace {

// The last line that is not blank, of the newest *.log or *.out beside the ledger.
std::string LastWords(const std::filesystem::path& folder) {
  std::filesystem::path newest;
  std::filesystem::file_time_type time;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const std::filesystem::path ending = entry.path().extension();
    if (!entry.is_regular_file() || (ending != ".log" && ending != ".out")) continue;
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

}  // namespace

Status StatusOf(const std::vector<std::filesystem::path>& ledgers) {
  Status status;
  std::optional<LedgerHeader> header;
  std::set<std::tuple<int, int, std::string>> units;
  double wall = 0.0;
  double begun = 0.0;
  double ended = 0.0;
  for (const std::filesystem::path& path : ledgers) {
    LedgerStatus& one = status.ledgers.emplace_back();
    one.path = path;
    one.running = internal::IsLocked(path);
    if (std::filesystem::file_size(path) > 0) {
      const LedgerContents contents = ReadLedger(path);
      if (!header) header = contents.header;
      const std::string difference = Difference(*header, contents.header);
      if (!difference.empty()) {
        throw std::runtime_error(path.string() + ": is of another run than " +
                                 ledgers.front().string() + ": " + difference);
      }
      const Shard& shard = contents.header.shard;
      const std::int64_t all = std::ssize(UnitsOf(contents.header.plan));
      one.shard = std::to_string(shard.index) + "/" + std::to_string(shard.count);
      one.units =
          static_cast<int>(all * shard.index / shard.count - all * (shard.index - 1) / shard.count);
      one.done = static_cast<int>(contents.records.size());
      status.units = static_cast<int>(all);
      for (const LedgerRecord& record : contents.records) {
        const EvaluationUnit& unit = record.result.unit;
        if (!units.emplace(unit.trial, unit.demonstrations, unit.learner).second) continue;
        ++status.by_host[record.host];
        wall += record.wall_s;
        status.longest_wall_s = std::max(status.longest_wall_s, record.wall_s);
        const auto end = static_cast<double>(record.finished);
        begun = units.size() == 1 ? end - record.wall_s : std::min(begun, end - record.wall_s);
        ended = units.size() == 1 ? end : std::max(ended, end);
      }
    }
    const bool unfinished = one.units == 0 || one.done < one.units;
    if (unfinished && !one.running) one.last_words = LastWords(path.parent_path());
  }
  status.done = static_cast<int>(units.size());
  if (status.done > 0) status.mean_wall_s = wall / status.done;
  const bool running = std::ranges::any_of(status.ledgers, &LedgerStatus::running);
  if (running && status.done > 0) {
    status.remaining_s = (ended - begun) / status.done * (status.units - status.done);
  }
  return status;
}

std::string ToText(const Status& status) {
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
    text.append(FormatDuration(*status.remaining_s)).append(" left at the rate so far\n");
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

std::string ToJson(const Status& status) {
  using Json = nlohmann::ordered_json;
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
  return json.dump(1) + "\n";
}

}  // namespace dfr::experiment
