#include "apps/study/tables.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "apps/study/runner.h"
#include "apps/study/totals.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/intervals.h"
#include "dfr/safety/guard.h"

namespace dfr::study {
namespace {

std::string Shown(const std::string& controller) {
  return controller == kAlone ? "alone" : controller;
}

constexpr const char* kSuccessAfter =
    " After intervention: the share of completed episodes among those in which the method changed "
    "a "
    "control or halted. Without intervention: the share among the other episodes.";

constexpr const char* kChangeUnit =
    "Passed: controls that equal the policy's bit for bit. Change: mean size of the others' "
    "changes, "
    "in ordinary demonstrated controls. A method that is another policy has neither.";

// Returns the learner of the row's episodes, as in their ids; empty for a sum over learners.
std::string LearnerOf(const Row& row) {
  return row.task.empty() ? "" : row.task + kBetween + row.condition;
}

// Command that prints the row's episodes with these outcomes, from start states from which the
// policy alone ended with one of `alone` (if any).
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

// Returns the commands that print the episodes behind the two numbers of Outcomes().
std::string OutcomesCommand(const Row& row) {
  return CommandOf(row, {"completed"}) + "\n" + CommandOf(row, {"collided"});
}

// Returns the commands that print the episodes behind the numbers of Compared().
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

std::string Number(const std::optional<double>& value, int digits, double factor = 1.0) {
  return value ? core::Format("%.*f", digits, factor * *value) : "-";
}

// "96.3 / 0.41": per cent of the controls that equal the policy's bit for bit, and the mean change
// of all other controls.
std::string Interventions(const Totals& totals) {
  return Number(totals.passed(), 1, 100.0) + " / " + Number(totals.change(), 2);
}

// "90.0 [84.1, 94.2]": per cent with its interval.
std::string Percent(double share, const std::optional<experiment::Interval>& interval, int digits) {
  std::string text = core::Format("%.*f", digits, 100.0 * share);
  if (interval) {
    text += core::Format(" [%.*f, %.*f]", digits, 100.0 * interval->low, digits,
                         100.0 * interval->high);
  }
  return text;
}

// Formats the share of `count` among the episodes that `of` counts; "-" if there are none.
std::string Percent(const Totals& totals, int TrialCounts::*count, int digits,
                    int TrialCounts::*of = &TrialCounts::episodes) {
  const int episodes = totals.counts().*of;
  if (episodes == 0) return "-";
  return Percent(static_cast<double>(totals.counts().*count) / episodes,
                 totals.IntervalOf(count, of), digits);
}

// Returns the entries "after intervention" and "without intervention" of a method's rows, which are
// not empty. A policy does not intervene.
std::pair<std::string, std::string> AroundInterventions(const Totals& totals, const Row& row) {
  if (row.controller == kAlone) return {};
  if (IsOtherPolicy(row)) return {"-", "-"};
  return {Percent(totals, &TrialCounts::intervened_completed, 1, &TrialCounts::intervened),
          Percent(totals, &TrialCounts::left_alone_completed, 1, &TrialCounts::left_alone)};
}

std::string PassedPercent(const Totals& totals, int digits) {
  const std::optional<double> passed = totals.passed();
  return passed ? Percent(*passed, totals.PassedInterval(), digits) : "-";
}

std::vector<Row> Select(const std::vector<Row>& rows, const std::string& policy,
                        const std::string& controller) {
  std::vector<Row> selected;
  std::ranges::copy_if(rows, std::back_inserter(selected), [&](const Row& row) {
    return row.policy == policy && row.controller == controller;
  });
  return selected;
}

const char* ClusterText(const Totals& totals) {
  const std::string clusters = totals.clusters();
  if (clusters == "task") return "clustered by task";
  return clusters == "trial" ? "clustered by trial"
                             : "that treat episodes as independent: there are fewer than 3 trials";
}

experiment::ReportTable PolicyTable(const std::vector<Row>& rows, const std::string& policy,
                                    const std::vector<std::string>& controllers) {
  experiment::ReportTable table;
  table.heading = "Policy: " + policy;
  table.caption =
      "Completed / collided, then saved / harmed against the policy alone, in per cent of " +
      std::to_string(rows.front().episodes) +
      " episodes per cell; then per cent of the controls passed unchanged / mean size of the "
      "others' changes, in ordinary demonstrated controls.";
  table.header = {"task", "condition"};
  for (const std::string& controller : controllers) {
    table.header.push_back(Shown(controller));
    if (controller == kAlone) continue;
    table.header.emplace_back("saved / harmed");
    table.header.emplace_back("passed / change");
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
    table.rows.back().push_back(Interventions(Totals(row)));
    table.commands.back().emplace_back();
  }
  return table;
}

experiment::ReportTable MeansTable(const std::vector<Row>& rows,
                                   const std::vector<std::string>& policies,
                                   const std::vector<std::string>& controllers) {
  experiment::ReportTable table;
  table.heading = "Over all tasks and conditions";
  table.caption = std::string("Means in per cent with 95 % intervals ") +
                  ClusterText(Totals(Select(rows, policies[0], controllers[0]))) +
                  ", and the worst row of each. " + kChangeUnit + kSuccessAfter;
  table.header = {"policy", "controller", "completed",          "collided",
                  "saved",  "harmed",     "after intervention", "without intervention",
                  "passed", "change",     "most collisions",    "most harm"};
  for (const std::string& policy : policies) {
    for (const std::string& controller : controllers) {
      const std::vector<Row> selected = Select(rows, policy, controller);
      const Totals totals(selected);
      const Row sum{{}, "", "", policy, controller};
      const Row& collides = *std::ranges::max_element(selected, {}, &Row::collided);
      const Row& harms = *std::ranges::max_element(selected, {}, &Row::harmed);
      const bool alone = controller == kAlone;
      const auto [after, without] = AroundInterventions(totals, sum);
      const auto against = [&](int TrialCounts::*count) {
        return alone ? "" : Percent(totals, count, 2);
      };
      const auto worst = [](const Row& row, int count) {
        return core::Format("%.1f %s%s%s", Share(count, row.episodes), row.task.c_str(), kBetween,
                            row.condition.c_str());
      };
      table.rows.push_back({policy, Shown(controller), Percent(totals, &TrialCounts::completed, 2),
                            Percent(totals, &TrialCounts::collided, 2),
                            against(&TrialCounts::saved), against(&TrialCounts::harmed), after,
                            without, PassedPercent(totals, 1), Number(totals.change(), 2),
                            worst(collides, collides.collided),
                            alone ? "" : worst(harms, harms.harmed)});
      table.commands.push_back({"", "", CommandOf(sum, {"completed"}), CommandOf(sum, {"collided"}),
                                alone ? "" : SavedCommand(sum), alone ? "" : HarmedCommand(sum), "",
                                "", "", "", CommandOf(collides, {"collided"}),
                                alone ? "" : HarmedCommand(harms)});
    }
  }
  return table;
}

// "12.3 (8, 30)": mean, median and 90 % quantile.
std::string Lengths(std::vector<int> lengths) {
  if (lengths.empty()) return "";
  double sum = 0.0;
  for (const int length : lengths) sum += length;
  return core::Format("%.1f (%d, %d)", sum / static_cast<double>(lengths.size()),
                      core::Quantile(lengths, 0.5), core::Quantile(lengths, 0.9));
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
  tables.push_back(MeansTable(rows, policies, controllers));
  for (const std::string& policy : policies) {
    tables.push_back(PolicyTable(rows, policy, controllers));
  }
  return tables;
}

std::vector<experiment::ReportTable> MakeGrid(const std::vector<Row>& rows) {
  std::vector<experiment::ReportTable> tables;
  for (const std::string& policy : Distinct(rows, &Row::policy)) {
    std::vector<std::string> names;
    std::vector<std::string> supports;
    std::map<std::pair<std::string, std::string>, std::vector<Row>> sums;  // support, controller
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
      sums[{support, name}].push_back(row);
    }
    experiment::ReportTable table{
        .heading = "Support and controller, policy: " + policy,
        .caption = std::string("Completed / collided / passed in per cent / change, means over all "
                               "tasks and conditions. ") +
                   kChangeUnit,
        .header = {"support"},
        .rows = {}};
    for (const std::string& name : names) table.header.push_back(Shown(name));
    for (const std::string& support : supports) {
      table.rows.push_back({support});
      table.commands.push_back({""});
      for (const std::string& name : names) {
        // The policy alone uses no support.
        const auto found = sums.find({name == kAlone ? "" : support, name});
        if (found == sums.end()) {
          table.rows.back().emplace_back("-");
          table.commands.back().emplace_back();
          continue;
        }
        const Totals totals(found->second);
        const Row sum{totals.counts(), "", "", policy, found->second.front().controller};
        table.rows.back().push_back(Outcomes(sum) + " / " + Interventions(totals));
        table.commands.back().push_back(OutcomesCommand(sum));
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
  table.heading =
      "Rows in which " + controller + " fails around a policy that completes half or more";
  table.header = {"task",    "condition",      "policy",         "alone",
                  "guarded", "saved / harmed", "passed / change"};
  const Row* alone = nullptr;
  int judged = 0;
  for (const Row& row : rows) {
    if (row.controller == kAlone) alone = &row;
    if (row.controller != controller || alone == nullptr) continue;
    if (2 * alone->completed < alone->episodes) continue;
    ++judged;
    if (Share(row.collided, row.episodes) <= kMostCollided &&
        Share(row.harmed, row.episodes) <= kMostHarmed) {
      continue;
    }
    table.rows.push_back({row.task, row.condition, row.policy, Outcomes(*alone), Outcomes(row),
                          Compared(row), Interventions(Totals(row))});
    table.commands.push_back(
        {"", "", "", OutcomesCommand(*alone), OutcomesCommand(row), ComparedCommand(row), ""});
  }
  table.caption = std::to_string(table.rows.size()) + " of " + std::to_string(judged) +
                  " rows: those with collisions in more than 0.5 % of the episodes, or with more " +
                  "than 2 % harmed.";
  return table;
}

std::vector<experiment::ReportTable> MakeRowTables(const std::vector<Row>& rows, bool causes) {
  std::vector<experiment::ReportTable> tables;
  if (rows.empty()) return tables;
  experiment::ReportTable table{
      .heading = "Episodes",
      .caption = std::string("In per cent of the episodes, with 95 % intervals ") +
                 ClusterText(Totals(rows.front())) + ". " + kChangeUnit + kSuccessAfter,
      .header = {"task", "condition", "policy", "method", "ok %", "failed %", "halted %", "saved",
                 "saved-ok", "harmed", "after intervention", "without intervention", "passed %",
                 "change", "controls", "alarms in fail.", "false alarms", "controls per recovery"},
      .rows = {}};
  experiment::ReportTable why{
      .heading = "Why episodes were not completed",
      .caption = "Number of episodes per cause.",
      .header = {"task", "condition", "policy", "method", "episodes", "cause"},
      .rows = {}};
  for (const Row& row : rows) {
    const bool alone = row.controller == kAlone;
    const std::string watching = safety::Name(safety::Strategy::kMonitor);
    const bool monitor = row.controller == watching || row.controller == watching + kOnPictures;
    const auto share = [&](int count) { return core::Format("%.0f", Share(count, row.episodes)); };
    const Totals totals(row);
    const auto [after, without] = AroundInterventions(totals, row);
    table.rows.push_back(
        {row.task, row.condition, row.policy, Shown(row.controller),
         Percent(totals, &TrialCounts::completed, 1), Percent(totals, &TrialCounts::collided, 1),
         Percent(totals, &TrialCounts::halted, 1), share(row.saved), share(row.saved_completed),
         share(row.harmed), after, without, PassedPercent(totals, 1), Number(totals.change(), 2),
         core::Format("%.1f", row.controls / row.episodes),
         monitor ? Percent(totals, &TrialCounts::alarmed_failures, 1, &TrialCounts::collided) : "",
         monitor ? Percent(totals, &TrialCounts::alarmed_successes, 1, &TrialCounts::completed)
                 : "",
         Lengths(row.recoveries)});
    table.commands.push_back({"", "", "", "", CommandOf(row, {"completed"}),
                              CommandOf(row, {"collided"}), CommandOf(row, {"halted"}),
                              alone ? "" : SavedCommand(row),
                              alone ? "" : CommandOf(row, {"completed"}, {"collided"}),
                              alone ? "" : HarmedCommand(row), "", "", "", "", "", "", "", ""});
    for (const auto& [cause, count] : row.causes) {
      why.rows.push_back({row.task, row.condition, row.policy, Shown(row.controller),
                          std::to_string(count), cause});
    }
  }
  tables.push_back(
      MeansTable(rows, Distinct(rows, &Row::policy), Distinct(rows, &Row::controller)));
  tables.push_back(std::move(table));
  if (causes) tables.push_back(std::move(why));
  return tables;
}

experiment::ReportFigure MakeFigure(const std::vector<Row>& rows) {
  experiment::ReportFigure figure{
      .heading = "Completion against intervention",
      .caption =
          "One plot per policy and one point per method that guards it, over all tasks and "
          "conditions. A good guard is at the upper left: it completes many episodes and changes "
          "few controls.",
      .plots = {}};
  if (rows.empty()) return figure;
  const std::vector<std::string> controllers = Distinct(rows, &Row::controller);
  for (const std::string& policy : Distinct(rows, &Row::policy)) {
    experiment::ReportPlot plot{.title = "Policy: " + policy,
                                .x_label = "controls not passed, %",
                                .percent = true,
                                .x_min = 0.0,
                                .x_max = 100.0,
                                .y_min = 0.0,
                                .y_max = 1.0};
    for (std::size_t i = 0; i < controllers.size(); ++i) {
      const std::vector<Row> selected = Select(rows, policy, controllers[i]);
      if (IsOtherPolicy(selected.front())) continue;
      const Totals totals(selected);
      const experiment::Interval interval = totals.IntervalOf(&TrialCounts::completed);
      plot.series.push_back(
          {.name = Shown(controllers[i]),
           .x = {100.0 * (1.0 - totals.passed().value_or(1.0))},
           .y = {static_cast<double>(totals.counts().completed) / totals.episodes()},
           .low = {interval.low},
           .high = {interval.high},
           .commands = {CommandOf({{}, "", "", policy, controllers[i]}, {"completed"})},
           .style = experiment::MethodStyle(Shown(controllers[i]))});
    }
    figure.plots.push_back(std::move(plot));
  }
  figure.caption += std::string(" Bars are 95 % intervals ") +
                    ClusterText(Totals(Select(rows, rows[0].policy, controllers[0]))) + ".";
  return figure;
}

void SaveCsv(const std::vector<Row>& rows, const std::filesystem::path& path) {
  std::ostringstream out;
  out << "task,condition,policy,method,episodes,ok,failed,halted,saved,saved_ok,harmed,"
         "intervened,ok_after_intervention,alarmed_failures,alarmed_successes,controls,changed,"
         "change\n";
  for (const Row& row : rows) {
    out << row.task << ',' << row.condition << ',' << row.policy << ',' << Shown(row.controller)
        << ',' << row.episodes << ',' << row.completed << ',' << row.collided << ',' << row.halted
        << ',' << row.saved << ',' << row.saved_completed << ',' << row.harmed << ','
        << row.intervened << ',' << row.intervened_completed << ',' << row.alarmed_failures << ','
        << row.alarmed_successes << ',' << row.controls / row.episodes << ','
        << row.changed / row.episodes << ','
        << (row.sized_changes > 0 ? core::Format("%.6g", row.change / row.sized_changes) : "")
        << '\n';
  }
  core::ReplaceFile(path, out.view());
}

}  // namespace dfr::study
