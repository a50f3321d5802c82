#include "dfr/experiment/command_line.h"

#include <toml++/toml.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "dfr/core/format.h"
#include "dfr/core/toml_text.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/status.h"
#include "ledger_file.h"
#include "text_file.h"

namespace dfr::experiment {
namespace {

using Arguments = std::vector<std::string>;

constexpr const char* kConfiguration = "run.toml";
constexpr const char* kLedger = "ledger.jsonl";

// Other options concern one run, and not what it computes.
bool DecidesResults(const std::string& name) {
  for (const char* other : {"help", "config", "out", "shard", "threads", "restart", "salvage"}) {
    if (name == other) return false;
  }
  return !name.starts_with("rerun-");
}

bool IsFlag(const CLI::Option& option) { return option.get_items_expected_max() == 0; }

std::string NameOf(const CLI::Option& option) {
  return option.get_lnames().empty() ? "" : option.get_lnames().front();
}

// Whether `argument` is the option, as in --gamma or --gamma=7.
bool Names(const std::string& argument, const CLI::Option& option) {
  const std::string head = argument.substr(0, argument.find('='));
  for (const std::string& name : option.get_lnames()) {
    if (head == "--" + name) return true;
  }
  return std::ranges::any_of(option.get_snames(), [&](const std::string& name) {
    return argument.starts_with("-" + name) && !argument.starts_with("--");
  });
}

bool IsValue(const std::string& argument) {
  const bool number = argument.size() > 1 && (std::isdigit(argument[1]) != 0 || argument[1] == '.');
  return !argument.starts_with("-") || argument == "-" || number;
}

// What a flag that is given as `argument` says of the flag's first name, its key in run.toml:
// --not-during is "false" of "during", and --no-video "true" of "no-video".
std::string FlagValue(const CLI::Option& option, const std::string& argument) {
  const std::size_t equals = argument.find('=');
  std::string value = equals == std::string::npos ? "true" : argument.substr(equals + 1);
  const std::size_t begin = argument.find_first_not_of('-');
  const std::string name = argument.substr(begin, std::min(equals, argument.size()) - begin);
  if (option.check_fname(name) == option.check_fname(NameOf(option))) return value;
  return value == "true" ? "false" : "true";
}

// The values that the command line gives an option, as they were written; one flag's is true or
// false.
Arguments ValuesOf(const CLI::Option& option, const Arguments& arguments) {
  Arguments values;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    if (arguments[i] == "--") break;
    if (!Names(arguments[i], option)) continue;
    const std::size_t equals = arguments[i].find('=');
    if (IsFlag(option)) {
      values.push_back(FlagValue(option, arguments[i]));
    } else if (equals != std::string::npos) {
      values.push_back(arguments[i].substr(equals + 1));
    } else {
      for (int k = 0; k < option.get_items_expected_max() && i + 1 < arguments.size() &&
                      IsValue(arguments[i + 1]);
           ++k) {
        values.push_back(arguments[++i]);
      }
    }
  }
  return values;
}

Arguments Split(const std::string& text, char delimiter) {
  Arguments parts;
  std::size_t begin = 0;
  for (std::size_t end = text.find(delimiter); end != std::string::npos;
       begin = end + 1, end = text.find(delimiter, begin)) {
    parts.push_back(text.substr(begin, end - begin));
  }
  parts.push_back(text.substr(begin));
  return parts;
}

// As TOML: a number or a truth value where it is one, otherwise a string.
std::string Value(const std::string& text, bool is_number) {
  if (is_number) {
    double value = 0.0;
    const auto end = std::from_chars(text.data(), text.data() + text.size(), value);
    const bool plain = text.find_first_not_of("0123456789+-.eE") == std::string::npos;
    const bool digits =
        text.find_first_of('.') == std::string::npos ||
        (text.front() != '.' && !text.starts_with("-.") && text.back() != '.' &&
         text.find(".e") == std::string::npos && text.find(".E") == std::string::npos);
    const bool zero = text.size() > 1 && text[0] == '0' && std::isdigit(text[1]) != 0;
    if (end.ec == std::errc() && end.ptr == text.data() + text.size() && plain && digits && !zero) {
      // In one form, whether it was written, read or a default: 0.0006 and 6e-4 are the same run.
      return text.find_first_of(".eE") == std::string::npos ? text : Exactly(value);
    }
  }
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') quoted += '\\';
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      quoted += core::Format("\\u%04x", static_cast<unsigned>(c));
    } else {
      quoted += c;
    }
  }
  return quoted + "\"";
}

