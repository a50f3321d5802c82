#include "convergence/convergence_report.h"

#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "convergence/convergence.h"
#include "dfr/core/random.h"

namespace dfr::apps::pusher {
namespace {

// Stream of the experiment's seed; see trial_runner.cc.
constexpr std::uint64_t kConvergenceStream = 5;
constexpr int kRecoveries = 50;

// Plots the left part of the paper's Fig. 5 over iterations and over applied controls. The number
// of controls determines a robot's time.
experiment::ReportFigure ConvergenceFigure(const std::vector<ConvergenceCurve>& curves,
                                           const std::string& learner, const std::string& which) {
  experiment::ReportFigure figure;
  figure.heading = "Speed of recoveries: " + which;
  figure.caption =
      "The decision function over the threshold of the switching policy, mean and standard error, "
      "of " +
      std::to_string(kRecoveries) + " recoveries per model, learner " + learner +
      ". The oracle simulates its probes and applies none of them; an iteration of "
      "DFR is a probe and a step. The controller climbs the same g here. pusher experiment "
      "--config FOLDER/run.toml --out FOLDER prints these figures again.";
  for (const bool iterations : {true, false}) {
    experiment::ReportPlot plot;
    plot.title = iterations ? "Over iterations" : "Over applied controls";
    plot.x_label = iterations ? "iterations" : "applied controls";
    plot.y_min = 0.5;
    plot.y_max = 1.0;
    for (const ConvergenceCurve& curve : curves) {
      experiment::ReportSeries series;
      series.name = curve.method == "dfr"          ? "DFR"
                    : curve.method == "controller" ? "Controller"
                                                   : "Oracle";
      const std::size_t stride =
          iterations ? static_cast<std::size_t>(curve.controls_per_iteration) : 1;
      for (std::size_t k = 0; k * stride < curve.mean.size() && k <= 500; ++k) {
        const double mean = curve.mean[k * stride];
        const double error = curve.standard_error[k * stride];
        series.x.push_back(static_cast<double>(k));
        series.y.push_back(mean);
        series.low.push_back(mean - error);
        series.high.push_back(mean + error);
      }
      plot.series.push_back(std::move(series));
    }
    figure.plots.push_back(std::move(plot));
  }
  return figure;
}

void PrintConvergence(const std::vector<ConvergenceCurve>& curves, const std::string& which,
                      int models) {
  std::printf(
      "\n%d recoveries (%s), g over its threshold after\n  %-18s %8s %8s %8s %8s   reached it\n",
      kRecoveries * models, which.c_str(), "controls", "0", "10", "100", "1000");
  for (const ConvergenceCurve& curve : curves) {
    std::printf("  %-18s %8.3f %8.3f %8.3f %8.3f   %d\n", curve.method.c_str(), curve.mean[0],
                curve.mean[10], curve.mean[100], curve.mean[1000], curve.reached);
  }
}

// Prints a line for each model, and adds their mean to the report.
void MeasureModels(const experiment::EvaluationPlan& plan, TrialRunnerFactory& factory,
                   std::uint64_t seed, experiment::ReportOptions& report) {
  std::vector<std::vector<ConvergenceCurve>> of_methods;
  std::printf("\nof %d recoveries: number that reach the threshold, and final g divided by it\n",
              kRecoveries);
  for (int trial = 0; trial < plan.trials; ++trial) {
    for (const int demonstrations : plan.demonstrations) {
      const std::unique_ptr<PusherTrialRunner> runner = factory.Make(
          {.trial = trial, .demonstrations = demonstrations, .learner = plan.learners.front()});
      const std::vector<ConvergenceCurve> curves = MeasureConvergence(*runner, kRecoveries, seed);
      of_methods.resize(curves.size());
      std::printf("  trial %d, %d demonstrations", trial, demonstrations);
      for (std::size_t i = 0; i < curves.size(); ++i) {
        std::printf("%s %s %d (%.3f)", i == 0 ? ":" : ",", curves[i].method.c_str(),
                    curves[i].reached, curves[i].mean.back());
        of_methods[i].push_back(curves[i]);
      }
      std::printf("\n");
    }
  }
  std::vector<ConvergenceCurve> means;
  means.reserve(of_methods.size());
  for (const std::vector<ConvergenceCurve>& curves : of_methods) {
    means.push_back(MeanOverModels(curves));
  }
  const int models = plan.trials * static_cast<int>(plan.demonstrations.size());
  const std::string which = "the first of each episode, " + std::to_string(models) + " models";
  PrintConvergence(means, which, models);
  report.figures.push_back(ConvergenceFigure(means, plan.learners.front(), which));
}

}  // namespace

void MeasureRecoveries(const ExperimentOptions& options, const experiment::EvaluationPlan& plan,
                       TrialRunnerFactory& factory, experiment::ReportOptions& report) {
  const std::uint64_t seed = core::DeriveSeed(plan.seed, {kConvergenceStream});
  if (options.preset == kFig5) return MeasureModels(plan, factory, seed, report);
  const std::unique_ptr<PusherTrialRunner> runner = factory.Make(
      {.trial = 0, .demonstrations = plan.demonstrations.back(), .learner = plan.learners.front()});
  const auto show = [&](const std::vector<ConvergenceCurve>& curves, const std::string& which) {
    PrintConvergence(curves, which, 1);
    report.figures.push_back(ConvergenceFigure(
        curves, plan.learners.front(),
        which + ", " + std::to_string(plan.demonstrations.back()) + " demonstrations"));
  };
  show(MeasureConvergence(*runner, kRecoveries, seed), "the first of each episode");
  const GateReach reach = MeasureReach(*runner, kRecoveries, seed);
  std::printf(
      "  g reaches the threshold in some state for %d of %d recoveries, and at some position of "
      "the "
      "gripper,\n  all else unchanged, for %d; the largest g over these positions is %.3f of the "
      "threshold on average\n",
      reach.any_state, reach.gates, reach.any_tip, reach.best_tip);
  show(MeasureEveryRecovery(*runner, kRecoveries, seed), "all of each episode");
}

}  // namespace dfr::apps::pusher
