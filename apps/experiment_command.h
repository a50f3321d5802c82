#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "dfr/experiment/experiment.h"

namespace dfr::apps {

/// Adds what all commands that compare methods let their users choose. `presets` says what each
/// preset runs, `methods` which methods there are.
inline void AddExperimentOptions(CLI::App& command, experiment::ExperimentOptions& options,
                                 const std::string& presets, const std::string& methods,
                                 const std::vector<std::string>& names = {"quick", "paper"}) {
  command.add_option("--preset", options.preset, presets)
      ->check(CLI::IsMember(names))
      ->capture_default_str();
  command.add_option("--out", options.out, "folder of summary.json and report.html")
      ->capture_default_str();
  command.add_option("--seed", options.seed, "of all that is random")->capture_default_str();
  command.add_option("--threads", options.threads, "0: one per core; the results are the same")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command.add_flag("--restart", options.restart,
                   "forget what an interrupted run left in --out instead of going on with it");
  command.add_flag("!--no-video", options.video, "leave the videos out");
  command.add_option("--methods", options.methods, methods)->delimiter(',');
  command.add_option("--trials", options.trials, "independent repetitions of everything")
      ->check(kCount);
  command.add_option("--episodes", options.episodes, "start states per trial and data point")
      ->check(kCount);
}

}  // namespace dfr::apps
