#pragma once

#include <optional>
#include <string>
#include <vector>

#include "dfr/experiment/experiment.h"

namespace CLI {
class App;
}

namespace dfr::experiment {

/// Adds --out, --seed, --threads, --shard, --config, --restart and --salvage to a command, and sets
/// options.configuration. Both arguments must outlive parsing. `command` must also outlive all
/// calls of options.configuration. run.toml stores options of type FILE as absolute paths.
void AddRunOptions(CLI::App& command, ExperimentOptions& options);

/// Calls AddRunOptions() and adds the other options of all commands that compare methods. `presets`
/// describes each preset; `methods` lists the methods.
void AddExperimentOptions(CLI::App& command, ExperimentOptions& options, const std::string& presets,
                          const std::string& methods,
                          const std::vector<std::string>& names = {"quick", "paper"});

/// Parses the arguments of a program's commands, after AddRunOptions() for each, and of the
/// commands that this function adds:
///
///   merge FOLDER... --out FOLDER   merges shards into one ledger; the shards' command then writes
///                                  summary and report from it
///   status FOLDER...               finished units, the hosts that finished them, remaining time
///   episodes FOLDER                ids of episodes, worst outcomes first
///   rerun FOLDER ID                repeats one episode, compares other methods, and films them
///
/// With --config FILE, a command reads the table with its name, such as [experiment]. The keys are
/// the command's options without dashes. The command line takes precedence. Errors in a value name
/// file and line.
///
/// @param film_endings  file extensions of the films that the program can write.
/// @returns the exit code if no command remains to run: 0 after help, status and episodes, 2 after
///   a usage error; otherwise std::nullopt, and the app's commands are parsed.
/// @throws std::runtime_error for files that cannot be read, and as MergeLedgers().
[[nodiscard]] std::optional<int> Parse(CLI::App& app, int argc, const char* const* argv,
                                       const std::vector<std::string>& film_endings = {".html"});

}  // namespace dfr::experiment
