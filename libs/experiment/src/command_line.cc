#include "dfr/experiment/command_line.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <utility>

#include "configuration.h"
#include "dfr/core/text/command_line.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/status.h"
#include "ledger/ledger_file.h"

namespace dfr::experiment {
namespace {

using Arguments = std::vector<std::string>;

constexpr const char* kConfiguration = "run.toml";
constexpr const char* kLedger = "ledger.jsonl";
constexpr int kUsage = 2;  // exit code of a usage error

// Returns the ledgers of the folders. A folder without a ledger contributes its shards' ledgers.
std::vector<std::filesystem::path> LedgersIn(const std::vector<std::filesystem::path>& folders) {
  std::vector<std::filesystem::path> ledgers;
  for (const std::filesystem::path& folder : folders) {
    if (std::filesystem::is_regular_file(folder / kLedger)) {
      ledgers.push_back(folder / kLedger);
      continue;
    }
    std::vector<std::filesystem::path> below;
    if (std::filesystem::is_directory(folder)) {
      for (const auto& entry : std::filesystem::directory_iterator(folder)) {
        if (std::filesystem::is_regular_file(entry.path() / kLedger)) {
          below.push_back(entry.path() / kLedger);
        }
      }
    }
    if (below.empty()) {
      throw std::runtime_error(folder.string() + ": contains no " + kLedger +
                               ", nor do the folders in it; name the --out of a run");
    }
    std::ranges::sort(below);
    ledgers.insert(ledgers.end(), below.begin(), below.end());
  }
  return ledgers;
}

// Returns the arguments that repeat an episode of the run in `folder`.
Arguments RerunOf(const std::filesystem::path& folder, const Rerun& rerun) {
  static_cast<void>(LedgersIn({folder}));
  const std::filesystem::path configuration = folder / kConfiguration;
  Arguments arguments = {internal::CommandOf(configuration),
                         "--config",
                         configuration.string(),
                         "--out",
                         folder.string(),
                         "--rerun-episode=" + rerun.episode};
  for (const std::string& method : rerun.methods) arguments.push_back("--rerun-with=" + method);
  if (!rerun.film.empty()) arguments.push_back("--rerun-film=" + rerun.film.string());
  return arguments;
}

// Merges the ledgers and returns the arguments that write summary and report.
Arguments Merge(const std::vector<std::filesystem::path>& folders,
                const std::filesystem::path& out) {
  std::vector<std::filesystem::path> ledgers = LedgersIn(folders);
  const std::filesystem::path configuration = ledgers.front().parent_path() / kConfiguration;
  std::filesystem::path kept = std::filesystem::absolute(configuration);
  const std::string command = internal::CommandOf(configuration);
  std::filesystem::create_directories(out);
  {
    const internal::Descriptor lock = internal::OpenLocked(out / "lock");
    const std::filesystem::path whole = out / kLedger;
    // An existing ledger is also merged or rejected; it is never lost.
    if (std::filesystem::exists(whole) && std::filesystem::file_size(whole) > 0) {
      ledgers.push_back(whole);
    }
    MergeLedgers(ledgers, whole);
  }
  return {command, "--config", kept.string(), "--out", out.string()};
}

struct Added {
  CLI::App* merge = nullptr;
  CLI::App* status = nullptr;
  CLI::App* episodes = nullptr;
  CLI::App* rerun = nullptr;
  std::vector<std::filesystem::path> folders;
  std::filesystem::path out;
  bool json = false;
  EpisodeFilter filter;
  int most = 20;
  std::filesystem::path run;
  Rerun again;
};

// Converts an invalid argument of an option to a usage error.
template <typename Parser>
auto Checked(Parser parse, const std::string& text) {
  try {
    return parse(text);
  } catch (const std::invalid_argument& e) {
    throw CLI::ValidationError(e.what());
  }
}

void Add(CLI::App& app, Added& added, const std::vector<std::string>& film_endings) {
  added.merge = app.add_subcommand("merge", "Merge shards into one ledger, summary and report");
  added.merge
      ->add_option("folders", added.folders, "folders of shards, or folders that contain shards")
      ->required();
  core::WritesFolder(added.merge->add_option("--out", added.out, "folder for the merged run"))
      ->required();
  added.status = app.add_subcommand("status", "Print the progress of runs");
  added.status
      ->add_option("folders", added.folders, "folders of runs, or folders that contain runs")
      ->required();
  added.status->add_flag("--json", added.json, "print JSON");
  added.episodes = app.add_subcommand("episodes", "List the ids of episodes, worst first");
  added.episodes->add_option("folder", added.folders, "folder of a run")->required()->expected(1);
  added.episodes->add_option("--method", added.filter.method, "only this method");
  added.episodes->add_option("--learner", added.filter.learner, "only this learner");
  added.episodes
      ->add_option("--demonstrations", added.filter.demonstrations,
                   "only this number of demonstrations")
      ->check(core::MustNotBeNegative);
  added.episodes
      ->add_option("--outcome", added.filter.outcomes,
                   "only these outcomes: completed, halted, collided")
      ->delimiter(',')
      ->check(CLI::IsMember({"completed", "halted", "collided"}));
  added.episodes->add_option("--cause", added.filter.cause, "only this cause");
  added.episodes->add_option_function<std::string>(
      "--against",
      [&added](const std::string& text) { added.filter.against = Checked(ParsePartner, text); },
      "METHOD=OUTCOME: only start states from which METHOD had this outcome");
  added.episodes->add_option("--most", added.most, "maximum number of lines; 0: all")
      ->check(core::MustNotBeNegative)
      ->capture_default_str();
  added.rerun = app.add_subcommand(
      "rerun", "Run one episode again, and other methods from the same start state");
  added.rerun->add_option("folder", added.run, "folder of the run")->required();
  added.rerun->add_option("episode", added.again.episode, "id that the command episodes prints")
      ->required()
      ->check([](const std::string& id) { return id.empty() ? "'' is not an episode id" : ""; });
  added.rerun->add_option("--methods", added.again.methods, "methods of the run to compare with")
      ->delimiter(',');
  core::WritesFile(
      added.rerun->add_option("--film", added.again.film, "file to draw the episodes to"),
      film_endings, /*makes_folders=*/true);
}

void ParseArguments(CLI::App& app, Arguments arguments) {
  internal::ForgetGivenValues();
  std::ranges::reverse(arguments);  // CLI11 expects reverse order
  app.parse(std::move(arguments));
}

}  // namespace

void AddExperimentOptions(CLI::App& command, ExperimentOptions& options, const std::string& presets,
                          const std::string& methods, const std::vector<std::string>& names) {
  command.add_option("--preset", options.preset, presets)
      ->check(CLI::IsMember(names))
      ->capture_default_str();
  AddRunOptions(command, options);
  command.add_flag("!--no-video", options.video, "write no videos");
  command.add_option("--methods", options.methods, methods)->delimiter(',');
  // A zero would select the preset's number.
  command.add_option("--trials", options.trials, "independent repetitions")
      ->check(core::MustBePositive);
  command.add_option("--episodes", options.episodes, "start states per trial and data point")
      ->check(core::MustBePositive);
}

void AddRunOptions(CLI::App& command, ExperimentOptions& options) {
  core::WritesFolder(
      command.add_option("--out", options.out, "folder for the ledger and the results"))
      ->capture_default_str();
  command.add_option("--seed", options.seed, "random seed")->capture_default_str();
  command.add_option("--threads", options.threads, "0: one per core; the results are the same")
      ->check(core::MustNotBeNegative)
      ->capture_default_str();
  command
      .add_option_function<std::string>(
          "--shard",
          [&options](const std::string& text) { options.shard = Checked(ParseShard, text); },
          "K/N: run only part K of N; merge the parts afterwards")
      ->default_str("1/1");
  command
      .add_option_function<std::string>(
          "--config",
          [&command](const std::string& file) { internal::ReadConfiguration(file, command); },
          "options as in the run.toml of an earlier run; the command line takes precedence")
      ->type_name("FILE");
  command.add_flag("--restart", options.restart,
                   "discard an interrupted run in --out instead of resuming it");
  command.add_flag("--salvage", options.salvage,
                   "move damaged lines of the ledger to a separate file and run them again");
  // Used by RerunOf(); users call the command rerun.
  command.add_option("--rerun-episode", options.rerun.episode)->group("");
  command.add_option("--rerun-with", options.rerun.methods)->group("");
  command.add_option("--rerun-film", options.rerun.film)->group("");
  // Several commands may share `options`: run.toml contains the command that was called.
  options.configuration = [&command, others = options.configuration] {
    return command.parsed() || !others ? internal::Resolve(command) : others();
  };
}

std::optional<int> Parse(CLI::App& app, int argc, const char* const* argv,
                         const std::vector<std::string>& film_endings) {
  if (app.get_name().empty()) app.name(std::filesystem::path(argv[0]).filename().string());
  const Arguments arguments(argv + 1, argv + argc);
  Added added;
  Add(app, added, film_endings);
  const std::string film = " --methods baseline --film film" + film_endings.front();
  core::AddExamples(app, {{"merge", {"out/shards --out out/whole"}},
                          {"status", {"out/shards", "out/shards --json"}},
                          {"episodes", {"out/whole --method dfr --outcome collided --most 0"}},
                          {"rerun", {"out/whole ID" + film}}});
  try {
    internal::KeepGivenValues(app);
    // CheckArguments() adds transforms that run before the transforms of KeepGivenValues(). Without
    // this call, run.toml would contain leading zeros.
    core::CheckArguments(app, arguments);
    core::RefuseAmbiguous<CLI::ValidationError>(app, arguments);
    ParseArguments(app, arguments);
    if (added.merge->parsed()) {
      ParseArguments(app, Merge(added.folders, added.out));
    } else if (added.status->parsed()) {
      const std::vector<Status> statuses = StatusesOf(added.folders);
      std::cout << (added.json ? ToJson(statuses) : ToText(statuses));
      return EXIT_SUCCESS;
    } else if (added.episodes->parsed()) {
      PrintEpisodes(LedgersIn(added.folders), added.filter, added.most, std::cout);
      return EXIT_SUCCESS;
    } else if (added.rerun->parsed()) {
      ParseArguments(app, RerunOf(added.run, added.again));
    }
  } catch (const CLI::ParseError& e) {
    if (dynamic_cast<const CLI::RuntimeError*>(&e) != nullptr) return e.get_exit_code();
    return app.exit(e) == EXIT_SUCCESS ? EXIT_SUCCESS : kUsage;
  }
  return std::nullopt;
}

}  // namespace dfr::experiment
