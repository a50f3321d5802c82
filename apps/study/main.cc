// Program study: runs policies alone, with controllers and with guards, in the tasks of all
// programs.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "apps/command_line.h"
#include "apps/study/imitator.h"
#include "apps/study/pictures/camera.h"
#include "apps/study/pictures/detect.h"
#include "apps/study/pictures/detect_options.h"
#include "apps/study/pictures/picture.h"
#include "apps/study/planar/commands.h"
#include "apps/study/study.h"
#include "apps/study/tables.h"
#include "dfr/control/guided/guided_options.h"
#include "dfr/core/build_info.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/intervals.h"
#include "dfr/experiment/report.h"
#include "dfr/experiment/sequential_test.h"
#include "dfr/reduction/state_reduction.h"
#include "dfr/study/controller_factory.h"
#include "dfr/study/placebo.h"

namespace dfr::study {
namespace {

using apps::ReadBy;

void Print(const std::vector<experiment::ReportTable>& tables, std::size_t left_aligned) {
  for (const experiment::ReportTable& table : tables) {
    experiment::PrintTable(table, std::cout, left_aligned);
    std::cout << "  " << table.caption << "\n\n";
  }
}

void RunAndPrint(const Study& study, bool grid, bool causes) {
  const std::vector<Row> rows = RunStudy(study);
  if (rows.empty()) return;
  const bool wide = study.kind == Kind::kControllers;
  std::vector<experiment::ReportTable> tables = !wide  ? MakeRowTables(rows, causes)
                                                : grid ? MakeGrid(rows)
                                                       : MakeTables(rows);
  for (const std::string& controller : study.controllers) {
    const bool guards = controller == "guard" || controller == "controller";
    if (guards && wide) tables.push_back(WhereItFails(rows, controller));
  }
  Print(tables, wide ? 2 : 4);
  std::vector<std::string> marked = study.controllers;
  marked.insert(marked.end(), study.policies.begin(), study.policies.end());
  std::cout << MarksOf(marked);
  if (study.out.empty()) return;
  SaveCsv(rows, study.out / "study.csv");
  experiment::SaveReport(
      {},
      {.title = wide ? "Disturbed policies, alone and guarded" : "Policies, alone and guarded",
       .judgements = JudgeMethods(rows),
       .judged_by = kJudgedBy,
       .program = "study",
       .introduction = "Saved: from this start state the policy collides alone, but not with "
                       "the controller. Harmed: the policy completes alone, but not with "
                       "the controller. Start states outside the support are drawn again only in "
                       "the plane.",
       .settings = {{"seed", std::to_string(study.seed)},
                    {"commit", core::BuildCommit()},
                    {"demonstrations", std::to_string(study.demonstrations)},
                    {"trials", std::to_string(study.trials)},
                    {"episodes per trial", std::to_string(study.episodes)}},
       .figures = {MakeFigure(rows)},
       .tables = tables},
      study.out / "report.html");
  std::cout << (study.out / "report.html").string() << " and study.csv\n";
}

void AddChoices(CLI::App& command, Study& study) {
  command.add_option("--tasks", study.tasks, "tasks: names, gallery, design, held-out or all")
      ->delimiter(',')
      ->check(ReadBy([&study](const std::string& word) { CheckTasks(study.kind, word); }))
      ->capture_default_str();
  command
      .add_option("--policies", study.policies,
                  study.kind == Kind::kGuards ? Join(PolicyNames())
                                              : "learned (a weak network), or " + Join(kPolicies))
      ->delimiter(',')
      ->check(ReadBy([&study](const std::string& name) { CheckPolicy(study.kind, name); }))
      ->capture_default_str();
  command
      .add_option("--conditions", study.conditions,
                  "conditions, by their names in the table; default: all")
      ->delimiter(',')
      ->check(ReadBy(CheckCondition));
  command
      .add_option("--demonstrations", study.demonstrations,
                  "number of demonstrations of each trial")
      ->check(dfr::apps::kModelDemonstrations)
      ->capture_default_str();
  command
      .add_option("--trials", study.trials,
                  "number of trials, each with separate demonstrations and policies")
      ->check(dfr::apps::kPositive)
      ->check(dfr::apps::kCount)
      ->capture_default_str();
  command.add_option("--episodes", study.episodes, "number of start states per trial and row")
      ->check(dfr::apps::kPositive)
      ->check(dfr::apps::kCount)
      ->capture_default_str();
}

void AddOptions(CLI::App& command, Study& study) {
  AddChoices(command, study);
  command
      .add_option("--methods,--controllers", study.controllers,
                  std::string("methods, in addition to the policy alone") +
                      (study.kind == Kind::kGuards ? ": strategies of guards" : "") +
                      (study.kind == Kind::kPlane
                           ? ""
                           : "; " + Join(PlaceboNames()) +
                                 " interrupt the policy as often as guard, at random times"))
      ->delimiter(',')
      ->check(
          ReadBy([&study](const std::string& name) { CheckController(study.kind, name, true); }))
      ->capture_default_str();
  if (study.kind == Kind::kPlane) planar::AddMethodOptions(command, study.plane);
  experiment::AddRunOptions(command, study);
}

// Runs the controller without some of its parts, and then with changed features and supports.
void Ablate(Study study, bool causes) {
  study.controllers = {"controller", "lwr"};
  for (const std::string_view part : control::GuidedPartNames()) {
    if (part != "disturbance")
      study.controllers.push_back("controller-without-" + std::string(part));
  }
  // Parts can mask each other's benefit or harm.
  for (const std::string_view parts : {"exit-level+demonstrated", "online-jacobian+drift+observer",
                                       "exit-level+demonstrated+online-jacobian+drift+observer"}) {
    study.controllers.push_back("controller-without-" + std::string(parts));
  }
  std::vector<Row> rows = RunStudy(study);
  study.controllers = {"controller"};
  const auto add = [&](const char* name, const auto& change) {
    Study variant = study;
    change(variant.plane);
    for (Row& row : RunStudy(variant)) {
      if (row.controller != "controller") continue;
      row.controller = name;
      rows.push_back(std::move(row));
    }
  };
  using Options = planar::MethodOptions;
  add("controller-without-whitening", [](Options& options) { options.whitening = false; });
  add("controller-without-phase-whitening",
      [](Options& options) { options.phase_whitening = false; });
  add("controller-without-held-goals", [](Options& options) { options.hold_ended = false; });
  add("controller-without-pooling", [](Options& options) { options.window = 0; });
  Print(MakeRowTables(rows, causes), 4);
}

void List() {
  for (const bool held_out : {false, true}) {
    std::printf("%s\n", held_out ? "held-out" : "design");
    for (const sim::GalleryTask& task : sim::GalleryTasks()) {
      if (task.held_out != held_out) continue;
      std::printf("  %-15s %s\n", task.name.c_str(), task.summary.c_str());
      std::printf(
          "  %-15s demonstrated in at most %d controls; features of the guard: %s; a control of "
          "zero %s\n",
          "", task.horizon, task.features.empty() ? "all" : task.features.c_str(),
          task.settle_steps == 0 ? "holds still" : "lets the world move on");
    }
  }
}

struct Power {
  double only_first = 0.02;
  double only_second = 0.05;
  double power = 0.8;
  double bound = 0.005;
};

void PrintPower(const Power& power) {
  std::printf(
      "paired episodes that detect, with probability %g, that one method alone fails from %g and "
      "the other alone from %g of the start states: %d\n"
      "episodes without a collision that show a share of collisions below %g: %d\n"
      "(at 95 %%, for independent episodes. If trials differ, multiply by the square of the ratio "
      "of interval widths, clustered by trial to independent)\n",
      power.power, power.only_first, power.only_second,
      experiment::EpisodesForDifference(power.only_first, power.only_second, power.power),
      power.bound, experiment::EpisodesForBound(power.bound));
}

void AddOptions(CLI::App& command, Power& power) {
  command
      .add_option("--only-first", power.only_first,
                  "share of start states from which only the first method fails")
      ->check(dfr::apps::ShareIn("[0, 1]"))
      ->capture_default_str();
  command
      .add_option("--only-second", power.only_second,
                  "share of start states from which only the second method fails")
      ->check(dfr::apps::ShareIn("[0, 1]"))
      ->capture_default_str();
  command.add_option("--power", power.power, "probability of finding the difference")
      ->check(dfr::apps::kShare)
      ->capture_default_str();
  command.add_option("--bound", power.bound, "share of collisions to be excluded")
      ->check(dfr::apps::kShare)
      ->capture_default_str();
}

void CompareAndPrint(const Comparison& comparison) {
  const experiment::SequentialTest test = Compare(comparison);
  const auto condition = std::ranges::find(Conditions(), comparison.condition, &Condition::name);
  const auto pairs = static_cast<long long>(test.pairs());
  std::printf("%s: %s, %d demonstrations, %d alternating trials, seed %llu, commit %s\n",
              comparison.task.c_str(), comparison.condition.c_str(),
              condition->CountOr(comparison.demonstrations), comparison.trials,
              static_cast<unsigned long long>(comparison.seed),
              std::string(core::BuildCommit()).c_str());
  std::printf("credit of %s less that of %s, mean of %lld pairs: %+.3f (p %.2g at all times)\n",
              comparison.first.c_str(), comparison.second.c_str(), pairs, test.mean(),
              test.p_value());
  if (test.settled()) {
    std::printf("decided at %g after %lld of at most %d pairs: %lld episodes saved\n",
                comparison.alpha, pairs, comparison.pairs, 2 * (comparison.pairs - pairs));
  } else {
    std::printf("not decided at %g: no episodes saved\n", comparison.alpha);
  }
}

void AddOptions(CLI::App& command, Comparison& comparison) {
  command.add_option("--task", comparison.task, "task: a name that `study stress --tasks` takes")
      ->check(ReadBy(MakeTask))
      ->capture_default_str();
  command.add_option("--condition", comparison.condition, "condition, by its name in the table")
      ->check(ReadBy(CheckCondition))
      ->capture_default_str();
  const auto method = ReadBy([](const std::string& name) { return ParseMethod(name); });
  command.add_option("--first", comparison.first, MethodHelp())
      ->check(method)
      ->capture_default_str();
  command.add_option("--second", comparison.second, "second method")
      ->check(method)
      ->capture_default_str();
  command
      .add_option("--demonstrations", comparison.demonstrations,
                  "number of demonstrations of each trial")
      ->check(dfr::apps::kModelDemonstrations)
      ->capture_default_str();
  command
      .add_option(
          "--trials", comparison.trials,
          "number of trials, each with separate demonstrations and policies; they take turns")
      ->check(dfr::apps::kCount)
      ->capture_default_str();
  command.add_option("--pairs", comparison.pairs, "largest number of pairs of episodes")
      ->check(dfr::apps::kCount)
      ->capture_default_str();
  command.add_option("--alpha", comparison.alpha, "probability of a wrong decision")
      ->check(dfr::apps::kShare)
      ->capture_default_str();
  command
      .add_option(
          "--halted", comparison.credit.halted,
          "credit of an episode that halts at the last demonstrated time step; an earlier halt "
          "reduces the credit in proportion; a completed episode has the credit 1, a collided one "
          "0")
      ->check(dfr::apps::ShareIn("[0, 1]"))
      ->capture_default_str();
  command.add_option("--seed", comparison.seed, "random seed")->capture_default_str();
}

void DetectAndPrint(const Detection& detection) {
  const DetectionReport report = Detect(LoadDetection(detection), detection);
  std::cout << report.text;
  Print({report.table}, 1);
}

int Main(int argc, char** argv) {
  CLI::App app("Compares policies, controllers and guards in the tasks of all programs.", "study");
  dfr::apps::AddVersion(app);
  app.require_subcommand(1);
  auto* list = app.add_subcommand("list", "List the tasks of the gallery");
  Study guards = Study::OfGuards();
  bool causes = false;
  auto* run = app.add_subcommand(
      "run", "Run guards with default settings around every policy, from the same start states");
  Study stress;
  auto* stress_command =
      app.add_subcommand("stress", "Run every controller around every policy under disturbances");
  Study grid;
  grid.out = "out/grid";
  grid.tasks = {"pusher", "planar-corridor", "planar-push"};
  grid.conditions = {"as demonstrated", "turned 40 deg"};
  grid.controllers.clear();
  for (const std::string_view support : kSupports) {
    for (const char* controller : {"early-stopping", "dfr", "controller", "certified"}) {
      grid.controllers.push_back(std::string(controller) + "/" + std::string(support));
    }
  }
  auto* grid_command = app.add_subcommand(
      "grid", "Run every support with every controller, to separate the effects of both");
  Study plane = Study::OfPlane();
  auto* experiment = app.add_subcommand(
      "experiment",
      "Run controllers, also the certified one, around a polynomial policy in the plane");
  Study drift = plane;
  drift.controllers = {"dfr", "controller", "lwr"};
  drift.conditions = {"as demonstrated",  "turned 10 deg",     "turned 20 deg",
                      "turned 40 deg",    "scaled 0.2",        "scaled 0.4",
                      "biased 0.1",       "biased 0.2",        "states noisy 0.5 %",
                      "states noisy 2 %", "10 demonstrations", "20 demonstrations",
                      "40 demonstrations"};
  auto* drift_command = app.add_subcommand(
      "drift", "Run the experiment also under disturbances and with few demonstrations");
  auto* ablate = app.add_subcommand(
      "ablate", "Run the experiment without each part of the controller, one at a time");
  Study ablated = plane;
  AddChoices(*ablate, ablated);
  planar::AddGamma(*ablate, ablated.plane);
  ablate->add_option("--seed", ablated.seed, "random seed")->capture_default_str();
  ablate->add_option("--threads", ablated.threads, "number of threads; 0: one per core")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  for (CLI::App* command : {run, experiment, drift_command, ablate}) {
    command->add_flag("--causes", causes, "print why episodes were not completed");
  }
  AddOptions(*experiment, plane);
  AddOptions(*drift_command, drift);
  AddOptions(*run, guards);
  run->add_option("--pictures", guards.pictures.features,
                  "features of image, such as points:image, for methods guard/pictures and others, "
                  "which receive a picture of the state; the policy receives the state")
      ->check(ReadBy([](const std::string& features) {
        reduction::StateReduction::CheckFeatures(PictureLayout(), features);
      }));
  run->add_option("--picture-light", guards.pictures.shown.light,
                  "change of light in the demonstrations' pictures, as a share")
      ->check(dfr::apps::ShareIn("[0, 1]"))
      ->capture_default_str();
  run->add_option("--picture-noise", guards.pictures.shown.noise,
                  "noise of the demonstrations' pictures, as a share of 255")
      ->check(dfr::apps::ShareIn("[0, 1]"))
      ->capture_default_str();
  AddOptions(*stress_command, stress);
  AddOptions(*grid_command, grid);
  auto* compare = app.add_subcommand(
      "compare",
      "Compare two methods from the same start states until their difference is significant");
  Comparison comparison;
  AddOptions(*compare, comparison);
  auto* power_command = app.add_subcommand(
      "power", "Compute the number of episodes that a comparison or a bound needs");
  Power power;
  AddOptions(*power_command, power);
  Study shown = Study::OfGuards();
  shown.policies = {"weak"};
  shown.controllers = GuardNames();
  std::string entries;
  std::filesystem::path page = "gallery.html";
  int count = 5;
  std::string shown_task;
  auto* picture =
      app.add_subcommand("picture", "Write a page with paths of one task of the gallery");
  picture->add_option("task", shown_task, "task, by its name in `study list`")
      ->check(ReadBy(dfr::sim::FindGalleryTask))
      ->required();
  picture->add_option("--policy", shown.policies, "policy to guard: " + Join(PolicyNames()))
      ->check(ReadBy([](const std::string& name) { CheckPolicy(Kind::kGuards, name); }))
      ->expected(1)
      ->capture_default_str();
  picture
      ->add_option("--methods", shown.controllers,
                   "methods, in addition to the policy alone: strategies of guards")
      ->delimiter(',')
      ->check(ReadBy([](const std::string& name) { CheckController(Kind::kGuards, name, false); }))
      ->capture_default_str();
  picture->add_option("--entries", entries,
                      "two entries of the state, tip or box[0:2]; default: the first two");
  picture->add_option("--count", count, "number of demonstrations, and of episodes of each method")
      ->check(dfr::apps::kDemonstrations)
      ->capture_default_str();
  picture->add_option("--seed", shown.seed, "random seed")->capture_default_str();
  dfr::core::WritesFile(picture->add_option("--out", page, "file of the page"))
      ->capture_default_str();
  Commands commands;
  planar::AddProof(app, commands);
  planar::AddCoverage(app, commands);
  planar::AddCertificate(app, commands);
  planar::AddFigure(app, commands);
  auto* detect = app.add_subcommand(
      "detect", "Compare the guard's alarms with other detectors, on a file or in a task");
  Detection detection;
  AddOptions(*detect, detection);
  dfr::core::AddExamples(
      app, {{"list", {""}},
            {"run", {"--tasks reach,push --trials 2 --episodes 20 --out out/guards"}},
            {"stress", {"--tasks planar-corridor --controllers controller,dfr --out out/stress"}},
            {"grid", {"--tasks planar-corridor --trials 2 --episodes 20"}},
            {"experiment", {"--trials 4 --episodes 50 --causes"}},
            {"drift", {"--trials 2 --episodes 20 --methods dfr,controller"}},
            {"ablate", {"--trials 2 --episodes 20"}},
            {"compare", {"--task pusher --first controller --second dfr"}},
            {"power", {"--only-first 0.02 --only-second 0.05"}},
            {"picture", {"reach --out reach.html"}},
            {"prove", {"--steps 10000", "--mutations"}},
            {"coverage", {"--demonstrations 20,60 --fits 50"}},
            {"certificate", {"--task corridor"}},
            {"figure", {"--task push --methods baseline,controller --out planar"}},
            {"detect", {"demos.hdf5 --failures failed.hdf5", "--task pick"}}});
  const auto code = dfr::experiment::Parse(app, argc, argv, {".html", ".mp4", ".webm"});
  if (code) return *code;

  if (*list) List();
  if (*run) RunAndPrint(guards, false, causes);
  if (*stress_command) RunAndPrint(stress, false, false);
  if (*grid_command) RunAndPrint(grid, true, false);
  if (*experiment) RunAndPrint(plane, false, causes);
  if (*drift_command) RunAndPrint(drift, false, causes);
  if (*ablate) Ablate(ablated, causes);
  if (*compare) CompareAndPrint(comparison);
  if (*power_command) PrintPower(power);
  if (*picture) {
    shown.tasks = {shown_task};
    const dfr::sim::GalleryTask& task = dfr::sim::FindGalleryTask(shown_task);
    SavePicture(RecordStudy(shown, count), task, entries, page);
  }
  if (*detect) DetectAndPrint(detection);
  for (const auto& [command, run_it] : commands) {
    if (*command) run_it();
  }
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace dfr::study

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("study", argc, argv, dfr::study::Main);
}
