#pragma once

#include <filesystem>
#include <string>

namespace CLI {
class App;
}

namespace dfr::experiment::internal {

/// Records the option values of a program's commands as given, before validators change them.
void KeepGivenValues(CLI::App& app);
void ForgetGivenValues();

/// Formats all options of a command with their current values as a table of run.toml.
[[nodiscard]] std::string Resolve(const CLI::App& command);

/// Sets the options of `command` that have no value yet to the values in a file, and runs their
/// checks. Call this after the command line is parsed and before it is processed, in the callback
/// of --config.
/// @throws std::runtime_error or CLI::ParseError naming file and line.
void ReadConfiguration(const std::filesystem::path& file, CLI::App& command);

/// Returns the name of the command in a run.toml.
/// @throws std::runtime_error naming a file that cannot be read or has not exactly one table.
[[nodiscard]] std::string CommandOf(const std::filesystem::path& configuration);

}  // namespace dfr::experiment::internal
