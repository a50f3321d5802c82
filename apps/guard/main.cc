// Program guard: checks demonstrations, fits guards, and reports on, evaluates and exports them.
#include <CLI/CLI.hpp>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>

#include "apps/command_line.h"
#include "commands.h"
#include "dfr/core/text/format.h"

namespace dfr::apps::guard {

void Print(const char* format, ...) {
  std::va_list arguments;
  va_start(arguments, format);
  const std::string text = core::Printable(core::FormatList(format, arguments));
  va_end(arguments);
  std::fputs(text.c_str(), stdout);
}

namespace {

template <typename Options>
void AddDemonstrations(CLI::App& command, Options& options) {
  command
      .add_option("DEMOS", options.demonstrations,
                  "HDF5 file of robomimic, or folder of a Minari or LeRobot dataset")
      ->required();
  command.add_option("--filter-key", options.filter_key,
                     "only the episodes of this key: a mask of robomimic's file, a split of "
                     "LeRobot's dataset");
}

void AddGuard(CLI::App& command, std::filesystem::path& path) {
  command.add_option("GUARD", path, "file written by guard fit")->required();
}

void AddCheck(CLI::App& app, int& result) {
  const auto options = std::make_shared<CheckOptions>();
  CLI::App* command = app.add_subcommand("check",
                                         "Find errors in demonstrations: shapes, NaN, constant or "
                                         "doubled entries, misalignment, positions as actions");
  AddDemonstrations(*command, *options);
  command
      ->add_option("--action-limit", options->action_limit,
                   "report entries of actions with a larger magnitude than this")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  core::Writes(command->add_option("--repair", options->repair,
                                   "write all readable episodes to this .hdf5 file, if a writer "
                                   "was killed or the disk is damaged"),
               [](const std::filesystem::path& path) {
                 const std::string fault = core::UnwritableFile(path);
                 if (!fault.empty() || path.extension() == ".hdf5") return fault;
                 return path.string() + ": the name must end in .hdf5";
               });
  command->callback(
      [options, &result] { result = RunCheck(*options) ? EXIT_SUCCESS : EXIT_FAILURE; });
}

void AddConvert(CLI::App& app) {
  const auto options = std::make_shared<ConvertOptions>();
  CLI::App* command = app.add_subcommand(
      "convert", "Convert LeRobot's or Minari's format to robomimic's, or any format to Minari's");
  AddDemonstrations(*command, *options);
  core::Writes(command->add_option(
                   "OUT", options->out,
                   "output: a .hdf5 file in robomimic's format, or the folder of a Minari dataset"),
               [](const std::filesystem::path& path) {
                 return path.extension() == ".hdf5" ? core::UnwritableFile(path)
                                                    : core::UnwritableFolder(path);
               })
      ->required();
  command->add_option("--id", options->id,
                      "id of the Minari dataset, namespace/name-v0; by default from its folder");
  command->add_flag(
      "--differences", options->differences,
      "convert actions that are target positions to increments: target minus position");
  command->callback([options, command] {
    if (command->count("--id") > 0 && options->out.extension() == ".hdf5") {
      throw CLI::ValidationError("--id: applies only to the folder of a Minari dataset, not to " +
                                 options->out.string());
    }
    RunConvert(*options);
  });
}

void AddFit(CLI::App& app, int& result) {
  const auto options = std::make_shared<FitOptions>();
  CLI::App* command = app.add_subcommand("fit", "Learn a guard from demonstrations");
  AddDemonstrations(*command, *options);
  core::WritesFile(command->add_option("-o,--out", options->out, "file of the guard"))
      ->capture_default_str();
  command->add_option(
      "-f,--features", options->guard.features,
      "features: parts of the state, as in obs/object,obs/tip[0:2]; default: all. Leave out parts "
      "that the robot cannot influence, and joint angles if the tool's pose is a feature. "
      "points:obs/image[:K][:grey][:HxW][:light=none|gain|standard] stands for positions in a "
      "picture or a video of LeRobot, pca:obs/embedding[:K] for principal components of "
      "another large part, and slow: for "
      "the components that change slowly; without K the fit chooses their number");
  command
      ->add_option(
          "--strategy", options->strategy,
          "source of the actions: guard (the policy, corrected at the boundary), controller (the "
          "demonstrations; for a bad policy or none), dfr (the policy, recovery as published), "
          "early-stopping (the policy, halts at the boundary), monitor (the policy, only alarms), "
          "certified (actions that provably raise no alarm, see docs/certificates.md)")
      ->check(ReadBy(safety::ParseStrategy))
      ->capture_default_str();
  command
      ->add_option("--nu", options->guard.support.svm.nu,
                   "upper bound on the share of outliers of each support, in (0, 1]")
      ->check(dfr::apps::ShareIn("(0, 1]"))
      ->capture_default_str();
  command
      ->add_option("--gamma", options->guard.support.svm.gamma,
                   "parameter gamma of the kernel, in whitened units that all tasks share: larger "
                   "is tighter; increased if a support contains the gap between two modes")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      ->add_option("--false-alarms", options->guard.false_alarms,
                   "share of demonstrations that may raise an alarm")
      ->check(dfr::apps::kShare)
      ->capture_default_str();
  command
      ->add_option("--confidence", options->guard.confidence,
                   "confidence that this fit keeps --false-alarms; 0: on average over fits")
      ->check(dfr::apps::ShareIn("[0, 1)"))
      ->capture_default_str();
  command
      ->add_option("--hold-out", options->guard.hold_out,
                   "share of the demonstrations to leave out of the fit: the bounds of alarm and "
                   "certificate are then exact; 0: none, the bounds are approximate")
      ->check(CLI::Range(0.0, 0.5))
      ->capture_default_str();
  command
      ->add_option(
          "--error-factor", options->guard.error_factor,
          "for strategy certified: factor by which J may be less accurate than in demonstrations")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command
      ->add_option("--horizon", options->guard.horizon,
                   "largest number of the policy's actions in an episode; 0: twice the longest "
                   "demonstration")
      ->check(CLI::Range(0, dfr::safety::GuardOptions::kLongestHorizon))
      ->capture_default_str();
  command
      ->add_option(
          "--action-limit", options->guard.action_limit,
          "limit of the magnitude of each entry of an action: one for all, or one each, a,b,c; "
          "default: 1.5 times the largest demonstrated value of each entry")
      ->check(dfr::apps::kNotNegative)
      ->delimiter(',');
  command->add_flag("--all", options->all, "include episodes that did not complete the task");
  command->add_flag("--as-recorded", options->as_recorded,
                    "use actions as recorded, even if they look like target positions");
  command->add_flag("--accept-any", options->guard.accept_any,
                    "fit even if almost no state of left-out demonstrations is inside");
  command->add_flag("--strict", options->strict,
                    "exit with status 3 if there is a warning about the guard");
  command->callback([options, &result] {
    constexpr int kSpokenAgainst = 3;
    if (!RunFit(*options)) result = kSpokenAgainst;
  });
}

void AddShow(CLI::App& app) {
  const auto path = std::make_shared<std::filesystem::path>();
  CLI::App* command = app.add_subcommand("show", "Describe a guard's file");
  AddGuard(*command, *path);
  command->callback([path] {
    const auto model = LoadGuard(*path);
    Describe(*model);
    Describe(safety::Warnings(*model));
  });
}

void AddReport(CLI::App& app) {
  const auto options = std::make_shared<ReportOptions>();
  CLI::App* command = app.add_subcommand(
      "report", "Write a page with levels, false alarms, lead times and influential features");
  AddGuard(*command, options->guard);
  AddDemonstrations(*command, *options);
  command->add_option("--failures", options->failures,
                      "episodes that failed: adds the time from their first alarm to their end");
  core::WritesFile(command->add_option("-o,--out", options->out, "file of the page"))
      ->capture_default_str();
  command->callback([options] { RunReport(*options); });
}

void AddEvaluate(CLI::App& app) {
  const auto options = std::make_shared<EvaluateOptions>();
  CLI::App* command = app.add_subcommand(
      "evaluate", "Replay episodes: first action that the guard would change, and time per call");
  AddGuard(*command, options->guard);
  AddDemonstrations(*command, *options);
  command->callback([options] { RunEvaluate(*options); });
}

void AddExport(CLI::App& app) {
  const auto options = std::make_shared<ExportOptions>();
  CLI::App* command =
      app.add_subcommand("export", "Export the decision function g for other tools");
  AddGuard(*command, options->guard);
  core::WritesFile(command->add_option(
      "--onnx", options->onnx, "ONNX file with the function from time step and state to g"));
  core::Writes(
      command->add_option("--libsvm", options->libsvm,
                          "folder with one LIBSVM model per time step, and the transformation of "
                          "states to its features"),
      UnusableExportFolder);
  command->callback([options] {
    if (options->onnx.empty() && options->libsvm.empty()) {
      throw CLI::ValidationError("export needs --onnx FILE or --libsvm FOLDER");
    }
    RunExport(*options);
  });
}

int Main(int argc, char** argv) {
  CLI::App app(
      "Keeps a learned policy near its demonstrations. A guard is learned from "
      "demonstrations\n"
      "in robomimic's, Minari's or LeRobot's files and stored in one file, which C++ and Python "
      "load:\n\n"
      "  guard check demos.hdf5\n"
      "  guard fit demos.hdf5 --features obs/object,obs/robot0_eef_pos -o task.guard\n"
      "  guard report task.guard demos.hdf5 -o report.html",
      "guard");
  apps::AddVersion(app);
  app.require_subcommand(1);
  int result = EXIT_SUCCESS;
  AddCheck(app, result);
  AddConvert(app);
  AddFit(app, result);
  AddShow(app);
  AddReport(app);
  AddEvaluate(app);
  AddExport(app);
  core::AddExamples(app,
                    {{"check", {"demos.hdf5", "damaged.hdf5 --repair demos.hdf5"}},
                     {"convert", {"lerobot_dataset demos.hdf5", "demos.hdf5 my/task-v0"}},
                     {"fit",
                      {"demos.hdf5 -o task.guard",
                       "demos.hdf5 --features obs/object,obs/robot0_eef_pos --hold-out 0.2",
                       "lerobot_dataset -f points:observation.images.top,observation.state"}},
                     {"show", {"task.guard"}},
                     {"report", {"task.guard demos.hdf5 --failures failed.hdf5 -o report.html"}},
                     {"evaluate", {"task.guard demos.hdf5"}},
                     {"export", {"task.guard --onnx task.onnx", "task.guard --libsvm models"}}});
  return Parse(app, argc, argv).value_or(result);
}

}  // namespace
}  // namespace dfr::apps::guard

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("guard", argc, argv, dfr::apps::guard::Main);
}