bool IsNumeric(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  return type.starts_with("INT") || type.starts_with("UINT") || type.starts_with("FLOAT") ||
         type.find("INT") != std::string::npos || type.find("FLOAT") != std::string::npos;
}

// All options of a command with the values that they have, as a table of run.toml.
std::string Resolve(const CLI::App& command, const Arguments& arguments) {
  std::string text = "# Starts the same run again: " + command.get_parent()->get_name() + " " +
                     command.get_name() + " --config FILE --out FOLDER\n[" + command.get_name() +
                     "]\n";
  for (const CLI::Option* option : command.get_options()) {
    const std::string name = NameOf(*option);
    if (name.empty() || !DecidesResults(name)) continue;
    Arguments values = ValuesOf(*option, arguments);
    if (IsFlag(*option)) {
      if (!values.empty()) text.append(name).append(" = ").append(values.back()).append("\n");
      continue;
    }
    if (values.empty()) {
      std::string standard = option->get_default_str();
      if (standard.starts_with("[") && standard.ends_with("]")) {
        standard = standard.substr(1, standard.size() - 2);
      }
      if (standard.empty() || standard == "\"\"") continue;
      values = {standard};
    }
    if (option->get_delimiter() != '\0' || option->get_items_expected_max() > 1) {
      Arguments parts;
      for (const std::string& value : values) {
        for (std::string& part : Split(value, ',')) parts.push_back(std::move(part));
      }
      values = std::move(parts);
    }
    if (option->get_type_name() == "FILE") {
      for (std::string& value : values) value = std::filesystem::absolute(value).string();
    }
    const bool list = option->get_items_expected_max() > 1;
    text.append(name).append(list ? " = [" : " = ");
    if (!list) values = {values.back()};
    for (std::size_t i = 0; i < values.size(); ++i) {
      text.append(i > 0 ? ", " : "").append(Value(values[i], IsNumeric(*option)));
    }
    text += list ? "]\n" : "\n";
  }
  return text;
}

// What --config adds to the arguments, and where each option of it stands.
struct FromFile {
  Arguments arguments;
  std::map<std::string, std::string> places;  // by option name
};

std::string TextOf(const toml::node& node) {
  if (const auto* text = node.as_string()) return text->get();
  if (const auto* truth = node.as_boolean()) return truth->get() ? "true" : "false";
  if (const auto* whole = node.as_integer()) return std::to_string(whole->get());
  if (const auto* number = node.as_floating_point()) return Exactly(number->get());
  throw std::invalid_argument("must be a text, a number, true, false, or a list of these");
}

