#include <algorithm>
#include <cstdio>
#include <iterator>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "commands.h"
#include "dfr/core/build_info.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"
#include "dfr/experiment/summary.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180.0;
constexpr int kFewDemonstrations = 20;

// A condition of the test: its differences from the experiment.
struct Condition {
  std::string name;
  experiment::DisturbanceOptions disturbance = {};
  double supervisor_noise = 1.0;
  sim::Gripper gripper = sim::Gripper::kBar;
  bool few_demonstrations = false;
};

std::vector<Condition> Conditions() {
  return {
      {.name = "as demonstrated"},
      {.name = "20 demonstrations", .few_demonstrations = true},
      {.name = "supervisor's noise doubled", .supervisor_noise = 2.0},
      {.name = "gripper: wide bar", .gripper = sim::Gripper::kWideBar},
      {.name = "gripper: fork", .gripper = sim::Gripper::kFork},
      {.name = "observation noise, sd 0.5 mm, 0.5 mrad",
       .disturbance = {.observation_noise = 0.0005}},
      {.name = "observation noise, sd 2 mm, 2 mrad", .disturbance = {.observation_noise = 0.002}},
      {.name = "control turned, sd 10 degrees", .disturbance = {.rotation_sd = 10.0 * kDegree}},
      {.name = "control turned, sd 20 degrees", .disturbance = {.rotation_sd = 20.0 * kDegree}},
      {.name = "control turned, sd 40 degrees", .disturbance = {.rotation_sd = 40.0 * kDegree}},
      {.name = "control scaled, sd of log 0.2", .disturbance = {.scale_sd = 0.2}},
      {.name = "control scaled, sd of log 0.4", .disturbance = {.scale_sd = 0.4}},
      {.name = "actuator bias 0.1 of its range", .disturbance = {.bias = 0.1}},
  };
}

const experiment::Cell& CellOf(const experiment::Summary& summary, const std::string& condition,
                               const std::string& method) {
  for (const experiment::Cell& cell : summary.averages) {
    if (cell.learner == condition && cell.method == method) return cell;
  }
  throw std::logic_error("no results of " + method);
}

}  // namespace

void RunDrift(const DriftOptions& options) {
  const std::filesystem::path supervisor_file =
      options.supervisor.empty() ? ShippedSupervisor() : options.supervisor;
  const std::vector<imitation::GaussianPolicy> supervisor = {
      imitation::GaussianPolicy::Load(supervisor_file)};
  static_cast<void>(Learner::Parse(options.learner));
  TrialRunnerOptions site_options;
  for (const std::string& name : options.methods) {
    site_options.methods.push_back(study::ParseMethod(name));
  }
  site_options.most_demonstrations = std::max(options.demonstrations, kFewDemonstrations);
  site_options.seed = options.seed;
  // Conditions replace the learners of the plan.
  experiment::EvaluationPlan plan;
  plan.demonstrations = {options.demonstrations};
  plan = experiment::ApplyTo(std::move(plan), options);
  std::ranges::copy_if(plan.methods, std::back_inserter(plan.policies), study::IsPolicy);
  const std::vector<Condition> conditions = Conditions();
  std::map<std::string, std::unique_ptr<TrialRunnerFactory>> factories;
  for (const Condition& condition : conditions) {
    site_options.disturbance = condition.disturbance;
    site_options.supervisor_noise = condition.supervisor_noise;
    site_options.plant.gripper = condition.gripper;
    plan.learners.push_back(condition.name);
    factories[condition.name] =
        std::make_unique<TrialRunnerFactory>(supervisor, site_options, plan.trials);
  }
  const auto make = [&](const experiment::EvaluationUnit& unit) {
    const auto condition = std::ranges::find(conditions, unit.learner, &Condition::name);
    return factories.at(unit.learner)
        ->Make({.trial = unit.trial,
                .demonstrations =
                    condition->few_demonstrations ? kFewDemonstrations : unit.demonstrations,
                .learner = options.learner});
  };
  const experiment::OutputFolder folder(options, plan);
  const auto found = experiment::RunExperiment(
      "drift", plan, make,
      {{"learner", options.learner},
       {"supervisor's hash", experiment::HashOfFile(supervisor_file)}},
      options, [](const auto&, const auto& film) { CheckFilm(film, {}); });
  if (!found) return;
  if (!options.out.empty()) {
    experiment::SaveReport(found->summary,
                           {.title = "Pusher: how methods degrade", .program = "pusher"},
                           options.out / "report.html");
  }

  std::printf(
      "learner %s, %d demonstrations, %d episodes per method in %d trials, seed %llu, commit %s\n"
      "completed [95 %% interval] / collided [95 %% interval], %%\n",
      options.learner.c_str(), options.demonstrations, options.trials * options.episodes,
      options.trials, static_cast<unsigned long long>(options.seed),
      std::string(core::BuildCommit()).c_str());
  for (const Condition& condition : conditions) {
    std::printf("\n%s\n", condition.name.c_str());
    for (const std::string& method : options.methods) {
      const experiment::Cell& cell = CellOf(found->summary, condition.name, method);
      const auto& completed = cell.completed;
      const auto& collided = cell.collided;
      std::printf("  %-16s %5.1f [%5.1f, %5.1f] / %5.1f [%5.1f, %5.1f]\n", method.c_str(),
                  100.0 * completed.value, 100.0 * completed.interval.low,
                  100.0 * completed.interval.high, 100.0 * collided.value,
                  100.0 * collided.interval.low, 100.0 * collided.interval.high);
    }
  }
  std::fputs(study::MarksOf(options.methods).c_str(), stdout);
}

}  // namespace dfr::apps::pusher
