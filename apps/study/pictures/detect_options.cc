#include "apps/study/pictures/detect_options.h"

#include <CLI/CLI.hpp>

#include "apps/command_line.h"
#include "apps/study/study.h"

namespace dfr::study {

void AddOptions(CLI::App& command, Detection& detection) {
  command.footer(DetectionSources());
  CLI::Option* const file =
      command.add_option("file", detection.files,
                         "demonstrations, one file or several: robomimic, Minari or LeRobot; "
                         "default: those of --task");
  CLI::Option* const failures = command.add_option(
      "--failures", detection.failures,
      "file of further episodes, which failed unless they are labelled completed");
  command
      .add_flag("--unlike", detection.unlike,
                "count all episodes of --failures as failures, for example with another goal")
      ->needs(failures);
  failures->needs(file);
  command.add_option("--task", detection.task, "task of the gallery")
      ->check(dfr::apps::ReadBy(sim::FindGalleryTask))
      ->excludes(file)
      ->capture_default_str();
  command.add_option("--policy", detection.policy, "policy of the task's further episodes")
      ->check(dfr::apps::ReadBy([](const std::string& name) { CheckPolicy(Kind::kGuards, name); }))
      ->excludes(file)
      ->capture_default_str();
  command
      .add_option("--demonstrations", detection.demonstrations,
                  "number of demonstrations of the task")
      ->check(dfr::apps::kDemonstrations)
      ->excludes(file)
      ->capture_default_str();
  command.add_option("--episodes", detection.episodes, "number of further episodes of the task")
      ->check(dfr::apps::kCount)
      ->excludes(file)
      ->capture_default_str();
  command.add_option("--features", detection.features, "features of the guard; default: all");
  command
      .add_option("--false-alarms", detection.false_alarms,
                  "share of demonstrations that may raise an alarm; sets the thresholds")
      ->check(CLI::Range(0.01, 0.5))
      ->capture_default_str();
  command.add_option("--seed", detection.seed, "random seed")->capture_default_str();
}

}  // namespace dfr::study
