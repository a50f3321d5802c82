#include "dfr/experiment/episodes.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <ostream>
#include <set>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/take_until.h"
#include "dfr/core/text/usage_error.h"

namespace dfr::experiment {
namespace {

std::string_view TakeLast(std::string_view& text) {
  const std::size_t slash = text.rfind('/');
  const std::string_view part = slash == std::string_view::npos ? text : text.substr(slash + 1);
  text = text.substr(0, slash == std::string_view::npos ? 0 : slash);
  return part;
}

// Checks that a ledger contains the names in a filter. A misspelled name would match no episode.
class Known {
 public:
  void Add(const EvaluationPlan& plan, const EpisodeFilter& filter) {
    method_ = method_ || Has(plan.methods, filter.method);
    learner_ = learner_ || Has(plan.learners, filter.learner);
    point_ = point_ || filter.demonstrations == 0 ||
             std::ranges::count(plan.demonstrations, filter.demonstrations) > 0;
    partner_ = partner_ || Has(plan.methods, filter.against.method);
    Note(plan.methods, methods_);
    Note(plan.learners, learners_);
  }

  void Check(const EpisodeFilter& filter) const {
    const auto check = [](bool known, const char* what, const std::string& name,
                          const std::string& names) {
      if (known) return;
      throw core::UsageError(std::string("unknown ") + what + " '" + name + "'" +
                             (names.empty() ? "" : "; valid: " + names));
    };
    check(method_, "method", filter.method, methods_);
    check(partner_, "method", filter.against.method, methods_);
    check(learner_, "learner", filter.learner, learners_);
    check(point_, "data point", std::to_string(filter.demonstrations), "");
  }