FromFile ReadConfiguration(const std::filesystem::path& file, const CLI::App& app,
                           const CLI::App& command, const Arguments& given) {
  const std::string text = internal::ReadFile(file);
  const auto place = [&](const toml::source_region& where) {
    return file.string() + ":" + std::to_string(where.begin.line);
  };
  toml::table root;
  try {
    root = toml::parse(core::CheckToml(file, text), file.string());
  } catch (const toml::parse_error& e) {
    throw std::runtime_error(place(e.source()) + ": " + std::string(e.description()));
  }
  for (const auto& [key, node] : root) {
    const std::string name(key.str());
    const auto commands = app.get_subcommands([](const CLI::App*) { return true; });
    const bool known =
        std::ranges::any_of(commands, [&](const CLI::App* c) { return c->get_name() == name; });
    if (!node.is_table() || !(known || name == "grid")) {
      throw std::runtime_error(place(node.source()) + ": '" + name +
                               "' is no table of a command; options stand in one, as in [" +
                               command.get_name() + "]");
    }
  }
  FromFile result;
  const toml::node* table = root.get(command.get_name());
  if (table == nullptr) {
    throw std::runtime_error(file.string() + ": there is no table [" + command.get_name() + "]");
  }
  for (const auto& [key, node] : *table->as_table()) {
    const std::string name(key.str());
    const CLI::Option* option = command.get_option_no_throw("--" + name);
    if (option == nullptr || name == "help" || name == "config") {
      throw std::runtime_error(place(node.source()) + ": " + command.get_name() +
                               " has no option '" + name + "'; --help lists them");
    }
    result.places[name] = place(node.source());
    if (std::ranges::any_of(given, [&](const std::string& a) { return Names(a, *option); })) {
      continue;
    }
    Arguments values;
    try {
      if (const toml::array* list = node.as_array()) {
        for (const toml::node& entry : *list) values.push_back(TextOf(entry));
      } else {
        values.push_back(TextOf(node));
      }
    } catch (const std::invalid_argument& e) {
      throw std::runtime_error(place(node.source()) + ": '" + name + "' " + e.what());
    }
    const auto add = [&](const std::string& value) {
      std::string& argument = result.arguments.emplace_back("--");
      argument.append(name).append("=").append(value);
    };
    std::string joined;
    for (const std::string& value : values) {
      if (option->get_delimiter() != '\0') {
        joined.append(joined.empty() ? "" : std::string(1, option->get_delimiter())).append(value);
      } else {
        add(value);
      }
    }
    if (!joined.empty()) add(joined);
  }
  return result;
}

// The ledgers of the folders, and of shards below those that have none.
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
      throw std::runtime_error(folder.string() + ": there is no " + kLedger +
                               " in it, nor in the folders below");
    }
    std::ranges::sort(below);
    ledgers.insert(ledgers.end(), below.begin(), below.end());
  }
  return ledgers;
}

// The name of the command that a folder's run.toml is of.
std::string CommandOf(const std::filesystem::path& configuration) {
  const std::string text = internal::ReadFile(configuration);
  toml::table root;
  try {
    root = toml::parse(core::CheckToml(configuration, text), configuration.string());
  } catch (const toml::parse_error& e) {
    throw std::runtime_error(configuration.string() + ": " + std::string(e.description()));
  }
  if (root.size() != 1) {
    throw std::runtime_error(configuration.string() + ": must have one table, the run's command");
  }
  return std::string(root.begin()->first.str());
}

// The arguments that run an episode of the run in `folder` again.
Arguments RerunOf(const std::filesystem::path& folder, const Rerun& rerun) {
  const std::filesystem::path configuration = folder / kConfiguration;
  Arguments arguments = {CommandOf(configuration), "--config",
                         configuration.string(),   "--out",
                         folder.string(),          "--rerun-episode=" + rerun.episode};
  for (const std::string& method : rerun.methods) arguments.push_back("--rerun-with=" + method);
  if (!rerun.film.empty()) arguments.push_back("--rerun-film=" + rerun.film.string());
  return arguments;
}

