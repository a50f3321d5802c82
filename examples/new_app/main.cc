// A new app: a custom task, models learned from its demonstrations, and the comparison of methods
// over trials, with intervals, in shards on a cluster if needed. Replace Task, Supervise() and
// Policy with your own.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"
#include "dfr/experiment/rollout_runner.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/safety/task_model.h"

namespace core = dfr::core;
namespace experiment = dfr::experiment;
namespace kernel = dfr::kernel;
namespace safety = dfr::safety;

namespace {

constexpr double kHalfWidth = 0.2;  // half width of the corridor
constexpr double kEnd = 3.0;

double Centre(double x) { return 0.3 * std::sin(2.0 * x); }

// A tip in a winding corridor. Controls of 1 are steps of 0.1.
class Task final : public core::SimulatedPlant {
 public:
  Task() { layout_.Add("tip", 2); }
  const core::StateLayout& layout() const noexcept override { return layout_; }
  int control_dim() const noexcept override { return 2; }
  void Reset(std::uint64_t seed) override {
    tip_ = {0.0, 0.05 * core::Random(seed).Normal()};
    collided_ = false;
  }
  core::PlantStatus Apply(std::span<const double> control) noexcept override {
    if (control.size() != 2 || !std::isfinite(control[0] + control[1])) {
      return core::PlantStatus::kRefused;
    }
    for (std::size_t k = 0; k < 2; ++k) tip_[k] += 0.1 * std::clamp(control[k], -1.0, 1.0);
    collided_ = collided_ || std::abs(tip_[1] - Centre(tip_[0])) > kHalfWidth;
    return core::PlantStatus::kOk;
  }
  void Observe(std::span<double> state) const noexcept override {
    std::copy(tip_.begin(), tip_.end(), state.begin());
  }
  bool completed() const noexcept override { return tip_[0] >= kEnd; }
  bool collided() const noexcept override { return collided_; }
  void Halt() noexcept override {}
  std::unique_ptr<core::SimulatedPlant> Clone() const override {
    return std::make_unique<Task>(*this);
  }
  void CopyStateFrom(const core::SimulatedPlant& other) noexcept override {
    tip_ = static_cast<const Task&>(other).tip_;
    collided_ = other.collided();
  }

 private:
  core::StateLayout layout_;
  std::array<double, 2> tip_ = {};
  bool collided_ = false;
};

core::Trajectory Supervise(std::uint64_t seed) {
  Task task;
  task.Reset(seed);
  core::Random random(core::DeriveSeed(seed, {1}));
  core::Trajectory demonstration;
  demonstration.states.resize(41, 2);
  demonstration.controls.resize(40, 2);
  for (int t = 0; t < 40; ++t) {
    task.Observe(core::Row(demonstration.states, t));
    const double x = demonstration.states(t, 0);
    const double y = demonstration.states(t, 1);
    const double across = 0.8 + 0.1 * random.Normal();
    const double up = 10.0 * (Centre(x + 0.08) - y) + 0.1 * random.Normal();
    // Controls are recorded as the task applies them.
    demonstration.controls.row(t) << std::clamp(across, -1.0, 1.0), std::clamp(up, -1.0, 1.0);
    if (task.Apply(core::Row(demonstration.controls, t)) != core::PlantStatus::kOk) break;
  }
  task.Observe(core::Row(demonstration.states, 40));
  demonstration.outcome = task.completed() ? core::Outcome::kCompleted : core::Outcome::kHalted;
  return demonstration;
}

// A policy that cuts corners. imitation::FitMlp() learns a policy from demonstrations.
class Policy final : public core::Policy {
 public:
  int state_dim() const noexcept override { return 2; }
  int control_dim() const noexcept override { return 2; }
  void Control(int, std::span<const double> x, std::span<double> u) const noexcept override {
    const double ahead = 0.8;
    const double rise = Centre(x[0] + ahead) - x[1];
    u[0] = 0.8 * ahead / std::hypot(ahead, rise);
    u[1] = 0.8 * rise / std::hypot(ahead, rise);
  }
};

// Models learned in one trial, with a controller for each method.
class Runner final : public experiment::RolloutRunner {
 public:
  Runner(const experiment::EvaluationUnit& unit, std::uint64_t seed,
         const std::vector<std::string>& methods, double gamma)
      : RolloutRunner(std::make_unique<Task>()) {
    std::vector<core::Trajectory> demonstrations;
    const auto trial = static_cast<std::uint64_t>(unit.trial);
    const auto count = static_cast<std::uint64_t>(unit.demonstrations);
    for (std::uint64_t i = 0; i < count; ++i) {
      demonstrations.push_back(Supervise(core::DeriveSeed(seed, {2, trial, i})));
    }
    model_ = std::make_unique<safety::TaskModel>(
        world().layout(), demonstrations,
        safety::TaskOptions{
            .published = kernel::TimeVaryingSupportOptions{.svm = {.nu = 0.05, .gamma = gamma}},
            .horizon = 60});
    for (const std::string& method : methods) {
      Add(method, model_->MakeController(safety::ParseMethod(method), policy_));
    }
  }

 private:
  bool Inside(std::span<const double> x) const override {
    return model_->support().Decision(0, x) >= 0.0;
  }

  Policy policy_;
  std::unique_ptr<safety::TaskModel> model_;
};

}  // namespace

int main(int argc, char** argv) try {
  experiment::EvaluationPlan plan;
  plan.methods = {"baseline", "dfr", "controller"};
  plan.learners = {"cutter"};
  plan.demonstrations = {20, 60};
  plan.trials = 5;
  plan.episodes = 20;
  double gamma = 20.0;
  experiment::ExperimentOptions options;
  options.out = "out/corridor";
  options.seed = 1;
  CLI::App app("Recovery of a policy that cuts corners, in a corridor");
  app.require_subcommand(1);
  CLI::App* command = app.add_subcommand("experiment", "all methods from the same start states");
  experiment::AddRunOptions(*command, options);
  command->option_defaults()->always_capture_default();
  command->add_option("--demonstrations", plan.demonstrations, "sizes of the sets, ascending")
      ->delimiter(',');
  command->add_option("--trials", plan.trials, "number of independent repetitions");
  command->add_option("--episodes", plan.episodes, "start states per trial and data point");
  command->add_option("--gamma", gamma, "gamma of the support's Gaussian kernel");
  if (const auto code = experiment::Parse(app, argc, argv)) return *code;

  plan.seed = options.seed;
  const experiment::OutputFolder folder(options, plan);
  const auto found = experiment::RunExperiment(
      "corridor", plan,
      [&](const experiment::EvaluationUnit& unit) {
        return std::make_unique<Runner>(unit, plan.seed, plan.methods, gamma);
      },
      {{"gamma", experiment::Exactly(gamma)}}, options);
  if (!found) return EXIT_SUCCESS;  // a shard has no summary before it is merged
  experiment::PrintTable(found->summary, std::cout);
  experiment::SaveReport(found->summary, {.title = "Corridor", .program = "corridor"},
                         options.out / "report.html");
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::cerr << "corridor: " << e.what() << '\n';
  return EXIT_FAILURE;
}
