#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <iterator>
#include <optional>
#include <string>

#include "apps/usage_error.h"
#include "commands.h"
#include "convergence/convergence_report.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"
#include "dfr/study/placebo.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {
namespace {

constexpr int kVideoWidth = 480;
constexpr int kVideoHeight = 360;

experiment::EvaluationPlan MakePlan(const ExperimentOptions& options) {
  experiment::EvaluationPlan plan;
  plan.methods = {"baseline",      "early-stopping", "dfr",
                  "guard",         "controller",     "placebo-corrections",
                  "placebo-halts", "true-jacobian",  "baseline@none",
                  "lwr",           "lwr-cv",         "lwr-online",
                  "knn",           "ensemble",       "dart",
                  "dagger"};
  plan.learners = {"8", "8x100", "64-64"};
  plan.episodes = 60;
  if (options.preset == kFig5) {
    plan.methods = {"baseline", "early-stopping", "dfr", "guard", "controller"};
    plan.learners = {"8", "64-64"};
    plan.trials = 6;
    plan.supervisors = 3;
    plan.demonstrations = {60, 120};
  } else if (options.preset == "paper") {
    plan.trials = 10;
    plan.supervisors = kShippedSupervisors;
    for (int point = 6; point <= 120; point += 6) plan.demonstrations.push_back(point);
  } else {
    plan.trials = 2;
    plan.demonstrations = {20, 60, 120};
  }
  if (!options.learners.empty()) plan.learners = options.learners;
  if (options.supervisors > 0) plan.supervisors = options.supervisors;
  if (!options.supervisor.empty()) plan.supervisors = 1;
  if (!options.demonstrations.empty()) plan.demonstrations = options.demonstrations;
  plan = experiment::ApplyTo(std::move(plan), options);
  ValueOf("--methods", [&plan] { study::CheckPlacebos(plan.methods); });
  std::ranges::copy_if(plan.methods, std::back_inserter(plan.policies), study::IsPolicy);
  return plan;
}

std::string Text(double value) { return core::Format("%g", value); }  // six digits

std::string Percent(double share) {
  return std::isfinite(share) ? core::Format("%.1f %%", 100.0 * share) : "-";
}

// Settings that determine the results, in addition to the plan. A ledger with other settings is
// refused.
std::map<std::string, std::string> Settings(const ExperimentOptions& options,
                                            const std::filesystem::path& supervisor,
                                            const experiment::EvaluationPlan& plan) {
  using experiment::Exactly;
  const ModelOptions& model = options.model;
  return {{"supervisor", supervisor.filename().string()},
          {"supervisor's hash", experiment::HashOfFile(supervisor)},
          {"supervisors", std::to_string(plan.supervisors)},
          {"gripper", std::string(sim::Name(options.plant.gripper))},
          {"physics", std::string(sim::Name(options.plant.physics))},
          {"red_y", Exactly(options.plant.red_y)},
          {"start_x_min", Exactly(options.plant.start_x_min)},
          {"start_x_max", Exactly(options.plant.start_x_max)},
          {"start_y", Exactly(options.plant.start_y)},
          {"joint_step", Exactly(options.plant.joint_step)},
          {"nu", Exactly(model.nu)},
          {"gamma", Exactly(model.gamma)},
          {"whitened_gamma", Exactly(model.whitened_gamma)},
          {"horizon", std::to_string(model.horizon)},
          {"support_features", model.support_features},
          {"epochs", std::to_string(model.epochs)},
          {"learning_rate", Exactly(model.learner.learning_rate)}};
}

// Episode of the first learner for the video. Criteria, in this order: the reference collides, the
// method "controller" (or the last method) completes, this method recovers, most demonstrations.
struct Scene {
  experiment::EvaluationUnit unit;
  std::uint64_t start_seed = 0;
  std::uint64_t controller_seed = 0;
};

Scene ChooseScene(const experiment::EvaluationPlan& plan,
                  const std::vector<experiment::UnitResult>& results) {
  Scene chosen;
  int best = -1;
  const auto found = static_cast<std::size_t>(std::ranges::find(plan.methods, "controller") -
                                              plan.methods.begin());
  const std::size_t shown = std::min(found, plan.methods.size() - 1);
  for (const experiment::UnitResult& result : results) {
    if (result.unit.learner != plan.learners.front()) continue;
    for (std::size_t i = 0; i < result.starts.size(); ++i) {
      const bool collided = result.episodes.front()[i].outcome == core::Outcome::kCollided;
      const bool completed = result.episodes[shown][i].outcome == core::Outcome::kCompleted;
      const bool recovered = result.episodes[shown][i].recovery_controls > 0;
      const int merit = 4 * collided + 2 * completed + recovered;
      if (merit < best ||
          (merit == best && result.unit.demonstrations <= chosen.unit.demonstrations)) {
        continue;
      }
      best = merit;
      chosen.unit = result.unit;
      chosen.start_seed = result.starts[i];
      chosen.controller_seed =
          experiment::ControllerSeed(plan, result.unit.trial, static_cast<int>(i));
    }
  }
  return chosen;
}

// Returns the mean over the data points that define the measure; not a number if there are none.
double MeanMeasure(const experiment::Summary& summary, const std::string& name) {
  double sum = 0.0;
  int count = 0;
  for (const experiment::MeasureMean& measure : summary.measures) {
    if (measure.name != name || !std::isfinite(measure.mean)) continue;
    sum += measure.mean;
    ++count;
  }
  return sum / count;
}

const experiment::Contrast* FindContrast(const experiment::Summary& summary,
                                         const std::string& method, const std::string& learner) {
  for (const experiment::Contrast& contrast : summary.contrasts) {
    if (contrast.method == method && contrast.learner == learner) return &contrast;
  }
  return nullptr;
}

// The paper's figures (Sec. V-A) beside ours, for the first learner.
experiment::ReportTable PaperTable(const experiment::Summary& summary,
                                   const experiment::EvaluationPlan& plan) {
  experiment::ReportTable table;
  table.heading = "The paper's figures beside these";
  table.caption =
      "Averages over the data points. The paper gives processor time per trajectory, which depends "
      "on the simulator; the number of applied controls does not. Times measured here are in "
      "times.json.";
  table.header = {"figure", "paper", "here, learner " + plan.learners.front()};
  const auto add = [&](const experiment::Contrast& contrast,
                       const std::vector<std::string>& outcomes, const std::string& name,
                       const std::string& paper, std::string here) {
    table.rows.push_back({name, paper, std::move(here)});
    std::string commands;
    for (const std::string& method : {contrast.method, contrast.against}) {
      commands.append(commands.empty() ? "" : "\n")
          .append(experiment::EpisodesCommand(
              "pusher", {.method = method, .learner = contrast.learner, .outcomes = outcomes}));
    }
    table.commands.push_back({"", "", commands});
  };
  for (const std::string method : {"dfr", "early-stopping"}) {
    const auto* contrast = FindContrast(summary, method, plan.learners.front());
    if (contrast == nullptr) continue;
    const std::string label = method == "dfr" ? "DFR" : "Early Stopping";
    const bool dfr = method == "dfr";
    const auto& ratios = contrast->ratios;
    if (ratios.collision_reduction.has_value()) {
      add(*contrast, {"collided"}, label + ": fewer collisions than Baseline",
          dfr ? "83 %" : "not given", Percent(*ratios.collision_reduction));
    }
    if (ratios.completion_ratio.has_value()) {
      add(*contrast, {"completed"}, label + ": completions relative to Baseline's",
          dfr ? "65 %" : "not given", Percent(*ratios.completion_ratio));
    }
    if (contrast->controls_ratio.has_value()) {
      add(*contrast, {}, label + ": applied controls relative to Baseline's",
          dfr ? "not given; time 11.5" : "not given; time 0.54",
          Text(std::round(100.0 * *contrast->controls_ratio) / 100.0));
    }
  }
  return table;
}

experiment::ReportFigure OverlapFigure(const experiment::Summary& summary,
                                       const experiment::EvaluationPlan& plan) {
  experiment::ReportFigure figure;
  figure.heading = "Overlap of the support with the red regions";
  figure.caption =
      "P(red | g >= 0): among the states around the demonstrated ones (cylinder displaced by up to "
      "0.15 m, joints by up to 0.1 rad) that are inside the estimate, the share that "
      "collides. No recovery that climbs g can avoid these.";
  experiment::ReportPlot plot;
  plot.title = "Overlap";
  plot.x_label = "demonstrations";
  plot.percent = true;
  plot.y_min = 0.0;
  experiment::ReportSeries series;
  series.name = "P(red | g >= 0)";
  for (const experiment::MeasureMean& measure : summary.measures) {
    if (measure.name != "overlap" || measure.learner != plan.learners.front()) continue;
    series.x.push_back(measure.demonstrations);
    series.y.push_back(measure.mean);
  }
  plot.series.push_back(std::move(series));
  figure.plots.push_back(std::move(plot));
  return figure;
}

experiment::ReportOptions MakeReport(const ExperimentOptions& options,
                                     const experiment::EvaluationPlan& plan,
                                     const experiment::Summary& summary,
                                     const std::map<std::string, std::string>& settings) {
  experiment::ReportOptions report;
  report.program = "pusher";
  report.title = "Pusher: safe execution of a learned policy";
  report.introduction =
      "A 7-joint arm pushes a cylinder over a goal, past two red regions that neither arm nor "
      "cylinder may touch. A policy is learned from a supervisor's demonstrations. The paper's "
      "methods run the policy alone (Baseline), halt near the boundary of the demonstrated states' "
      "support (Early Stopping), or recover there (Derivative-Free Recovery, DFR). "
      "The controller runs guided recovery: it estimates the response of the state to controls "
      "online. If a learned control would not end well inside, the controller applies the control "
      "of nearby demonstrations, corrected "
      "towards the inside. All methods start from the same states.";
  std::ranges::copy_if(plan.methods, std::inserter(report.unjudged, report.unjudged.end()),
                       study::IsComparison);
  for (const std::string& learner : plan.learners) {
    report.learner_names[learner] = learner + " tanh";
  }
  report.settings.assign(settings.begin(), settings.end());
  report.settings.emplace_back("trials", std::to_string(plan.trials));
  report.settings.emplace_back("episodes per trial and data point", std::to_string(plan.episodes));
  report.settings.emplace_back("learner's control",
                               "joint steps of at most " + Text(options.plant.joint_step) + " rad");
  report.settings.emplace_back("lambda", "per time step, the demonstrations' maximum");
  report.settings.emplace_back(
      "DFR", "probe g/(500 lambda), step |g|/(50 lambda), at most 500 iterations");
  report.settings.emplace_back("controller", "the defaults of control::GuidedOptions");
  report.figures.push_back(OverlapFigure(summary, plan));
  report.tables.push_back(PaperTable(summary, plan));
  report.notes.push_back(
      {"Notes on the figures",
       "The weak learner (8 tanh units, 10 epochs of Adam) cannot match the supervisor: that is "
       "the paper's regime. The stronger one (64-64) is for comparison.\n\n"
       "Demonstrations sample the supervisor's Gaussian policy. With its mean action all of them "
       "would have the same timing, and a learner that lags would leave the time-indexed "
       "support at once.\n\n"
       "Demonstrations with a violation are discarded: " +
           Text(std::round(10.0 * MeanMeasure(summary, "discarded_demonstrations")) / 10.0) +
           " per trial on average. Start states outside the support of t = 0 are drawn again, "
           "because no arm motion can correct them.\n\n"
           "The scene decides these figures as much as the method does: where the gate is tight, "
           "or the demonstrations spread, the support covers part of the red regions, and then "
           "DFR collides inside it. Start states, the supervisor's reward and the end of its "
           "training were chosen while looking at Baseline's and DFR's figures, with seeds that "
           "are "
           "not used here; the algorithm and its constants are the authors'. docs/pusher.md lists "
           "what was tried."});
  report.notes.push_back(
      {"Information used by the methods",
       "LWR and nearest neighbours are regressions on the same demonstrations, without any "
       "support: "
       "where they complete as much as the controller does, this task ranks controllers, not "
       "policies.\n\n"
       "The controller has no given model. Local dynamics are learned from demonstrated and "
       "applied "
       "transitions.\n\n"
       "The ensemble halts where five learners disagree more than in any demonstrated state. DART "
       "learns from separate demonstrations with injected noise. DAgger queries the supervisor in "
       "every state that it visits, in ten rounds, and collides while it learns. The "
       "filter with the true Jacobian is an oracle: it tries controls on a copy of the plant, and "
       "uses the controller's support."});
  if (options.preset == "quick") {
    report.notes.push_back(
        {"Quick preset",
         "Two trials and three data points: the intervals are wide. pusher experiment --preset "
         "paper runs ten trials of five supervisors and twenty data points."});
  }
  return report;
}

TrialRunnerFactory MakeFactory(const ExperimentOptions& options,
                               const experiment::EvaluationPlan& plan) {
  TrialRunnerOptions site_options;
  for (const std::string& name : plan.methods) {
    site_options.methods.push_back(study::ParseCompared(name));
  }
  ValueOf("--methods, --learners, --demonstrations", [&plan] { experiment::CheckPlan(plan); });
  site_options.model = options.model;
  site_options.plant = options.plant;
  site_options.most_demonstrations =
      *std::max_element(plan.demonstrations.begin(), plan.demonstrations.end());
  site_options.seed = plan.seed;
  const std::vector<imitation::GaussianPolicy> supervisors =
      options.supervisor.empty() ? LoadShippedSupervisors(plan.supervisors)
                                 : std::vector{LoadSupervisor(options.supervisor)};
  return {supervisors, site_options, plan.trials};
}

}  // namespace

