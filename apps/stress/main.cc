// How policies hold out against disturbances, alone and with each controller around them, in all
// tasks of all programs.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "apps/command_line.h"
#include "apps/controller_factory.h"
#include "apps/stress/study.h"
#include "dfr/core/build_info.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/intervals.h"
#include "dfr/experiment/report.h"
#include "dfr/experiment/sequential_test.h"

namespace dfr::apps::stress {
namespace {

void RunAndPrint(const Study& study, bool grid) {
  const std::vector<Row> rows = RunStudy(study);
  if (rows.empty()) return;
  SaveCsv(rows, study.out / "stress.csv");
  std::vector<experiment::ReportTable> tables = grid ? MakeGrid(rows) : MakeTables(rows);
  for (const std::string& controller : study.controllers) {
    if (controller == "guided") tables.push_back(WhereItFails(rows, controller));
  }
  for (const experiment::ReportTable& table : tables) {
    experiment::PrintTable(table, std::cout);
    std::cout << "  " << table.caption << "\n\n";
  }
  experiment::SaveReport(
      {},
      {.title = "Disturbed policies, alone and guarded",
       .program = "stress",
       .introduction =
           "Saved: the policy alone collides from this start state, and with the controller it "
           "does not. Harmed: the policy alone completes, and with the controller it does not. "
           "Start states outside the support count like any other.",
       .settings = {{"seed", std::to_string(study.seed)},
                    {"commit", core::BuildCommit()},
                    {"demonstrations", std::to_string(study.demonstrations)},
                    {"trials", std::to_string(study.trials)},
                    {"episodes a trial", std::to_string(study.episodes)}},
       .tables = tables},
      study.out / "report.html");
  std::cout << (study.out / "report.html").string() << " and stress.csv\n";
}

void AddOptions(CLI::App& command, Study& study) {
  command.add_option("--tasks", study.tasks, "those of pusher, planar, gallery and line tracking")
      ->delimiter(',')
      ->capture_default_str();
  command
      .add_option("--policies", study.policies,
                  "learned (a weak network), or " + dfr::apps::Join(dfr::apps::kPolicies))
      ->delimiter(',')
      ->capture_default_str();
  command.add_option("--controllers", study.controllers, "besides the policy alone")
      ->delimiter(',')
      ->capture_default_str();
  command.add_option("--conditions", study.conditions, "by their names in the table; default: all")
      ->delimiter(',');
  command.add_option("--demonstrations", study.demonstrations)->capture_default_str();
  command.add_option("--trials", study.trials, "each with its own demonstrations and policies")
      ->capture_default_str();
  command.add_option("--episodes", study.episodes, "start states per trial and row")
      ->capture_default_str();
  experiment::AddRunOptions(command, study);
}

struct Power {
  double only_first = 0.02;
  double only_second = 0.05;
  double power = 0.8;
  double bound = 0.005;
};

void PrintPower(const Power& power) {
  std::printf(
      "paired episodes that find, with probability %g, that one method alone fails from %g and the "
      "other alone from %g of the start states: %d\n"
      "episodes without a collision that show that there are fewer than %g: %d\n"
      "(at 95 %%, episodes taken for independent: with trials that differ, as many times more as "
      "the interval clustered by trial is wider, squared)\n",
      power.power, power.only_first, power.only_second,
      experiment::EpisodesForDifference(power.only_first, power.only_second, power.power),
      power.bound, experiment::EpisodesForBound(power.bound));
}

void CompareAndPrint(const Comparison& comparison) {
  const dfr::experiment::SequentialTest test = Compare(comparison);
  const auto pairs = static_cast<long long>(test.pairs());
  std::printf("%s: %s, %d demonstrations, %d trials in turn, seed %llu, commit %s\n",
              comparison.task.c_str(), comparison.condition.c_str(), comparison.demonstrations,
              comparison.trials, static_cast<unsigned long long>(comparison.seed),
              std::string(core::BuildCommit()).c_str());
  std::printf("credit of %s less that of %s, mean of %lld pairs: %+.3f (p %.2g at all times)\n",
              comparison.first.c_str(), comparison.second.c_str(), pairs, test.mean(),
              test.p_value());
  if (test.settled()) {
    std::printf("settled at %g after %lld of at most %d pairs: %lld episodes saved\n",
                comparison.alpha, pairs, comparison.pairs, 2 * (comparison.pairs - pairs));
  } else {
    std::printf("not settled at %g: no episodes saved\n", comparison.alpha);
  }
}

void AddOptions(CLI::App& command, Comparison& comparison) {
  command.add_option("--task", comparison.task)->capture_default_str();
  command.add_option("--condition", comparison.condition, "by its name in the table")
      ->capture_default_str();
  command.add_option("--first", comparison.first, dfr::apps::MethodHelp())->capture_default_str();
  command.add_option("--second", comparison.second, "another of these")->capture_default_str();
  command.add_option("--demonstrations", comparison.demonstrations)->capture_default_str();
  command
      .add_option("--trials", comparison.trials,
                  "each with its own demonstrations and policies; they take turns")
      ->capture_default_str();
  command.add_option("--pairs", comparison.pairs, "of episodes, at most")->capture_default_str();
  command.add_option("--alpha", comparison.alpha, "probability of settling what is not so")
      ->capture_default_str();
  command
      .add_option(
          "--halted", comparison.credit.halted,
          "credit of an episode that halts, times the share of the demonstrated time steps that "
          "it came through; a completed one has 1, one that collides 0")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command.add_option("--seed", comparison.seed, "of all that is random")->capture_default_str();
}

}  // namespace
}  // namespace dfr::apps::stress

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  using namespace dfr::apps::stress;  // NOLINT: this is their main
  CLI::App app("Disturbed policies, alone and guarded, in all tasks of all programs");
  app.require_subcommand(1);
  Study study;
  auto* run = app.add_subcommand(
      "run", "every controller around every policy from the same start states, as tables");
  Study grid_study;
  grid_study.out = "out/grid";
  grid_study.tasks = {"pusher", "planar-corridor", "planar-push"};
  grid_study.conditions = {"as demonstrated", "turned 40 deg"};
  grid_study.controllers.clear();
  for (const std::string_view support : dfr::apps::kSupports) {
    for (const char* controller : {"early-stopping", "dfr", "guided", "certified"}) {
      grid_study.controllers.push_back(std::string(controller) + "/" + std::string(support));
    }
  }
  auto* grid = app.add_subcommand(
      "grid", "what the support buys and what the controller buys: every support with every one");
  for (const auto& [command, options] : {std::pair(run, &study), std::pair(grid, &grid_study)}) {
    AddOptions(*command, *options);
  }
  auto* power_command = app.add_subcommand("power", "how many episodes a question needs");
  Power power;
  power_command
      ->add_option("--only-first", power.only_first,
                   "share of start states from which one method alone fails")
      ->capture_default_str();
  power_command->add_option("--only-second", power.only_second, "and the other alone")
      ->capture_default_str();
  power_command->add_option("--power", power.power, "probability of finding the difference")
      ->capture_default_str();
  power_command->add_option("--bound", power.bound, "share of collisions to be excluded")
      ->capture_default_str();
  auto* compare = app.add_subcommand(
      "compare", "two methods from the same start states, until it is settled that they differ");
  Comparison comparison;
  AddOptions(*compare, comparison);
  dfr::apps::CheckNumbers(app);
  if (const auto code = dfr::experiment::Parse(app, argc, argv)) return *code;
  if (*compare) CompareAndPrint(comparison);
  if (*run) RunAndPrint(study, false);
  if (*grid) RunAndPrint(grid_study, true);
  if (*power_command) PrintPower(power);
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::cerr << "stress: " << e.what() << '\n';
  return EXIT_FAILURE;
}
