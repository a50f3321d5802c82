#pragma once

#include <concepts>
#include <cstdint>
#include <string>

#include "dfr/core/numbers.h"

namespace dfr::core {

/// Makes every numeric option of a program and its commands follow numbers.h: decimal, also with
/// leading zeros, where CLI11 reads octal; no NaN, infinity, hexadecimal or overflow, and no sign
/// where a number cannot be negative. Call this after all options are added. Options may have
/// additional range checks. `App` has the interface of CLI::App (CLI11).
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
    if (type.starts_with("FLOAT")) {
      option->check([](const std::string& text) {
        return ParseNumber(text) ? std::string() : "'" + text + "' is not a finite decimal number";
      });
    } else if (type.starts_with("UINT")) {
      is_whole(option, "a whole number from 0 on", std::uint64_t{});
    } else if (type.starts_with("INT")) {
      is_whole(option, "a whole number", std::int64_t{});
    }
  }
  for (App* command : app.get_subcommands([](App*) { return true; })) CheckNumbers(*command);
}

}  // namespace dfr::core
