// Connects a robot: what has to be made and checked before line_tracking runs on one.
#include <CLI/CLI.hpp>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <string>

#include "dfr/core/build_info.h"

namespace dfr::apps {
namespace {

int Main(int argc, char** argv) {
  CLI::App app("What a robot's network and devices need before a program drives them.", "hardware");
  app.set_version_flag("--version",
                       std::string(core::BuildVersion()) + " (" + core::BuildCommit() + ")");
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);
  int result = EXIT_SUCCESS;

  CLI11_PARSE(app, argc, argv);
  return result;
}

}  // namespace
}  // namespace dfr::apps

int main(int argc, char** argv) try {
  return dfr::apps::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "hardware: " << e.what() << '\n';
  return EXIT_FAILURE;
}
