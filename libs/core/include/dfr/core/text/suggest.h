#pragma once

#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace dfr::core {

/// A name that is not among the valid ones. what() is "unknown KIND 'NAME'; valid: VALID". Programs
/// exit with 2, as after every usage error.
class UnknownName : public std::invalid_argument {
 public:
  UnknownName(std::string_view kind, std::string_view name, std::string_view valid)
      : std::invalid_argument("unknown " + std::string(kind) + " '" + std::string(name) +
                              "'; valid: " + std::string(valid)) {}
};

/// Returns the first name in `known` that differs from `name` by the fewest changed, missing, added
/// or swapped characters. Returns "" if all differ in more than a third of the characters and in
/// more than one character.
[[nodiscard]] std::string Closest(std::string_view name, std::span<const std::string> known);

/// Describes the first command or option in `arguments` that a program does not have, with the
/// closest name: "unknown option '--stratgy' (did you mean '--strategy'?)". Returns "" if there is
/// none. `App` has the interface of CLI::App (CLI11).
template <typename App>
std::string DescribeUnknown(const App& program, std::span<const std::string> arguments) {
  const auto describe = [](const std::string& kind, const std::string& name,
                           const std::vector<std::string>& known) {
    const std::string closest = Closest(name, known);
    return "unknown " + kind + " '" + name + "'" +
           (closest.empty() ? "" : " (did you mean '" + closest + "'?)");
  };
  const App* command = &program;
  for (const std::string& argument : arguments) {
    if (argument == "--") break;
    std::vector<std::string> known;
    if (argument.starts_with("--")) {
      for (const auto* option : command->get_options([](const auto*) { return true; })) {
        for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
      }
      const std::string name = argument.substr(0, argument.find('='));
      bool found = false;
      for (const std::string& other : known) found = found || other == name;
      if (!found) return describe("option", name, known);
    } else if (!argument.starts_with('-')) {
      const App* next = nullptr;
      for (const App* other : command->get_subcommands([](const App*) { return true; })) {
        known.push_back(other->get_name());
        if (other->get_name() == argument) next = other;
      }
      if (next != nullptr) {
        command = next;
      } else if (command == &program && !known.empty()) {
        return describe("command", argument, known);
      }
    }
  }
  return "";
}

}  // namespace dfr::core
