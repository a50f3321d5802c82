// Command lines with one argument per line, and a configuration for --config before a null byte. An
// accepted command line has numbers in their ranges, and the written run.toml starts the same run.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <optional>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "dfr/experiment/command_line.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

namespace {

using dfr::experiment::ExperimentOptions;

// A program with one option of each kind that the programs of apps/ use.
struct Program {
  ExperimentOptions options;
  double gamma = 5.0;
  int horizon = 40;
  std::vector<int> demonstrations = {6, 60};
  std::vector<double> weights;
  std::string data;
  bool cold = true;
  std::string run_toml;
};

// Returns the options that `experiment` parses from the arguments, or nothing if it rejects them.
std::optional<Program> Run(const std::vector<std::string>& arguments) {
  Program program;
  CLI::App app("fuzz", "fuzz");
  app.require_subcommand(1);
  CLI::App* const command = app.add_subcommand("experiment", "all methods");
  dfr::experiment::AddExperimentOptions(*command, program.options, "quick or paper", "names");
  command->add_option("-g,--gamma", program.gamma)
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("--horizon", program.horizon)
      ->check(dfr::apps::kCount)
      ->capture_default_str();
  command->add_option("--demonstrations", program.demonstrations)->delimiter(',');
  command->add_option("--weights", program.weights)->check(dfr::apps::kNotNegative);
  command->add_option("--data", program.data)->type_name("FILE");
  command->add_flag("--cold,!--warm", program.cold);
  std::vector<const char*> argv = {"fuzz", "experiment"};
  for (const std::string& argument : arguments) argv.push_back(argument.c_str());
  try {
    if (dfr::experiment::Parse(app, static_cast<int>(argv.size()), argv.data())) return {};
    program.run_toml = program.options.configuration();
  } catch (const std::exception&) {
    return {};
  }
  return program;
}

void Require(bool holds, const char* what, const Program& program) {
  if (holds) return;
  std::fprintf(stderr, "%s\n%s\n", what, program.run_toml.c_str());
  std::abort();
}

}  // namespace

DFR_FUZZ_TARGET(command_line) {
  std::cout.rdbuf(nullptr);  // help and errors
  std::cerr.rdbuf(nullptr);
  std::string_view text = dfr::fuzz::AsText(data, size);
  std::vector<std::string> arguments;
  const std::size_t null = text.find('\0');
  const std::string_view configuration =
      null == std::string_view::npos ? std::string_view() : text.substr(0, null);
  if (null != std::string_view::npos) text.remove_prefix(null + 1);
  // This target reads no other files.
  if (text.find('/') != std::string_view::npos) return 0;
  for (std::string argument; !text.empty();) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    argument.clear();
    // run.toml is UTF-8. Arguments may have any bytes, but this target uses ASCII.
    for (const char c : text.substr(0, end)) argument += static_cast<char>(c & 0x7f);
    argument.erase(std::min(argument.find('\0'), argument.size()));
    arguments.push_back(argument);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  const std::string file = dfr::fuzz::InputFile(configuration).string();
  if (null != std::string_view::npos) arguments.insert(arguments.begin(), "--config=" + file);
  const auto first = Run(arguments);
  if (!first) return 0;
  Require(std::isfinite(first->gamma) && first->gamma > 0.0, "gamma", *first);
  Require(first->horizon >= 1 && first->horizon <= 1'000'000, "horizon", *first);
  for (const double weight : first->weights) Require(weight >= 0.0, "weights", *first);
  dfr::fuzz::InputFile(first->run_toml);
  const auto again = Run({"--config=" + file});
  Require(again.has_value(), "run.toml is refused", *first);
  Require(again->run_toml == first->run_toml, "run.toml says something else", *first);
  Require(again->gamma == first->gamma && again->horizon == first->horizon &&
              again->demonstrations == first->demonstrations && again->weights == first->weights &&
              again->cold == first->cold && again->options.seed == first->options.seed &&
              again->options.methods == first->options.methods &&
              again->options.trials == first->options.trials,
          "run.toml starts another run", *first);
  return 0;
}