void RunExperiment(const ExperimentOptions& options) {
  const experiment::EvaluationPlan plan = MakePlan(options);
  TrialRunnerFactory factory = MakeFactory(options, plan);
  const experiment::OutputFolder folder(options, plan);
  std::map<std::string, std::string> settings = Settings(
      options, options.supervisor.empty() ? ShippedSupervisor() : options.supervisor, plan);
  for (int i = 2; options.supervisor.empty() && i <= plan.supervisors; ++i) {
    settings["supervisor " + std::to_string(i) + "'s hash"] =
        experiment::HashOfFile(ShippedSupervisor(i));
  }
  const auto make = [&](const experiment::EvaluationUnit& unit) {
    std::unique_ptr<PusherTrialRunner> runner = factory.Make(unit);
    runner->JudgeIn(plan, unit);
    return runner;
  };
  const auto check_film = [&](const std::filesystem::path& film) {
    CheckFilm(film, options.plant);
  };
  CheckExperimentVideo(options, check_film);
  const std::optional<experiment::ExperimentResult> found =
      experiment::RunExperiment("pusher", plan, make, settings, options,
                                [&](const auto&, const auto& film) { check_film(film); });
  if (!found) return;
  const auto& [results, summary] = *found;
  experiment::PrintTable(summary, std::cout);
  std::cout << study::MarksOf(plan.methods);
  std::printf("overlap P(red | g >= 0): %s on average over the data points\n",
              Percent(MeanMeasure(summary, "overlap")).c_str());

  for (const experiment::MeasureMean& measure : summary.measures) {
    if (measure.name == "controls_per_recovery controller" &&
        measure.demonstrations == plan.demonstrations.back()) {
      std::printf(
          "controller, learner %s, %d demonstrations: median of %.1f controls per recovery\n",
          measure.learner.c_str(), measure.demonstrations, measure.mean);
    }
  }

  experiment::ReportOptions report = MakeReport(options, plan, summary, settings);
  if (options.convergence) {
    try {
      MeasureRecoveries(options, plan, factory, report);
    } catch (const std::runtime_error& e) {
      const std::string missing = std::string(e.what()) + "; --no-convergence leaves this out";
      std::cerr << "pusher: speed of recoveries: " << missing << std::endl;
      report.notes.push_back({"Speed of recoveries: not measured", missing});
    }
  }
  if (options.video) {
    const Scene scene = ChooseScene(plan, results);
    const std::unique_ptr<PusherTrialRunner> runner = make(scene.unit);
    const std::vector<RolloutVideo> videos = RecordRollouts(
        *runner, plan.methods, scene.start_seed, scene.controller_seed, kVideoWidth, kVideoHeight);
    WriteVideo(options.out / "rollouts.mp4", videos);
    WriteStill(options.out / "rollouts.png", videos, SIZE_MAX);
    const std::string caption =
        "One start state, by each method: learner " + scene.unit.learner + ", " +
        std::to_string(scene.unit.demonstrations) + " demonstrations, trial " +
        std::to_string(scene.unit.trial) +
        ". Below, the decision function and the gate's threshold. Chosen, if possible, because the "
        "reference collides and the controller completes.";
    report.media.push_back({options.out / "rollouts.mp4", caption});
  }
  experiment::SaveReport(summary, report, options.out / "report.html");
  std::printf("\nthe report:  %s\nits figures: %s\n", (options.out / "report.html").c_str(),
              (options.out / "summary.json").c_str());
}

}  // namespace dfr::apps::pusher
