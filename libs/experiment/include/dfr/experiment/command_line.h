#pragma once

#include <optional>
#include <string>
#include <vector>

#include "dfr/experiment/experiment.h"

namespace CLI {
class App;
}

namespace dfr::experiment {

/// Adds to a command --out, --seed, --threads, --shard, --config, --restart and --salvage, and sets
/// options.configuration. Both have to outlive what is parsed. Options of the command whose type
/// name is FILE are written to run.toml with absolute paths.
void AddRunOptions(CLI::App& command, ExperimentOptions& options);

/// AddRunOptions(), and what else all commands that compare methods let their users choose.
/// `presets` says what each preset runs, `methods` which methods there are.
void AddExperimentOptions(CLI::App& command, ExperimentOptions& options, const std::string& presets,
                          const std::string& methods,
                          const std::vector<std::string>& names = {"quick", "paper"});

/// Parses a program's arguments, for its commands that have AddRunOptions() and those that
/// it adds:
///
///   merge FOLDER... --out FOLDER   shards become one ledger, then the shards' own command goes on
///                                  with it to summary and report
///   status FOLDER...               how many units are finished, by whom, and when the rest will be
///   episodes FOLDER                episodes by their ids, those that ended worst first
///   rerun FOLDER ID                one episode again, with other methods beside it, and its film
///
/// --config FILE of a command reads the table of the command's name, as in [experiment], whose keys
/// are the command's options without their dashes; what stands on the command line comes first.
/// Errors of such a value name the file and its line.
///
/// @returns the exit code where nothing is left to be done (help, errors, status and episodes), and
///   otherwise nothing: then the app's commands are parsed.
/// @throws std::runtime_error for files that cannot be read, and as MergeLedgers().
[[nodiscard]] std::optional<int> Parse(CLI::App& app, int argc, const char* const* argv);

}  // namespace dfr::experiment
