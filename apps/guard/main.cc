// A guard around any policy, from any demonstrations: check, fit, report, evaluate, export.
#include <CLI/CLI.hpp>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <string>

#include "apps/command_line.h"
#include "commands.h"
#include "dfr/core/build_info.h"

namespace dfr::apps::guard {
namespace {

template <typename Options>
void AddDemonstrations(CLI::App& command, Options& options) {
  command
      .add_option("DEMOS", options.demonstrations,
                  "robomimic's HDF5 file, or the folder of a Minari or LeRobot dataset")
      ->required();
  command.add_option(
      "--filter-key", options.filter_key,
      "only the episodes that this key names: a mask of robomimic's file, a split of "
      "LeRobot's dataset");
}

void AddGuard(CLI::App& command, std::filesystem::path& path) {
  command.add_option("GUARD", path, "file that guard fit wrote")->required();
}

void AddCheck(CLI::App& app, int& result) {
  const auto options = std::make_shared<CheckOptions>();
  CLI::App* command = app.add_subcommand(
      "check",
      "what is wrong with demonstrations: shapes, NaN, dead or doubled entries, alignment, actions "
      "that are positions");
  AddDemonstrations(*command, *options);
  command
      ->add_option("--action-limit", options->action_limit,
                   "entries of actions beyond +- this are reported")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option(
      "--repair", options->repair,
      "write all episodes that can be read to this .hdf5 file: what a killed writer "
      "or a damaged disk left");
  command->callback(
      [options, &result] { result = RunCheck(*options) ? EXIT_SUCCESS : EXIT_FAILURE; });
}

void AddConvert(CLI::App& app) {
  const auto options = std::make_shared<ConvertOptions>();
  CLI::App* command = app.add_subcommand(
      "convert", "LeRobot's or Minari's format to robomimic's, or any to Minari's");
  AddDemonstrations(*command, *options);
  command
      ->add_option("OUT", options->out,
                   "a .hdf5 file: robomimic's format; otherwise the folder of a Minari dataset")
      ->required();
  command->add_option("--id", options->id,
                      "of the Minari dataset, namespace/name-v0; by default from its folder");
  command->add_flag("--differences", options->differences,
                    "actions that are target positions become increments: target minus position");
  command->callback([options] { RunConvert(*options); });
}

void AddFit(CLI::App& app, int& result) {
  const auto options = std::make_shared<FitOptions>();
  CLI::App* command = app.add_subcommand("fit", "learn a guard from demonstrations");
  AddDemonstrations(*command, *options);
  command->add_option("-o,--out", options->out, "the file")->capture_default_str();
  command->add_option("-f,--features", options->guard.features,
                      "what it looks at: parts of the state, as in obs/object,obs/tip[0:2]; all "
                      "without this. Leave out what the robot cannot influence, and joint angles "
                      "where the tool's pose says the same");
  command
      ->add_option(
          "--strategy", options->strategy,
          "who drives: guard (the policy, corrected at the boundary), controller (the "
          "demonstrations; for a bad policy or none), dfr (the policy, recovery as published), "
          "early-stopping (the policy, halts at the boundary), monitor (the policy, alarms alone), "
          "certified (what provably raises no alarm, see docs/certificates.md)")
      ->capture_default_str();
  command
      ->add_option("--nu", options->guard.support.svm.nu,
                   "bound on the outliers of each support, in (0, 1]")
      ->capture_default_str();
  command
      ->add_option(
          "--gamma", options->guard.support.svm.gamma,
          "width of the kernel, in whitened units that all tasks share: larger is tighter; made "
          "larger where supports take the room between two ways for demonstrated")
      ->capture_default_str();
  command
      ->add_option("--false-alarms", options->guard.false_alarms,
                   "demonstrations that may raise an alarm")
      ->capture_default_str();
  command
      ->add_option("--confidence", options->guard.confidence,
                   "of --false-alarms for this very fit; 0: on average over fits")
      ->capture_default_str();
  command
      ->add_option("--hold-out", options->guard.hold_out,
                   "share of the demonstrations that nothing is fitted to: what the alarm and the "
                   "certificate promise is then exact; 0: none, and approximate")
      ->capture_default_str();
  command
      ->add_option("--error-factor", options->guard.error_factor,
                   "of strategy certified: how much further J may be off than in demonstrations")
      ->capture_default_str();
  command
      ->add_option("--horizon", options->guard.horizon,
                   "actions of the policy in an episode; 0: twice the longest demonstration")
      ->capture_default_str();
  command
      ->add_option(
          "--action-limit", options->guard.action_limit,
          "each entry of an action is kept within +- this: one limit for all, or one each, a,b,c; "
          "default: 1.5 times the largest demonstrated value of each entry")
      ->delimiter(',');
  command->add_flag("--all", options->all, "episodes that did not complete the task count, too");
  command->add_flag("--as-recorded", options->as_recorded,
                    "take actions as they are, although they look like target positions");
  command->add_flag("--accept-any", options->guard.accept_any,
                    "fit even where next to no state of left-out demonstrations is inside");
  command->add_flag("--strict", options->strict,
                    "exit with status 3 if something speaks against the guard");
  command->callback([options, &result] {
    constexpr int kSpokenAgainst = 3;
    if (!RunFit(*options)) result = kSpokenAgainst;
  });
}

void AddShow(CLI::App& app) {
  const auto path = std::make_shared<std::filesystem::path>();
  CLI::App* command = app.add_subcommand("show", "what a guard's file holds");
  AddGuard(*command, *path);
  command->callback([path] {
    const auto model = safety::GuardModel::Load(*path);
    Describe(*model);
    Describe(safety::Warnings(*model));
  });
}

void AddReport(CLI::App& app) {
  const auto options = std::make_shared<ReportOptions>();
  CLI::App* command = app.add_subcommand(
      "report", "a page: how far episodes stay inside, false alarms, lead times, features");
  AddGuard(*command, options->guard);
  AddDemonstrations(*command, *options);
  command->add_option("--failures", options->failures,
                      "episodes that went wrong: how long before their end alarms come");
  command->add_option("-o,--out", options->out, "the page")->capture_default_str();
  command->callback([options] { RunReport(*options); });
}

void AddEvaluate(CLI::App& app) {
  const auto options = std::make_shared<EvaluateOptions>();
  CLI::App* command = app.add_subcommand(
      "evaluate", "replay episodes: when the guard would first change an action, and its time");
  AddGuard(*command, options->guard);
  AddDemonstrations(*command, *options);
  command->callback([options] { RunEvaluate(*options); });
}

void AddExport(CLI::App& app) {
  const auto options = std::make_shared<ExportOptions>();
  CLI::App* command = app.add_subcommand("export", "g for other tools");
  AddGuard(*command, options->guard);
  command->add_option("--onnx", options->onnx, "one ONNX file: time step and whole state to g");
  command->add_option(
      "--libsvm", options->libsvm,
      "a folder: one LIBSVM model per time step, and how states become its features");
  command->callback([options] { RunExport(*options); });
}

int Main(int argc, char** argv) {
  CLI::App app(
      "Keeps what a policy does inside what was demonstrated. A guard is learned from "
      "demonstrations\n"
      "in robomimic's, Minari's or LeRobot's files and stored in one file, which C++ and Python "
      "load:\n\n"
      "  guard check demos.hdf5\n"
      "  guard fit demos.hdf5 --features obs/object,obs/robot0_eef_pos -o task.guard\n"
      "  guard report task.guard demos.hdf5 -o report.html",
      "guard");
  app.set_version_flag("--version",
                       std::string(core::BuildVersion()) + " (" + core::BuildCommit() + ")");
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);
  int result = EXIT_SUCCESS;
  AddCheck(app, result);
  AddConvert(app);
  AddFit(app, result);
  AddShow(app);
  AddReport(app);
  AddEvaluate(app);
  AddExport(app);
  dfr::apps::CheckNumbers(app);
  CLI11_PARSE(app, argc, argv);
  return result;
}

}  // namespace
}  // namespace dfr::apps::guard

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  return dfr::apps::guard::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "guard: " << e.what() << '\n';
  return EXIT_FAILURE;
}