 private:
  static bool Has(const std::vector<std::string>& names, const std::string& name) {
    return name.empty() || std::ranges::count(names, name) > 0;
  }
  static void Note(const std::vector<std::string>& names, std::string& list) {
    if (!list.empty()) return;
    for (const std::string& name : names) list.append(list.empty() ? "" : ", ").append(name);
  }
  bool method_ = false;
  bool learner_ = false;
  bool point_ = false;
  bool partner_ = false;
  std::string methods_;  // names in the first ledger
  std::string learners_;
};

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
  const bool numbers = Read(core::TakeUntil(rest, '/'), id.unit.trial) &&
                       Read(core::TakeUntil(rest, '/'), id.unit.demonstrations) &&
                       Read(TakeLast(rest), id.start);
  DFR_THROW_UNLESS(numbers, "an episode is TRIAL/DEMONSTRATIONS/LEARNER/METHOD/START, as in "
                                << "0/120/8/controller/17, not '" << name << "'");
  DFR_THROW_UNLESS(0 <= id.unit.trial && id.unit.trial < plan.trials,
                   name << ": trials are 0 to " << plan.trials - 1);
  DFR_THROW_UNLESS(
      std::ranges::count(plan.demonstrations, id.unit.demonstrations) == 1,
      name << ": the plan has no data point with " << id.unit.demonstrations << " demonstrations");
  DFR_THROW_UNLESS(0 <= id.start && id.start < plan.episodes,
                   name << ": start states are 0 to " << plan.episodes - 1);
  // Names of learners may contain slashes.
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
  DFR_THROW_UNLESS(false, name << ": the plan has no pair of learner and method '" << rest << "'");
  return id;
}

RecordedEpisode FindEpisode(const std::filesystem::path& folder, std::string_view name,
                            const LedgerHeader* now) {
  LedgerContents ledger = ReadLedger(folder / "ledger.jsonl");
  const std::string difference = now == nullptr ? "" : Difference(ledger.header, *now);
  if (!difference.empty()) {
    throw std::runtime_error(folder.string() +
                             ": this build cannot run its episodes again: " + difference);
  }
  const EvaluationPlan& plan = ledger.header.plan;
  const EpisodeId id = [&] {
    try {
      return ParseEpisode(name, plan);
    } catch (const std::invalid_argument& e) {
      throw core::UsageError(e.what());
    }
  }();
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

EpisodePartner ParsePartner(std::string_view text) {
  const std::size_t equals = text.rfind('=');
  DFR_THROW_UNLESS(equals != std::string_view::npos && equals > 0,
                   "--against takes METHOD=OUTCOME, as in baseline=collided, not '" << text << "'");
  EpisodePartner partner{.method = std::string(text.substr(0, equals))};
  std::string_view rest = text.substr(equals + 1);
  do {
    const std::size_t comma = std::min(rest.find(','), rest.size());
    const std::string& outcome = partner.outcomes.emplace_back(rest.substr(0, comma));
    DFR_THROW_UNLESS(outcome == core::Name(core::Outcome::kCompleted) ||
                         outcome == core::Name(core::Outcome::kHalted) ||
                         outcome == core::Name(core::Outcome::kCollided),
                     "--against " << text << ": unknown outcome '" << outcome
                                  << "'; valid: completed, halted, collided");
    rest.remove_prefix(std::min(comma + 1, rest.size()));
  } while (!rest.empty());
  return partner;
}

std::string EpisodesCommand(const std::string& program, const EpisodeFilter& filter) {
  const auto word = [](const std::string& text) {
    if (text.find_first_of(" \t,;'\"\\$&<>()|*?[]{}#!`~") == std::string::npos) return text;
    std::string quoted = "'";
    for (const char c : text) quoted += c == '\'' ? "'\\''" : std::string(1, c);
    return quoted + "'";
  };
  const auto joined = [](const std::vector<std::string>& texts) {
    std::string all;
    for (const std::string& text : texts) all.append(all.empty() ? "" : ",").append(text);
    return all;
  };
  std::string command = word(program) + " episodes FOLDER";
  const auto add = [&](const char* option, const std::string& value) {
    if (!value.empty()) command.append(" --").append(option).append(" ").append(value);
  };
  add("learner", word(filter.learner));
  add("method", word(filter.method));
  add("demonstrations", filter.demonstrations > 0 ? std::to_string(filter.demonstrations) : "");
  add("outcome", joined(filter.outcomes));
  add("cause", word(filter.cause));
  if (!filter.against.method.empty()) {
    add("against", word(filter.against.method) + "=" + joined(filter.against.outcomes));
  }
  return command;
}

void PrintEpisodes(const std::vector<std::filesystem::path>& ledgers, const EpisodeFilter& filter,
                   int most, std::ostream& out) {
  struct Row {
    EpisodeId id;
    EpisodeResult result;
  };
  std::vector<Row> rows;
  std::int64_t all = 0;  // number of episodes with any outcome
  Known known;
  std::optional<LedgerHeader> first;
  std::filesystem::path first_path;
  std::set<std::tuple<int, int, std::string>> seen;
  const auto is_one_of = [](const std::vector<std::string>& outcomes, core::Outcome outcome) {
    return outcomes.empty() || std::ranges::count(outcomes, core::Name(outcome)) > 0;
  };
  for (const std::filesystem::path& path : ledgers) {
    // A shard without a finished unit has an empty ledger.
    if (std::filesystem::is_empty(path)) continue;
    const LedgerContents contents = ReadLedger(path);
    if (!first) {
      first = contents.header;
      first_path = path;
    }
    const std::string difference = Difference(*first, contents.header);
    if (!difference.empty()) {
      throw std::runtime_error(path.string() + ": does not belong to the run of " +
                               first_path.string() + ": " + difference +
                               " (now: in this ledger); name the folder of one run");
    }
    const EvaluationPlan& plan = contents.header.plan;
    known.Add(plan, filter);
    const auto partner = static_cast<std::size_t>(
        std::ranges::find(plan.methods, filter.against.method) - plan.methods.begin());
    for (const LedgerRecord& record : contents.records) {
      const EvaluationUnit& unit = record.result.unit;
      if (!seen.emplace(unit.trial, unit.demonstrations, unit.learner).second) continue;
      if (!filter.learner.empty() && unit.learner != filter.learner) continue;
      if (filter.demonstrations > 0 && unit.demonstrations != filter.demonstrations) continue;
      for (std::size_t m = 0; m < plan.methods.size(); ++m) {
        if (!filter.method.empty() && plan.methods[m] != filter.method) continue;
        for (std::size_t i = 0; i < record.result.starts.size(); ++i) {
          const EpisodeResult& episode = record.result.episodes[m][i];
          ++all;
          if (!is_one_of(filter.outcomes, episode.outcome)) continue;
          if (!filter.cause.empty() && episode.cause != filter.cause) continue;
          if (!filter.against.method.empty() &&
              (partner == plan.methods.size() ||
               !is_one_of(filter.against.outcomes, record.result.episodes[partner][i].outcome))) {
            continue;
          }
          rows.push_back({{unit, plan.methods[m], static_cast<int>(i)}, episode});
        }
      }
    }
  }
  if (!first) throw std::runtime_error(ledgers.front().string() + ": no unit is finished yet");
  known.Check(filter);
  std::ranges::stable_sort(rows, std::ranges::greater(), [](const Row& row) {
    return std::tuple(static_cast<int>(row.result.outcome), row.result.recovery_controls);
  });
  const std::size_t shown =
      most > 0 ? std::min(rows.size(), static_cast<std::size_t>(most)) : rows.size();
  for (std::size_t i = 0; i < shown; ++i) {
    const Row& row = rows[i];
    const std::string& cause = row.result.cause;
    out << core::Printable(Name(row.id)) << "  " << core::Name(row.result.outcome)
        << (cause.empty() ? "" : ": " + core::Printable(cause)) << "  " << row.result.controls
        << " controls, " << row.result.recovery_controls << " of recovery\n";
  }
  if (shown < rows.size()) {
    out << "and " << rows.size() - shown << " more; --most 0 prints all\n";
  }
  if (all == 0) return;
  double controls = 0.0;
  double recovery = 0.0;
  for (const Row& row : rows) {
    controls += row.result.controls;
    recovery += row.result.recovery_controls;
  }
  const auto count = static_cast<double>(rows.size());
  out << core::Format("%zu of %lld episodes, %.2f %%", rows.size(), static_cast<long long>(all),
                      100.0 * count / static_cast<double>(all));
  if (!rows.empty()) {
    out << core::Format("; on average %.1f controls, %.1f of recovery", controls / count,
                        recovery / count);
  }
  out << '\n';
}

}  // namespace dfr::experiment
