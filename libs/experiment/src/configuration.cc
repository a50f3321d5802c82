#include "configuration.h"

#include <toml++/toml.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <cstdint>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "dfr/core/files/toml_text.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/ledger.h"

namespace dfr::experiment::internal {
namespace {

using Arguments = std::vector<std::string>;

// Returns true if the option can affect the results. run.toml must contain such options.
bool DecidesResults(const std::string& name) {
  static const std::set<std::string> kOthers = {"help",    "config",  "out",    "shard",
                                                "threads", "restart", "salvage"};
  return !kOthers.contains(name) && !name.starts_with("rerun-");
}

bool IsFlag(const CLI::Option& option) { return option.get_items_expected_max() == 0; }

std::string NameOf(const CLI::Option& option) {
  return option.get_lnames().empty() ? "" : option.get_lnames().front();
}

// Option values of this process before any change by CLI11's validators.
std::map<const CLI::Option*, Arguments>& GivenValues() {
  static std::map<const CLI::Option*, Arguments> values;
  return values;
}

Arguments SplitAtCommas(const std::string& text) {
  Arguments parts;
  std::istringstream in(text);
  for (std::string part; std::getline(in, part, ',');) parts.push_back(part);
  return parts;
}

// Formats a value as TOML: a number if `is_number` and `text` is a number, otherwise a string.
std::string Value(const std::string& text, bool is_number) {
  static const std::regex kNumber(R"(-?(0|[1-9][0-9]*)(\.[0-9]+)?([eE][-+]?[0-9]+)?)");
  // The limit bounds the depth of std::regex. TOML's integers have 64 bits.
  if (is_number && text.size() < 400 && std::regex_match(text, kNumber)) {
    const auto fits = [&](auto& number) {
      return std::from_chars(text.data(), text.data() + text.size(), number).ec == std::errc();
    };
    std::int64_t whole = 0;
    double value = 0.0;
    const bool integer = text.find_first_of(".eE") == std::string::npos;
    // Uses one form for written, read and default values: 0.0006 and 6e-4 mean the same run.
    if (integer ? fits(whole) : fits(value)) return integer ? text : Exactly(value);
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
  return type.find("INT") != std::string::npos || type.find("FLOAT") != std::string::npos;
}

std::string WordOf(const toml::node& node) {
  if (const auto* text = node.as_string()) return text->get();
  if (const auto* truth = node.as_boolean()) return truth->get() ? "true" : "false";
  if (const auto* whole = node.as_integer()) return std::to_string(whole->get());
  if (const auto* number = node.as_floating_point()) return Exactly(number->get());
  throw std::invalid_argument("must be a string, a number, true, false, or a list of these");
}

// Reads a configuration. @throws std::runtime_error naming the file and line.
toml::table ReadToml(const std::filesystem::path& file) {
  try {
    return toml::parse(core::CheckToml(file, core::ReadTomlText(file)), file.string());
  } catch (const toml::parse_error& e) {
    throw std::runtime_error(file.string() + ":" + std::to_string(e.source().begin.line) + ": " +
                             std::string(e.description()));
  }
}

}  // namespace

void KeepGivenValues(CLI::App& app) {
  for (CLI::App* command : app.get_subcommands([](CLI::App*) { return true; })) {
    for (CLI::Option* option : command->get_options()) {
      // A transform runs before all other validators.
      option->transform(CLI::Validator(
          [option](std::string& value) {
            GivenValues()[option].push_back(value);
            return std::string();
          },
          ""));
    }
  }
}

void ForgetGivenValues() { GivenValues().clear(); }

std::string Resolve(const CLI::App& command) {
  std::string text = "# Starts the same run again: " + command.get_parent()->get_name() + " " +
                     command.get_name() + " --config FILE --out FOLDER\n[" + command.get_name() +
                     "]\n";
  for (const CLI::Option* option : command.get_options()) {
    const std::string name = NameOf(*option);
    if (name.empty() || !DecidesResults(name)) continue;
    const bool list = option->get_items_expected_max() > 1;
    if (IsFlag(*option)) {
      // Uses the meaning of the flag's first name: --warm of "--cold,!--warm" is "cold = false".
      const bool negative = option->check_fname(name);
      if (option->count() > 0) {
        text.append(name).append(option->as<bool>() != negative ? " = true\n" : " = false\n");
      }
      continue;
    }
    const auto given = GivenValues().find(option);
    Arguments values = given == GivenValues().end() ? Arguments() : given->second;
    if (values.empty()) {
      std::string standard = option->get_default_str();
      if (standard.starts_with("[") && standard.ends_with("]")) {
        standard = standard.substr(1, standard.size() - 2);
      }
      if (standard.empty() || standard == "\"\"") continue;
      values = list ? SplitAtCommas(standard) : Arguments{standard};
    }
    if (option->get_type_name() == "FILE") {
      for (std::string& value : values) value = std::filesystem::absolute(value).string();
    }
    text.append(name).append(list ? " = [" : " = ");
    if (!list) values = {values.back()};
    for (std::size_t i = 0; i < values.size(); ++i) {
      text.append(i > 0 ? ", " : "").append(Value(values[i], IsNumeric(*option)));
    }
    text += list ? "]\n" : "\n";
  }
  return text;
}

void ReadConfiguration(const std::filesystem::path& file, CLI::App& command) {
  const auto place = [&](const toml::node& node) {
    return file.string() + ":" + std::to_string(node.source().begin.line) + ": ";
  };
  const toml::table root = ReadToml(file);
  for (const auto& [key, node] : root) {
    const std::string name(key.str());
    const auto named = command.get_parent()->get_subcommands(
        [&](const CLI::App* other) { return other->get_name() == name; });
    if (!node.is_table() || (named.empty() && name != "grid")) {
      throw std::runtime_error(
          place(node) + "'" + name +
          "' is not the table of a command: write options in a table such as [" +
          command.get_name() + "]");
    }
  }
  const toml::node* table = root.get(command.get_name());
  if (table == nullptr) {
    throw std::runtime_error(file.string() + ": has no table [" + command.get_name() + "]");
  }
  std::map<const CLI::Option*, std::string> read;
  for (const auto& [key, node] : *table->as_table()) {
    const std::string name(key.str());
    CLI::Option* const option = command.get_option_no_throw("--" + name);
    if (option == nullptr || name == "help" || name == "config") {
      throw std::runtime_error(place(node) + command.get_name() + " has no option '" + name +
                               "'; --help lists the options");
    }
    if (const auto [first, added] = read.try_emplace(option, name); !added) {
      throw std::runtime_error(place(node) + first->second + " and " + name + " are one option");
    }
    if (option->count() > 0) continue;
    const auto add = [&](const toml::node& value) {
      const std::string word = WordOf(value);
      option->add_result(IsFlag(*option) ? option->get_flag_value(name, word) : word);
    };
    try {
      if (const toml::array* list = node.as_array()) {
        for (const toml::node& entry : *list) add(entry);
      } else {
        add(node);
      }
      option->run_callback();
    } catch (const std::invalid_argument& e) {
      throw std::runtime_error(place(node) + "'" + name + "' " + e.what());
    } catch (const CLI::ParseError& e) {
      throw CLI::ParseError(place(node) + e.what(), e.get_exit_code());
    }
  }
}

std::string CommandOf(const std::filesystem::path& configuration) {
  const toml::table root = ReadToml(configuration);
  if (root.size() != 1) {
    throw std::runtime_error(configuration.string() +
                             ": must have exactly one table, named after the run's command");
  }
  return std::string(root.begin()->first.str());
}

}  // namespace dfr::experiment::internal
