// A program like those of apps/, whose episodes are hashes and take no time, for tests of tools
// that run such programs.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <fstream>
#include <iostream>

#include "dfr/experiment/command_line.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"
#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/eventually.h"

int main(int argc, char** argv) try {
  using namespace dfr;  // NOLINT: this is their main
  CLI::App app("A fake experiment");
  app.require_subcommand(1);
  experiment::ExperimentOptions options;
  options.out = "out";
  double gamma = 5.0;
  bool cold = true;
  std::vector<int> demonstrations = {6, 60};
  std::filesystem::path fails_once;
  std::filesystem::path until;
  std::string before;
  bool all_methods = false;
  CLI::App* command = app.add_subcommand("experiment", "all methods");
  experiment::AddExperimentOptions(*command, options, "quick or paper", "baseline, dfr");
  command->add_option("--gamma", gamma)->capture_default_str();
  command->add_flag("--cold,!--warm", cold);
  command->add_option("--demonstrations", demonstrations)->delimiter(',')->capture_default_str();
  command->add_option("--until", until, "the third and later units wait for this file");
  command->add_option("--before", before, "a program to run before each unit");
  command->add_option("--fails-once", fails_once, "the first run creates this file and fails");
  command->add_flag("--all-methods", all_methods, "all methods with a colour");
  if (const auto code = experiment::Parse(app, argc, argv)) return *code;

  experiment::EvaluationPlan plan = test::FakePlan();
  for (const experiment::NamedStyle& style : experiment::NamedStyles()) {
    const bool outcome = style.method == style.name;
    if (all_methods && !outcome && std::ranges::count(plan.methods, style.method) == 0) {
      plan.methods.emplace_back(style.method);
    }
  }
  plan = experiment::ApplyTo(plan, options);
  plan.demonstrations = demonstrations;
  const experiment::OutputFolder folder(options, plan);
  std::atomic<int> made = 0;
  const auto found = experiment::RunExperiment(
      "fake", plan,
      [&](const experiment::EvaluationUnit& unit) {
        const int number = ++made;
        if (!before.empty() && std::system(("'" + before + "'").c_str()) != 0) {
          throw std::runtime_error("no " + before);
        }
        if (!until.empty() && number > 2) {
          test::Eventually([&] { return std::filesystem::exists(until); });
        }
        if (!fails_once.empty() && number == 2 && !std::filesystem::exists(fails_once)) {
          std::ofstream(fails_once) << "failed\n";
          throw std::runtime_error("the plant fell over");
        }
        // Stands in for a program whose results do not depend on its settings alone.
        const char* differs = std::getenv("DFR_FAKE_DIFFERS");
        experiment::EvaluationUnit other = unit;
        if (differs != nullptr && *differs != '\0') other.demonstrations += 1;
        return test::MakeFakeTrialRunner(other);
      },
      {{"gamma", experiment::Exactly(gamma)}, {"cold", cold ? "yes" : "no"}}, options);
  if (!found) return EXIT_SUCCESS;
  experiment::SaveReport(found->summary, {.title = "Fake", .program = "fake_experiment"},
                         options.out / "report.html");
  experiment::PrintTable(found->summary, std::cout);
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::cerr << "fake_experiment: " << e.what() << '\n';
  return EXIT_FAILURE;
}
