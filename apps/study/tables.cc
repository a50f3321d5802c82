#include "apps/study/tables.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <stdexcept>
#include <utility>

#include "apps/study/runner.h"
#include "dfr/core/format.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/intervals.h"
#include "dfr/safety/guard.h"

namespace dfr::study {
namespace {

std::string Shown(const std::string& controller) {
  return controller == kAlone ? "alone" : controller;
}

double Share(int count, int of) { return 100.0 * count / of; }

// The row's place in ids. Empty for a sum over tasks and conditions.
std::string LearnerOf(const Row& row) {
  return row.task.empty() ? "" : row.task + kBetween + row.condition;
}

// Which command prints the row's episodes of these outcomes, from start states from which the
// policy alone ended with one of `alone`.
std::string CommandOf(const Row& row, const std::vector<std::string>& outcomes,
                      const std::vector<std::string>& alone = {}) {
  experiment::EpisodeFilter filter{.method = MethodOf(row.controller, row.policy),
                                   .learner = LearnerOf(row),
                                   .outcomes = outcomes};
  if (!alone.empty()) {
    filter.against = {.method = MethodOf(kAlone, row.policy), .outcomes = alone};
  }
  return experiment::EpisodesCommand("study", filter);
}

std::string SavedCommand(const Row& row) {
  return CommandOf(row, {"completed", "halted"}, {"collided"});
}

std::string HarmedCommand(const Row& row) {
  return CommandOf(row, {"halted", "collided"}, {"completed"});
}

// The commands of the two numbers of Outcomes(), and of those of Compared().
std::string OutcomesCommand(const Row& row) {
  return CommandOf(row, {"completed"}) + "\n" + CommandOf(row, {"collided"});
}

std::string ComparedCommand(const Row& row) {
  return SavedCommand(row) + "\n" + HarmedCommand(row);
}

std::string Outcomes(const Row& row) {
  return core::Format("%.1f / %.1f", Share(row.completed, row.episodes),
                      Share(row.collided, row.episodes));
}

std::string Compared(const Row& row) {
  return core::Format("%.1f / %.1f", Share(row.saved, row.episodes),
                      Share(row.harmed, row.episodes));
}

// Per cent of the controls that are the policy's to the bit.
std::string Passed(const Row& row) {
  return row.controls > 0.0 ? core::Format("%.1f", 100.0 * (1.0 - row.changed / row.controls))
                            : "-";
}

template <typename Member>
std::vector<std::string> Distinct(const std::vector<Row>& rows, Member member) {
  std::vector<std::string> values;
  for (const Row& row : rows) {
    if (std::ranges::count(values, row.*member) == 0) values.push_back(row.*member);
  }
  return values;
}

experiment::ReportTable PolicyTable(const std::vector<Row>& rows, const std::string& policy,
                                    const std::vector<std::string>& controllers) {
  experiment::ReportTable table;
  table.heading = "Policy: " + policy;
  table.caption =
      "Completed / collided, then saved / harmed against the policy alone, in per cent of " +
      std::to_string(rows.front().episodes) + " episodes a cell.";
  table.header = {"task", "condition"};
  for (const std::string& controller : controllers) {
    table.header.push_back(Shown(controller));
    if (controller != kAlone) table.header.emplace_back("saved / harmed");
  }
  for (const Row& row : rows) {
    if (row.policy != policy) continue;
    if (row.controller == kAlone) {
      table.rows.push_back({row.task, row.condition});
      table.commands.push_back({"", ""});
    }
    table.rows.back().push_back(Outcomes(row));
    table.commands.back().push_back(OutcomesCommand(row));
    if (row.controller == kAlone) continue;
    table.rows.back().push_back(Compared(row));
    table.commands.back().push_back(ComparedCommand(row));
  }
  return table;
}

experiment::ReportTable MeansTable(const std::vector<Row>& rows,
                                   const std::vector<std::string>& policies,
                                   const std::vector<std::string>& controllers) {
  experiment::ReportTable table;
  table.heading = "Over all rows";
  table.caption = "Means in per cent, and the worst row of each.";
  table.header = {"policy", "controller", "completed",       "collided", "saved",
                  "harmed", "passed",     "most collisions", "most harm"};
  for (const std::string& policy : policies) {
    for (const std::string& controller : controllers) {
      Row sum{.task = "", .condition = "", .policy = policy, .controller = controller};
      const Row* collides = nullptr;
      const Row* harms = nullptr;
      for (const Row& row : rows) {
        if (row.policy != policy || row.controller != controller) continue;
        sum.episodes += row.episodes;
        sum.completed += row.completed;
        sum.collided += row.collided;
        sum.saved += row.saved;
        sum.harmed += row.harmed;
        // A mean over rows: long episodes count no more than short ones.
        sum.controls += 1.0;
        sum.changed += row.controls > 0.0 ? row.changed / row.controls : 0.0;
        if (collides == nullptr || row.collided > collides->collided) collides = &row;
        if (harms == nullptr || row.harmed > harms->harmed) harms = &row;
      }
      const auto text = [&](int count) { return core::Format("%.2f", Share(count, sum.episodes)); };
      const auto worst = [](const Row& row, int count) {
        return core::Format("%.1f %s%s%s", Share(count, row.episodes), row.task.c_str(), kBetween,
                            row.condition.c_str());
      };
      table.rows.push_back({policy, Shown(controller), text(sum.completed), text(sum.collided),
                            text(sum.saved), text(sum.harmed), Passed(sum),
                            worst(*collides, collides->collided), worst(*harms, harms->harmed)});
      const bool alone = controller == kAlone;
      table.commands.push_back({"", "", CommandOf(sum, {"completed"}), CommandOf(sum, {"collided"}),
                                alone ? "" : SavedCommand(sum), alone ? "" : HarmedCommand(sum), "",
                                CommandOf(*collides, {"collided"}),
                                alone ? "" : HarmedCommand(*harms)});
    }
  }
  return table;
}

// "90.0 [84.1, 94.2]": per cent with its interval.
std::string Percent(int count, int of) {
  if (of == 0) return "-";
  const experiment::Interval i = experiment::ProportionInterval(count, of);
  return core::Format("%.1f [%.1f, %.1f]", 100.0 * count / of, 100.0 * i.low, 100.0 * i.high);
}

// "12.3 (8, 30)": mean, median and 90 % quantile.
std::string Lengths(std::vector<int> lengths) {
  if (lengths.empty()) return "";
  std::ranges::sort(lengths);
  double sum = 0.0;
  for (const int length : lengths) sum += length;
  const auto quantile = [&](double q) {
    return lengths[static_cast<std::size_t>(q * static_cast<double>(lengths.size() - 1))];
  };
  return core::Format("%.1f (%d, %d)", sum / static_cast<double>(lengths.size()), quantile(0.5),
                      quantile(0.9));
}

}  // namespace

std::string MethodOf(const std::string& controller, const std::string& policy) {
  if (policy == "learned") return controller;
  const std::size_t slash = std::min(controller.find('/'), controller.size());
  return controller.substr(0, slash) + "@" + policy + controller.substr(slash);
}

std::vector<experiment::ReportTable> MakeTables(const std::vector<Row>& rows) {
  std::vector<experiment::ReportTable> tables;
  if (rows.empty()) return tables;
  const std::vector<std::string> policies = Distinct(rows, &Row::policy);
  const std::vector<std::string> controllers = Distinct(rows, &Row::controller);
  for (const std::string& policy : policies) {
    tables.push_back(PolicyTable(rows, policy, controllers));
  }
  tables.push_back(MeansTable(rows, policies, controllers));
  return tables;
}

std::vector<experiment::ReportTable> MakeGrid(const std::vector<Row>& rows) {
  std::vector<experiment::ReportTable> tables;
  for (const std::string& policy : Distinct(rows, &Row::policy)) {
    std::vector<std::string> names;
    std::vector<std::string> supports;
    std::map<std::pair<std::string, std::string>, Row> sums;  // by support and controller
    for (const Row& row : rows) {
      if (row.policy != policy) continue;
      const std::size_t slash = std::min(row.controller.find('/'), row.controller.size());
      const std::string name = row.controller.substr(0, slash);
      const std::string support =
          slash < row.controller.size() ? row.controller.substr(slash + 1) : "";
      if (std::ranges::count(names, name) == 0) names.push_back(name);
      if (!support.empty() && std::ranges::count(supports, support) == 0) {
        supports.push_back(support);
      }
      Row& sum = sums[{support, name}];
      sum.policy = row.policy;
      sum.controller = row.controller;
      sum.episodes += row.episodes;
      sum.completed += row.completed;
      sum.collided += row.collided;
    }
    experiment::ReportTable table{
        .heading = "Support and controller, policy: " + policy,
        .caption = "Completed / collided in per cent, means over all tasks and conditions.",
        .header = {"support"},
        .rows = {}};
    for (const std::string& name : names) table.header.push_back(Shown(name));
    for (const std::string& support : supports) {
      table.rows.push_back({support});
      table.commands.push_back({""});
      for (const std::string& name : names) {
        // The policy alone looks at no support.
        const auto sum = sums.find({name == kAlone ? "" : support, name});
        table.rows.back().push_back(sum == sums.end() ? "-" : Outcomes(sum->second));
        table.commands.back().push_back(sum == sums.end() ? "" : OutcomesCommand(sum->second));
      }
    }
    tables.push_back(std::move(table));
  }
  return tables;
}

experiment::ReportTable WhereItFails(const std::vector<Row>& rows, const std::string& controller) {
  constexpr double kMostCollided = 0.5;
  constexpr double kMostHarmed = 2.0;
  experiment::ReportTable table;
  table.heading = "Where " + controller + " fails around a policy that completes half or more";
  table.caption = "It collides in more than 0.5 % of the episodes, or harms more than 2 %.";
  table.header = {"task", "condition", "policy", "alone", "guarded", "saved / harmed"};
  const Row* alone = nullptr;
  for (const Row& row : rows) {
    if (row.controller == kAlone) alone = &row;
    if (row.controller != controller || alone == nullptr) continue;
    if (2 * alone->completed < alone->episodes) continue;
    if (Share(row.collided, row.episodes) <= kMostCollided &&
        Share(row.harmed, row.episodes) <= kMostHarmed) {
      continue;
    }
    table.rows.push_back(
        {row.task, row.condition, row.policy, Outcomes(*alone), Outcomes(row), Compared(row)});
    table.commands.push_back(
        {"", "", "", OutcomesCommand(*alone), OutcomesCommand(row), ComparedCommand(row)});
  }
  return table;
}

std::vector<experiment::ReportTable> MakeRowTables(const std::vector<Row>& rows, bool causes) {
  experiment::ReportTable table{
      .heading = "Episodes",
      .caption = "In per cent of the episodes, with 95 % intervals that take them as independent.",
      .header = {"task", "condition", "policy", "method", "ok %", "failed %", "halted %", "saved",
                 "saved-ok", "harmed", "passed %", "controls", "alarms in fail.", "false alarms",
                 "controls per recovery"},
      .rows = {}};
  experiment::ReportTable why{
      .heading = "Why episodes were not completed",
      .caption = "Episodes.",
      .header = {"task", "condition", "policy", "method", "episodes", "cause"},
      .rows = {}};
  for (const Row& row : rows) {
    const bool alone = row.controller == kAlone;
    const bool monitor = row.controller == safety::Name(safety::Strategy::kMonitor);
    const auto share = [&](int count) { return core::Format("%.0f", Share(count, row.episodes)); };
    table.rows.push_back({row.task, row.condition, row.policy, Shown(row.controller),
                          Percent(row.completed, row.episodes), Percent(row.collided, row.episodes),
                          Percent(row.episodes - row.completed - row.collided, row.episodes),
                          share(row.saved), share(row.saved_completed), share(row.harmed),
                          Passed(row), core::Format("%.1f", row.controls),
                          monitor ? Percent(row.alarmed_failures, row.collided) : "",
                          monitor ? Percent(row.alarmed_successes, row.completed) : "",
                          Lengths(row.recoveries)});
    table.commands.push_back({"", "", "", "", CommandOf(row, {"completed"}),
                              CommandOf(row, {"collided"}), CommandOf(row, {"halted"}),
                              alone ? "" : SavedCommand(row),
                              alone ? "" : CommandOf(row, {"completed"}, {"collided"}),
                              alone ? "" : HarmedCommand(row), "", "", "", "", ""});
    for (const auto& [cause, count] : row.causes) {
      why.rows.push_back({row.task, row.condition, row.policy, Shown(row.controller),
                          std::to_string(count), cause});
    }
  }
  std::vector<experiment::ReportTable> tables = {
      std::move(table),
      MeansTable(rows, Distinct(rows, &Row::policy), Distinct(rows, &Row::controller))};
  if (causes) tables.push_back(std::move(why));
  return tables;
}

void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path) {
  std::ofstream out(path);
  out << "task,condition,policy,method,episodes,ok,failed,halted,saved,saved_ok,harmed,"
         "alarmed_failures,alarmed_successes,controls,changed\n";
  for (const Row& row : rows) {
    out << row.task << ',' << row.condition << ',' << row.policy << ',' << Shown(row.controller)
        << ',' << row.episodes << ',' << row.completed << ',' << row.collided << ','
        << row.episodes - row.completed - row.collided << ',' << row.saved << ','
        << row.saved_completed << ',' << row.harmed << ',' << row.alarmed_failures << ','
        << row.alarmed_successes << ',' << row.controls << ',' << row.changed << '\n';
  }
  if (!out.flush()) throw std::runtime_error(path.string() + ": cannot be written");
}

}  // namespace dfr::study
