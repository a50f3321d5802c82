#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "apps/gallery/picture.h"
#include "apps/gallery/study.h"
#include "apps/policies.h"
#include "dfr/core/random.h"
#include "dfr/experiment/command_line.h"

namespace dfr::apps::gallery {
namespace {

void List() {
  for (const bool judgement : {false, true}) {
    std::printf("%s\n", judgement ? "judgement" : "design");
    for (const sim::GalleryTask& task : sim::GalleryTasks()) {
      if (task.judgement != judgement) continue;
      std::printf("  %-15s %s\n", task.name.c_str(), task.summary.c_str());
      std::printf(
          "  %-15s demonstrated in %d controls at most; the guard looks at %s; a control of zero "
          "%s\n",
          "", task.horizon, task.features.empty() ? "all" : task.features.c_str(),
          task.aftermath == 0 ? "holds still" : "lets the world move on");
    }
  }
}

void RunAndPrint(Study study, const std::vector<std::string>& words, bool causes) {
  study.tasks = SelectTasks(words);
  const std::vector<Row> rows = RunStudy(study);
  if (rows.empty()) return;
  PrintTable(rows, causes, std::cout);
  if (!study.out.empty()) SaveCsv(rows, study.out / "gallery.csv");
}

// How often the supervisor completes, and fails, in how many controls.
void Supervise(const std::vector<std::string>& words, int count, std::uint64_t seed) {
  std::printf("%-15s %7s %8s %9s\n", "task", "ok %", "failed %", "controls");
  for (const std::string& name : SelectTasks(words)) {
    const sim::GalleryTask& task = sim::FindGalleryTask(name);
    int ok = 0, failed = 0, controls = 0;
    for (int i = 0; i < count; ++i) {
      const core::Trajectory trajectory =
          sim::DemonstrateOnce(task, core::DeriveSeed(seed, {static_cast<std::uint64_t>(i)}));
      ok += trajectory.outcome == core::Outcome::kCompleted ? 1 : 0;
      failed += trajectory.outcome == core::Outcome::kCollided ? 1 : 0;
      controls += trajectory.num_steps();
    }
    std::printf("%-15s %7.1f %8.1f %9.1f\n", name.c_str(), 100.0 * ok / count,
                100.0 * failed / count, static_cast<double>(controls) / count);
  }
}

}  // namespace
}  // namespace dfr::apps::gallery

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  using namespace dfr::apps::gallery;  // NOLINT: this is their main
  CLI::App app("Small tasks of many kinds, with the guard at its default settings");
  app.require_subcommand(1);
  Study study;
  std::vector<std::string> tasks = {"all"};
  const auto common = [&](CLI::App* command) {
    command->add_option("--tasks", tasks, "names, design, judgement or all")
        ->delimiter(',')
        ->capture_default_str();
    command->add_option("--episodes", study.episodes, "of each policy")->capture_default_str();
  };
  auto* list = app.add_subcommand("list", "What there is");
  auto* run =
      app.add_subcommand("run", "Every method with every policy from the same start states");
  common(run);
  dfr::experiment::AddRunOptions(*run, study);
  run->add_option("--policies", study.policies,
                  "good, weak, biased, or " + dfr::apps::Join(dfr::apps::kPolicies))
      ->delimiter(',')
      ->capture_default_str();
  run->add_option("--methods", study.methods)->delimiter(',')->capture_default_str();
  run->add_option("--demonstrations", study.demonstrations)->capture_default_str();
  run->add_option("--trials", study.trials, "each with its own demonstrations and policies")
      ->capture_default_str();
  bool causes = false;
  run->add_flag("--causes", causes, "why episodes were not completed");
  auto* supervise = app.add_subcommand("supervise", "How well the supervisors do");
  common(supervise);
  supervise->add_option("--seed", study.seed)->capture_default_str();
  std::string pictured, policy = "weak", entries;
  std::filesystem::path page = "gallery.html";
  int count = 5;
  auto* picture =
      app.add_subcommand("picture", "A page with paths of one task, to open in a browser");
  picture->add_option("task", pictured)->required();
  picture->add_option("--policy", policy)->capture_default_str();
  picture->add_option("--methods", study.methods)->delimiter(',')->capture_default_str();
  picture->add_option("--entries", entries, "two of the state, tip or box[0:2]; the first two");
  picture->add_option("--count", count, "demonstrations, and episodes of each method")
      ->capture_default_str();
  picture->add_option("--seed", study.seed)->capture_default_str();
  picture->add_option("--out", page)->capture_default_str();
  dfr::apps::CheckNumbers(app);
  if (const auto code = dfr::experiment::Parse(app, argc, argv)) return *code;

  if (*list) List();
  if (*run) RunAndPrint(study, tasks, causes);
  if (*supervise) Supervise(tasks, study.episodes, study.seed);
  if (*picture) {
    SavePicture(Record(study, pictured, policy, count), dfr::sim::FindGalleryTask(pictured),
                entries, page);
  }
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::cerr << "gallery: " << e.what() << '\n';
  return EXIT_FAILURE;
}