// Merges and returns the arguments that make summary and report of it.
Arguments Merge(const std::vector<std::filesystem::path>& folders,
                const std::filesystem::path& out) {
  std::vector<std::filesystem::path> ledgers = LedgersIn(folders);
  const std::filesystem::path configuration = ledgers.front().parent_path() / kConfiguration;
  std::filesystem::path kept = std::filesystem::absolute(configuration);
  const std::string command = CommandOf(configuration);
  std::filesystem::create_directories(out);
  {
    const internal::Descriptor lock = internal::OpenLocked(out / "lock");
    const std::filesystem::path whole = out / kLedger;
    // What is there already is not lost: it is merged, too, or refused.
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

void Add(CLI::App& app, Added& added) {
  added.merge = app.add_subcommand("merge", "one ledger, summary and report of several shards");
  added.merge->add_option("folders", added.folders, "of shards, or with shards in folders below")
      ->required();
  added.merge->add_option("--out", added.out, "folder of the whole")->required();
  added.status = app.add_subcommand("status", "how far runs are, from outside");
  added.status->add_option("folders", added.folders, "of runs, or with shards in folders below")
      ->required();
  added.status->add_flag("--json", added.json, "for programs");
  added.episodes = app.add_subcommand("episodes", "the ids of episodes, the worst first");
  added.episodes->add_option("folder", added.folders, "of a run")->required()->expected(1);
  added.episodes->add_option("--method", added.filter.method, "of one method alone");
  added.episodes->add_option("--learner", added.filter.learner, "of one learner alone");
  added.episodes->add_option("--demonstrations", added.filter.demonstrations,
                             "of one data point alone");
  added.episodes
      ->add_option("--outcome", added.filter.outcomes, "completed, halted or collided alone")
      ->delimiter(',')
      ->check(CLI::IsMember({"completed", "halted", "collided"}));
  added.episodes->add_option("--cause", added.filter.cause, "of one cause alone");
  added.episodes->add_option_function<std::string>(
      "--against", [&added](const std::string& text) { added.filter.against = ParsePartner(text); },
      "METHOD=OUTCOME: from start states alone from which that method ended so");
  added.episodes->add_option("--most", added.most, "so many lines; 0: all")->capture_default_str();
  added.rerun = app.add_subcommand("rerun", "one episode again, and other methods beside it");
  added.rerun->add_option("folder", added.run, "of its run")->required();
  added.rerun->add_option("episode", added.again.episode, "its id, as episodes prints it")
      ->required();
  added.rerun
      ->add_option("--methods", added.again.methods, "of that run, from the same start state")
      ->delimiter(',');
  added.rerun->add_option(
      "--film", added.again.film,
      "a file of pictures, where the program has them: .mp4, or .html for paths");
}

void ParseArguments(CLI::App& app, Arguments arguments) {
  std::ranges::reverse(arguments);  // as CLI11 wants them
  app.parse(std::move(arguments));
}

// Arguments with those of --config before them, so that the command line comes last and wins.
void ParseWithConfiguration(CLI::App& app, const Arguments& arguments, Arguments& all) {
  const CLI::App* command = nullptr;
  for (const CLI::App* candidate : app.get_subcommands([](const CLI::App*) { return true; })) {
    if (!arguments.empty() && candidate->get_name() == arguments.front()) command = candidate;
  }
  all = arguments;
  FromFile from_file;
  if (command != nullptr) {
    if (const CLI::Option* config = command->get_option_no_throw("--config")) {
      const Arguments values = ValuesOf(*config, arguments);
      const bool of_experiments = command->get_option_no_throw("--shard") != nullptr;
      if (!values.empty() && of_experiments) {
        from_file = ReadConfiguration(values.back(), app, *command, arguments);
        all.insert(all.begin() + 1, from_file.arguments.begin(), from_file.arguments.end());
      }
    }
  }
  try {
    ParseArguments(app, all);
  } catch (const CLI::Success&) {
    throw;
  } catch (const CLI::ParseError& e) {
    const std::string what = e.what();
    for (const auto& [name, place] : from_file.places) {
      const std::string option = "--" + name;
      if (what.find(option + ":") != std::string::npos ||
          what.find(option + " ") != std::string::npos) {
        throw CLI::ParseError(std::string(place).append(": ").append(what), e.get_exit_code());
      }
    }
    throw;
  }
}

// The arguments of this process with those of --config, as Parse() has them: CLI11 keeps values
// only as transformed by its validators.
Arguments& PresentArguments() {
  static Arguments arguments;
  return arguments;
}

}  // namespace

void AddExperimentOptions(CLI::App& command, ExperimentOptions& options, const std::string& presets,
                          const std::string& methods, const std::vector<std::string>& names) {
  command.add_option("--preset", options.preset, presets)
      ->check(CLI::IsMember(names))
      ->capture_default_str();
  AddRunOptions(command, options);
  command.add_flag("!--no-video", options.video, "leave the videos out");
  command.add_option("--methods", options.methods, methods)->delimiter(',');
  command.add_option("--trials", options.trials, "independent repetitions of everything");
  command.add_option("--episodes", options.episodes, "start states per trial and data point");
}

void AddRunOptions(CLI::App& command, ExperimentOptions& options) {
  command.add_option("--out", options.out, "folder of the ledger and of what comes of it")
      ->capture_default_str();
  command.add_option("--seed", options.seed, "of all that is random")->capture_default_str();
  command.add_option("--threads", options.threads, "0: one per core; the results are the same")
      ->capture_default_str();
  command
      .add_option_function<std::string>(
          "--shard", [&options](const std::string& text) { options.shard = ParseShard(text); },
          "K/N: the K-th of N parts alone, to be merged")
      ->default_str("1/1");
  command.add_option("--config", "TOML file, as run.toml of an earlier run; options overrule it");
  command.add_flag("--restart", options.restart,
                   "forget what an interrupted run left in --out instead of going on with it");
  command.add_flag("--salvage", options.salvage,
                   "go on with a damaged ledger: its damaged lines are put aside and run again");
  // What RerunOf() gives; users have the command rerun.
  command.add_option("--rerun-episode", options.rerun.episode)->group("");
  command.add_option("--rerun-with", options.rerun.methods)->group("");
  command.add_option("--rerun-film", options.rerun.film)->group("");
  // Several commands may share the options: the one that was called is written.
  options.configuration = [&command, others = options.configuration] {
    return command.parsed() || !others ? Resolve(command, PresentArguments()) : others();
  };
}

std::optional<int> Parse(CLI::App& app, int argc, const char* const* argv) {
  if (app.get_name().empty()) app.name(std::filesystem::path(argv[0]).filename().string());
  // One line: of a task's log status shows the last.
  app.failure_message([](const CLI::App* program, const CLI::Error& e) {
    return program->get_name() + ": " + e.what() + "; --help says what there is\n";
  });
  Added added;
  Add(app, added);
  const auto commands = app.get_subcommands([](const CLI::App*) { return true; });
  if (argc > 1 && argv[1][0] != '-' && std::ranges::none_of(commands, [&](const CLI::App* known) {
        return known->get_name() == argv[1];
      })) {
    throw std::invalid_argument("there is no command '" + std::string(argv[1]) + "'; " +
                                app.get_name() + " --help lists them");
  }
  try {
    ParseWithConfiguration(app, {argv + 1, argv + argc}, PresentArguments());
    if (added.merge->parsed()) {
      ParseWithConfiguration(app, Merge(added.folders, added.out), PresentArguments());
    } else if (added.status->parsed()) {
      const std::vector<Status> statuses = StatusesOf(added.folders);
      std::cout << (added.json ? ToJson(statuses) : ToText(statuses));
      return EXIT_SUCCESS;
    } else if (added.episodes->parsed()) {
      PrintEpisodes(LedgersIn(added.folders), added.filter, added.most, std::cout);
      return EXIT_SUCCESS;
    } else if (added.rerun->parsed()) {
      ParseWithConfiguration(app, RerunOf(added.run, added.again), PresentArguments());
    }
  } catch (const CLI::ParseError& e) {
    return app.exit(e);
  }
  return std::nullopt;
}

}  // namespace dfr::experiment
