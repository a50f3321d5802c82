#include "dfr/experiment/episodes.h"

#include <algorithm>
#include <charconv>
#include <ostream>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::experiment {
namespace {

// What stands before the next slash, or behind the last one, taken from the text.
std::string_view TakeFirst(std::string_view& text) {
  const std::size_t slash = std::min(text.find('/'), text.size());
  const std::string_view part = text.substr(0, slash);
  text.remove_prefix(std::min(slash + 1, text.size()));
  return part;
}

std::string_view TakeLast(std::string_view& text) {
  const std::size_t slash = text.rfind('/');
  const std::string_view part = slash == std::string_view::npos ? text : text.substr(slash + 1);
  text = text.substr(0, slash == std::string_view::npos ? 0 : slash);
  return part;
}

bool Read(std::string_view text, int& value) {
  const auto end = std::from_chars(text.data(), text.data() + text.size(), value);
  return !text.empty() && end.ec == std::errc() && end.ptr == text.data() + text.size();
}

}  // namespace

std::string Name(const EpisodeId& id) {
  return std::to_string(id.unit.trial) + "/" + std::to_string(id.unit.demonstrations) + "/" +
         id.unit.learner + "/" + id.method + "/" + std::to_string(id.start);
}

EpisodeId ParseEpisode(std::string_view name, const EvaluationPlan& plan) {
  std::string_view rest = name;
  EpisodeId id;
  const bool numbers = Read(TakeFirst(rest), id.unit.trial) &&
                       Read(TakeFirst(rest), id.unit.demonstrations) &&
                       Read(TakeLast(rest), id.start);
  DFR_THROW_UNLESS(numbers, "an episode is TRIAL/DEMONSTRATIONS/LEARNER/METHOD/START, as in "
                                << "0/120/8/guided/17, not '" << name << "'");
  DFR_THROW_UNLESS(0 <= id.unit.trial && id.unit.trial < plan.trials,
                   name << ": there are trials 0 to " << plan.trials - 1);
  DFR_THROW_UNLESS(std::ranges::count(plan.demonstrations, id.unit.demonstrations) == 1,
                   name << ": there is no data point " << id.unit.demonstrations);
  DFR_THROW_UNLESS(0 <= id.start && id.start < plan.episodes,
                   name << ": there are start states 0 to " << plan.episodes - 1);
  // Names may have slashes of their own.
  for (const std::string& learner : plan.learners) {
    const bool begins = rest.starts_with(learner) && rest.substr(learner.size()).starts_with('/');
    for (const std::string& method : plan.methods) {
      if (begins && rest.substr(learner.size() + 1) == method) {
        id.unit.learner = learner;
        id.method = method;
        return id;
      }
    }
  }
  DFR_THROW_UNLESS(false, name << ": the plan has no learner and method '" << rest << "'");
  return id;
}

RecordedEpisode FindEpisode(const std::filesystem::path& folder, std::string_view name,
                            const LedgerHeader* now) {
  LedgerContents ledger = ReadLedger(folder / "ledger.jsonl");
  const std::string difference = now == nullptr ? "" : Difference(ledger.header, *now);
  if (!difference.empty()) {
    throw std::runtime_error(folder.string() +
                             ": its episodes cannot be run again by this build: " + difference);
  }
  const EvaluationPlan& plan = ledger.header.plan;
  const EpisodeId id = ParseEpisode(name, plan);
  for (const LedgerRecord& record : ledger.records) {
    if (record.result.unit != id.unit) continue;
    const auto start = static_cast<std::size_t>(id.start);
    const auto method =
        static_cast<std::size_t>(std::ranges::find(plan.methods, id.method) - plan.methods.begin());
    const std::uint64_t controller_seed = ControllerSeed(plan, id.unit.trial, id.start);
    return {.header = std::move(ledger.header),
            .id = id,
            .result = record.result.episodes[method][start],
            .start_seed = record.result.starts[start],
            .controller_seed = controller_seed};
  }
  throw std::runtime_error(folder.string() + ": the unit of " + std::string(name) +
                           " is not finished");
}

void PrintEpisodes(const std::vector<std::filesystem::path>& ledgers, const EpisodeFilter& filter,
                   int most, std::ostream& out) {
  struct Row {
    EpisodeId id;
    EpisodeResult result;
  };
  std::vector<Row> rows;
  for (const std::filesystem::path& path : ledgers) {
    const LedgerContents contents = ReadLedger(path);
    const std::vector<std::string>& methods = contents.header.plan.methods;
    for (const LedgerRecord& record : contents.records) {
      const EvaluationUnit& unit = record.result.unit;
      if (!filter.learner.empty() && unit.learner != filter.learner) continue;
      if (filter.demonstrations > 0 && unit.demonstrations != filter.demonstrations) continue;
      for (std::size_t m = 0; m < methods.size(); ++m) {
        if (!filter.method.empty() && methods[m] != filter.method) continue;
        for (std::size_t i = 0; i < record.result.starts.size(); ++i) {
          const EpisodeResult& episode = record.result.episodes[m][i];
          if (!filter.outcome.empty() && core::Name(episode.outcome) != filter.outcome) continue;
          if (!filter.cause.empty() && episode.cause != filter.cause) continue;
          rows.push_back({{unit, methods[m], static_cast<int>(i)}, episode});
        }
      }
    }
  }
  std::ranges::stable_sort(rows, std::ranges::greater(), [](const Row& row) {
    return std::tuple(static_cast<int>(row.result.outcome), row.result.recovery_controls);
  });
  const std::size_t shown =
      most > 0 ? std::min(rows.size(), static_cast<std::size_t>(most)) : rows.size();
  for (std::size_t i = 0; i < shown; ++i) {
    const Row& row = rows[i];
    out << Name(row.id) << "  " << core::Name(row.result.outcome)
        << (row.result.cause.empty() ? "" : ": " + row.result.cause) << "  " << row.result.controls
        << " controls, " << row.result.recovery_controls << " of recovery\n";
  }
  if (shown < rows.size()) {
    out << "and " << rows.size() - shown << " more; --most 0 prints all\n";
  }
}

}  // namespace dfr::experiment
