#pragma once

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdint>
#include <string>

#include "dfr/core/numbers.h"

namespace dfr::apps {

/// Numbers of horizons, repetitions and the like: no more of them than files and counters hold.
inline const CLI::Range kCount(1, 1'000'000);

/// For CLI::Option::check(). CLI11's own end with all 309 digits of the largest double.
inline const CLI::Validator kPositive(
    [](std::string& text) {
      const auto value = core::ParseNumber(text);
      return value && *value > 0.0 ? std::string() : "must be positive, not " + text;
    },
    "POSITIVE");
inline const CLI::Validator kNotNegative(
    [](std::string& text) {
      const auto value = core::ParseNumber(text);
      return value && *value >= 0.0 ? std::string() : "must not be negative, as " + text + " is";
    },
    "NONNEGATIVE");

/// A file that becomes larger than the system allows (ulimit -f) is an error of the write, as on a
/// full disk, and not the program's end by a signal. To be called before the first thread is made.
inline void IgnoreFileSizeSignal() { static_cast<void>(std::signal(SIGXFSZ, SIG_IGN)); }

/// Makes every option of a program and of its commands that takes a number read it as all of this
/// repository does (core/numbers.h): no NaN, no infinity, no hexadecimal or octal, no sign before
/// what cannot be negative, nothing that overflows. To be called when all options are added; checks
/// of an option's own range come on top.
inline void CheckNumbers(CLI::App& app) {
  for (CLI::Option* option : app.get_options()) {
    const std::string type = option->get_type_name();
    const auto check = [option](const char* what, bool (*good)(const std::string&)) {
      option->check(CLI::Validator(
          [what, good](std::string& text) {
            return good(text) ? std::string() : "'" + text + "' is not " + what;
          },
          ""));
    };
    if (type.starts_with("FLOAT")) {
      check("a finite decimal number",
            [](const std::string& text) { return core::ParseNumber(text).has_value(); });
    } else if (type.starts_with("UINT")) {
      check("a whole number from 0 on", [](const std::string& text) {
        return core::ParseInteger<std::uint64_t>(text).has_value();
      });
    } else if (type.starts_with("INT")) {
      check("a whole number", [](const std::string& text) {
        return core::ParseInteger<std::int64_t>(text).has_value();
      });
    }
  }
  for (CLI::App* command : app.get_subcommands([](CLI::App*) { return true; })) {
    CheckNumbers(*command);
  }
}

}  // namespace dfr::apps
