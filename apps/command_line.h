#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/usage_error.h"
#include "dfr/core/build_info.h"
#include "dfr/core/text/command_line.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/numbers.h"
#include "dfr/core/text/suggest.h"

namespace dfr::apps {

/// Exit code after a usage error.
inline constexpr int kUsageError = 2;

/// Range of horizons, repetitions and similar counts.
inline const CLI::Range kCount(1, 1'000'000);

/// Range of numbers of demonstrations.
inline const CLI::Range kDemonstrations(1, 10'000);
/// Range of numbers of demonstrations for a model, which needs 3.
inline const CLI::Range kModelDemonstrations(3, 10'000);

/// Validators for CLI::Option::check(). The messages of CLI11's own validators print all 309 digits
/// of the largest double.
inline const CLI::Validator kPositive(
    [](const std::string& text) { return core::MustBePositive(text); }, "POSITIVE");
inline const CLI::Validator kNotNegative(
    [](const std::string& text) { return core::MustNotBeNegative(text); }, "NONNEGATIVE");

/// Returns a validator of a share or a probability. `interval` is "[0, 1]" or "(0, 1]", for
/// example; a parenthesis excludes that end.
inline CLI::Validator ShareIn(const std::string& interval) {
  return {[interval](const std::string& text) {
            const std::optional<double> share = core::ParseNumber(text);
            if (!share) return core::MustBeFinite(text);
            const bool above = interval.front() == '[' ? *share >= 0.0 : *share > 0.0;
            const bool below = interval.back() == ']' ? *share <= 1.0 : *share < 1.0;
            return above && below ? "" : "must lie in " + interval + ", not " + text;
          },
          interval};
}

/// Open range (0, 1) of shares and probabilities.
inline const CLI::Validator kShare = ShareIn("(0, 1)");

/// Returns the check of a value that `read` reads: its std::invalid_argument becomes a usage error,
/// with file and line in a configuration.
template <typename Read>
CLI::Validator ReadBy(Read read) {
  return {[read](const std::string& text) {
            try {
              static_cast<void>(read(text));
            } catch (const std::invalid_argument& e) {
              return std::string(e.what());
            }
            return std::string();
          },
          ""};
}

/// For CLI::Option::transform(): converts one of `words` to its enumerator. Help and errors list
/// the words.
template <typename T>
CLI::Validator OneOf(const std::map<std::string, T>& words) {
  std::string list;
  for (const auto& [word, value] : words) list.append(list.empty() ? "{" : ",").append(word);
  list += "}";
  return {[words, list](std::string& text) {
            const auto found = words.find(text);
            if (found == words.end()) return "'" + text + "' is not one of " + list;
            text = std::to_string(static_cast<int>(found->second));
            return std::string();
          },
          list};
}

/// Runs `run(argc, argv)` as the program `name` and returns its exit code. Every main() is one call
/// of this function. It adds the following to `run`:
/// - A write beyond the file size limit (ulimit -f) fails as on a full disk, instead of killing the
///   program by a signal.
/// - Closed standard streams are opened to /dev/null. Otherwise the next opened file would get the
///   descriptor of a standard stream, and then the program's messages.
/// - An exception causes a message and a failure or, for core::UnknownName and UsageError, a usage
///   error. Output that could not be written, for example to a full disk, also causes a failure.
template <typename Run>
int RunProgram(const char* name, int argc, char** argv, Run run) {
  static_cast<void>(std::signal(SIGXFSZ, SIG_IGN));
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    // open() returns the lowest free descriptor, here `stream`.
    if (::fcntl(stream, F_GETFD) < 0) static_cast<void>(::open("/dev/null", O_RDWR));
  }
  int code = EXIT_FAILURE;
  try {
    code = run(argc, argv);
  } catch (const core::UnknownName& e) {
    std::cerr << name << ": " << core::Printable(e.what()) << '\n';
    code = kUsageError;
  } catch (const UsageError& e) {
    std::cerr << name << ": " << core::Printable(e.what()) << '\n';
    code = kUsageError;
  } catch (const std::exception& e) {
    std::cerr << name << ": " << core::Printable(e.what()) << '\n';
  }
  std::cout.flush();
  const bool written = std::cout.good() && std::fflush(stdout) == 0 && std::ferror(stdout) == 0;
  if (written || code != EXIT_SUCCESS) return code;
  std::cerr << name
            << ": standard output could not be written, and is incomplete; check that the disk is "
               "not full\n";
  return EXIT_FAILURE;
}

/// Adds --version, which prints the version and the commit.
inline void AddVersion(CLI::App& app) {
  app.set_version_flag("--version",
                       std::string(core::BuildVersion()) + " (" + core::BuildCommit() + ")");
}

/// Parses the arguments after core::CheckArguments() and core::RefuseAmbiguous(). Returns the
/// exit code if the program is done: EXIT_SUCCESS after --help and --version, 2 after a usage
/// error, which is printed in one line.
inline std::optional<int> Parse(CLI::App& app, int argc, const char* const* argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  core::CheckArguments(app, arguments);
  try {
    core::RefuseAmbiguous<CLI::ValidationError>(app, arguments);
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == EXIT_SUCCESS ? EXIT_SUCCESS : kUsageError;
  }
  return std::nullopt;
}

}  // namespace dfr::apps
