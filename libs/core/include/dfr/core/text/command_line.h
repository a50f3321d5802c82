#pragma once

#include <algorithm>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <filesystem>
#include <initializer_list>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "dfr/core/files/output_path.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/numbers.h"
#include "dfr/core/text/suggest.h"

namespace dfr::core {

/// Checks for CLI::Option::check(): return an error, or "" for a number in range.
inline std::string MustBeFinite(const std::string& text) {
  return ParseNumber(text) ? "" : "'" + text + "' is not a finite decimal number";
}
inline std::string MustBePositive(const std::string& text) {
  const std::optional<double> value = ParseNumber(text);
  if (!value) return MustBeFinite(text);
  return *value > 0.0 ? "" : "must be positive, not " + text;
}
inline std::string MustNotBeNegative(const std::string& text) {
  const std::optional<double> value = ParseNumber(text);
  if (!value) return MustBeFinite(text);
  return *value >= 0.0 ? "" : "must not be negative: " + text;
}

/// Check of a flag's value, as in --flag=false. CLI11 alone also accepts numbers: 2 as true, and -1
/// and 0x10 as false.
inline std::string MustBeTruth(const std::string& text) {
  for (const char* word : {"true", "false", "on", "off", "yes", "no", "1", "0"}) {
    if (text == word) return "";
  }
  return "'" + text + "' is neither true nor false";
}

/// Makes every numeric option of a program and its commands accept decimal numbers only
/// (numbers.h). Rejects NaN, infinity, hexadecimal, overflow, and negative unsigned numbers.
/// Numbers with leading zeros are decimal; CLI11 alone reads them as octal. Flags follow
/// MustBeTruth(). Call this after all options are added. Options can have additional range checks.
/// `App` has the interface of CLI::App (CLI11).
template <typename App>
void CheckNumbers(App& app) {
  const auto is_whole = []<std::integral T>(auto* option, const char* what, T) {
    option->transform([](const std::string& text) {
      const auto value = ParseInteger<T>(text);
      return value ? std::to_string(*value) : text;
    });
    option->check([what](const std::string& text) {
      return ParseInteger<T>(text) ? std::string() : "'" + text + "' is not " + what;
    });
  };
  for (auto* option : app.get_options()) {
    const std::string type = option->get_type_name();
    if (option->get_items_expected_max() == 0) {
      option->check(MustBeTruth);
    } else if (type.starts_with("FLOAT")) {
      option->check(MustBeFinite);
    } else if (type.starts_with("UINT")) {
      is_whole(option, "a whole number of at least 0", std::uint64_t{});
    } else if (type.starts_with("INT")) {
      is_whole(option, "a whole number", std::int64_t{});
    }
  }
  for (App* command : app.get_subcommands([](App*) { return true; })) CheckNumbers(*command);
}

/// Describes the first list in `arguments` with an empty entry, such as "1,,2"; "" if there is
/// none. CLI11 skips such entries: a forgotten value would shift all later ones. `App` has the
/// interface of CLI::App (CLI11).
template <typename App>
std::string DescribeEmptyEntry(const App& program, std::span<const std::string> arguments) {
  const auto is_list = [](const auto* option) {
    return option != nullptr && option->get_delimiter() != '\0';
  };
  const App* command = &program;
  std::string list;  // Name of the list option that takes the next arguments; "" if none.
  for (const std::string& argument : arguments) {
    if (argument == "--") break;
    std::string_view value = argument;
    if (argument.starts_with("--")) {
      const std::size_t equal = argument.find('=');
      const std::string name = argument.substr(0, equal);
      list = is_list(command->get_option_no_throw(name)) ? name : "";
      if (equal == std::string::npos) continue;
      value.remove_prefix(equal + 1);
    } else if (argument.starts_with('-') && !ParseNumber(argument.substr(0, argument.find(',')))) {
      list.clear();  // A short option.
    } else {
      for (const App* other : command->get_subcommands([](const App*) { return true; })) {
        if (other->get_name() != argument) continue;
        command = other;
        list.clear();
        break;
      }
    }
    const bool empty = value.starts_with(',') || value.ends_with(',') ||
                       value.find(",,") != std::string_view::npos;
    if (!list.empty() && empty) {
      return list + ": '" + std::string(value) + "' has an empty entry";
    }
  }
  return "";
}

/// Describes two names of one option in `arguments`, such as "-o" and "--out"; "" if there are
/// none. CLI11 joins the values of a list that has two names, and ignores one of two flags. `App`
/// has the interface of CLI::App (CLI11).
template <typename App>
std::string DescribeTwoNames(const App& program, std::span<const std::string> arguments) {
  const App* command = &program;
  std::map<const void*, std::string> given;
  for (const std::string& argument : arguments) {
    if (argument == "--") break;
    if (!argument.starts_with('-')) {
      for (const App* other : command->get_subcommands([](const App*) { return true; })) {
        if (other->get_name() == argument) command = other;
      }
      continue;
    }
    const std::string name =
        argument.substr(0, argument.starts_with("--") ? argument.find('=') : 2);
    const auto* const option = command->get_option_no_throw(name);
    if (option == nullptr) continue;
    std::string fault = given.try_emplace(option, name).first->second;
    if (fault == name) continue;
    fault.append(" and ").append(name).append(" are one option: give one of them");
    return fault;
  }
  return "";
}

/// Describes the first option in `arguments` with too few or too many values, such as "--amplitude:
/// needs 6 values, not 2"; "" if there is none. `App` has the interface of CLI::App (CLI11).
template <typename App>
std::string DescribeCount(const App& program, std::span<const std::string> arguments) {
  const App* command = &program;
  const auto find = [&command](const std::string& argument) {
    return command->get_option_no_throw(
        argument.substr(0, argument.starts_with("--") ? argument.find('=') : 2));
  };
  std::map<const void*, std::ptrdiff_t> given;
  for (std::size_t i = 0; i < arguments.size() && arguments[i] != "--"; ++i) {
    const std::string& argument = arguments[i];
    for (const App* other : command->get_subcommands([](const App*) { return true; })) {
      if (other->get_name() == argument) command = other;
    }
    const auto* const option = argument.starts_with('-') ? find(argument) : nullptr;
    if (option == nullptr || option->get_items_expected_max() == 0) continue;
    const char delimiter = option->get_delimiter();
    std::ptrdiff_t count = 0;
    const auto add = [&count, delimiter](std::string_view values) {
      count += 1 + (delimiter == '\0' ? 0 : std::ranges::count(values, delimiter));
    };
    const std::size_t equal = argument.starts_with("--") ? argument.find('=') : 1;
    if (equal < argument.size() - 1) add(std::string_view(argument).substr(equal + 1));
    const std::ptrdiff_t least = option->get_items_expected_min();
    const std::ptrdiff_t most = option->get_items_expected_max();
    while ((count < least || option->get_allow_extra_args()) && i + 1 < arguments.size() &&
           arguments[i + 1] != "--" && find(arguments[i + 1]) == nullptr) {
      add(arguments[++i]);
    }
    const auto fault = [&option](const char* verb, std::ptrdiff_t wanted, std::ptrdiff_t found) {
      return option->get_name() + verb +
             (wanted == 1 ? "one value" : std::to_string(wanted) + " values") + ", not " +
             (found == 0 ? "none" : std::to_string(found));
    };
    if (count < least) return fault(": needs ", least, count);
    if ((given[option] += count) > most) return fault(": takes ", most, given[option]);
  }
  return "";
}

/// Throws an `Error` with the description of DescribeEmptyEntry() or DescribeTwoNames(), if any.
template <typename Error, typename App>
void RefuseAmbiguous(const App& program, std::span<const std::string> arguments) {
  std::string fault = DescribeEmptyEntry(program, arguments);
  if (fault.empty()) fault = DescribeTwoNames(program, arguments);
  if (!fault.empty()) throw Error(std::move(fault));
}

/// Example calls of one command of a program, for AddExamples().
struct Example {
  const char* command;
  std::vector<std::string> arguments;  ///< One entry per call, without program and command.
};

/// Adds working examples to the --help of each named command, before an existing footer.
template <typename App>
void AddExamples(App& app, std::initializer_list<Example> examples) {
  for (const Example& example : examples) {
    App* const command = app.get_subcommand(example.command);
    std::string begin = "\n  ";
    begin.append(app.get_name()).append(" ").append(example.command);
    std::string text = "Examples:";
    for (const std::string& call : example.arguments) {
      text.append(begin).append(call.empty() ? "" : " ").append(call);
    }
    const std::string footer = command->get_footer();
    if (!footer.empty()) text.append("\n\n").append(footer);
    command->footer(text);
  }
}

/// Checks the path of `option` before the command begins: an unwritable path is a usage error.
/// `unwritable` has the interface of UnwritableFolder(). Accepts an empty path if it is the
/// default of an option that is not required.
template <typename Option, typename Unwritable>
Option* Writes(Option* option, Unwritable unwritable) {
  const auto check = [option, unwritable](const std::string& path) {
    const std::string by_default = option->get_default_str();
    const bool may_be_empty =
        !option->get_required() && (by_default.empty() || by_default == "\"\"");
    return path.empty() && may_be_empty ? path : std::string(unwritable(path));
  };
  return option->check(check, "", "output");
}

/// Same as Writes(), for a file.
template <typename Option>
Option* WritesFile(Option* option) {
  return Writes(option, [](const std::filesystem::path& path) { return UnwritableFile(path); });
}

/// Same as Writes(), for a file whose name ends in one of `endings`.
template <typename Option>
Option* WritesFile(Option* option, const std::vector<std::string>& endings,
                   bool makes_folders = false) {
  return Writes(option, [endings, makes_folders](const std::filesystem::path& path) {
    std::string list;
    for (const std::string& ending : endings) {
      if (path.extension() == ending) return UnwritableFile(path, makes_folders);
      list.append(list.empty() ? "" : ", ").append(ending);
    }
    return path.string() + ": the name must end in one of " + list;
  });
}

/// Same as Writes(), for a folder.
template <typename Option>
Option* WritesFolder(Option* option) {
  return Writes(option, UnwritableFolder);
}

/// Returns true if Writes() was called for the option.
template <typename Option>
bool IsOutput(Option& option) {
  try {
    static_cast<void>(option.get_validator("output"));
    return true;
  } catch (const std::exception&) {
    return false;
  }
}

/// Returns an error with its remedy if `output` exists and is an input of `command`, or lies in a
/// folder of an input folder, as the files of a dataset do. Otherwise returns "".
template <typename App>
std::string OverwrittenInput(App& command, const std::string& output) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(output, error)) return "";
  const std::filesystem::path folder = std::filesystem::canonical(output, error).parent_path();
  const auto contains = [&](const std::string& input) {
    if (!std::filesystem::is_directory(input, error)) return false;
    const std::filesystem::path above = std::filesystem::canonical(input, error);
    for (auto at = folder; at != at.parent_path(); at = at.parent_path()) {
      if (at.parent_path() == above) return true;
    }
    return false;
  };
  for (auto* option : command.get_options()) {
    if (IsOutput(*option)) continue;
    for (const std::string& input : option->results()) {
      if (std::filesystem::equivalent(input, output, error) || contains(input)) {
        return output + ": would overwrite " + option->get_name() + "; name another file";
      }
    }
  }
  return "";
}

/// Returns an error with its remedy if another option of `command` writes to `output`, else "".
template <typename App, typename Option>
std::string SharedOutput(App& command, const Option& asked, const std::string& output) {
  const auto place = [](const std::string& path) {
    std::error_code error;
    const std::filesystem::path found =
        std::filesystem::weakly_canonical(std::filesystem::absolute(path, error), error);
    return found.has_filename() ? found : found.parent_path();
  };
  std::error_code error;
  // Several outputs may share a device or a pipe.
  const bool keeps = std::filesystem::is_regular_file(output, error) ||
                     std::filesystem::is_directory(output, error) ||
                     !std::filesystem::exists(output, error);
  for (auto* option : command.get_options()) {
    if (!keeps || option == &asked || !IsOutput(*option) || option->count() == 0) continue;
    if (place(option->results().front()) == place(output)) {
      return output + ": is also the output of " + option->get_name() + "; name another path";
    }
  }
  return "";
}

/// Checks the outputs of the called commands, including default paths. An output that would
/// overwrite an input or another output of the same command is a usage error. Call this before
/// parsing.
template <typename App>
void CheckOutputs(App& app) {
  app.parse_complete_callback([&app] {
    for (App* command : app.get_subcommands()) {
      for (auto* option : command->get_options()) {
        if (!IsOutput(*option)) continue;
        const bool given = option->count() > 0;
        const std::string path = given ? option->results().front() : option->get_default_str();
        if (path.empty() || path == "\"\"") continue;
        std::string overwritten = OverwrittenInput(*command, path);
        if (overwritten.empty()) overwritten = SharedOutput(*command, *option, path);
        if (given && overwritten.empty()) continue;
        option->clear();
        option->add_result(path);
        option->check([overwritten](const std::string&) { return overwritten; });
        option->run_callback();
        option->clear();
      }
    }
  });
}

/// Calls CheckNumbers() and CheckOutputs(). Usage errors take one line, which suggests the closest
/// name for an unknown command or option. Call this after all options are added. `arguments` must
/// outlive the parse.
template <typename App>
void CheckArguments(App& app, std::span<const std::string> arguments) {
  app.failure_message([arguments](const App* program, const auto& error) {
    std::string fault = DescribeUnknown(*program, arguments);
    if (fault.empty() && error.get_name() == "ArgumentMismatch") {
      fault = DescribeCount(*program, arguments);
    }
    return program->get_name() + ": " + Printable(fault.empty() ? error.what() : fault) +
           "; --help lists commands and options\n";
  });
  CheckNumbers(app);
  CheckOutputs(app);
}

}  // namespace dfr::core
