#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>
#include <iterator>
#include <mutex>
#include <span>
#include <stdexcept>
#include <utility>

#include "apps/usage_error.h"
#include "commands/commands.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/intervals.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"
#include "dfr/study/placebo.h"
#include "probe_study.h"
#include "rollout_video.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr int kDemonstrations = 50;
constexpr int kDemonstratedSteps = 50;
constexpr int kCalibrationFrames = 300;
constexpr std::size_t kCurves = 30;
// Number of episodes in the study of probes, and largest number of controls in each. With images,
// an episode with fine probes would otherwise take a thousand controls without effect.
constexpr int kStudiedEpisodes = 8;
constexpr int kStudiedControls = 200;

// Streams of the experiment's seed; 0 and 1 are for start states and controllers.
enum Stream : std::uint64_t { kDemonstrationStream = 2, kLearnerStream, kCalibrationStream };

experiment::EvaluationPlan MakePlan(const ExperimentOptions& options) {
  const bool paper = options.preset == "paper";
  experiment::EvaluationPlan plan;
  plan.methods = {"baseline",      "early-stopping", "dfr",
                  "guard",         "controller",     "placebo-corrections",
                  "placebo-halts", "true-jacobian",  "baseline@none",
                  "lwr",           "lwr-cv",         "lwr-online",
                  "knn",           "ensemble",       "proportional"};
  plan.learners = options.worlds;
  plan.demonstrations = {kDemonstrations};
  plan.trials = paper ? 5 : 2;
  plan.episodes = paper ? 50 : 15;
  plan = experiment::ApplyTo(std::move(plan), options);
  ValueOf("--methods", [&plan] { study::CheckPlacebos(plan.methods); });
  std::ranges::copy_if(plan.methods, std::back_inserter(plan.policies), [](const auto& method) {
    return study::IsPolicy(method) || method == "proportional";
  });
  return plan;
}

std::string Text(double value) { return core::Format("%g", value); }

std::map<std::string, std::string> Settings(const ExperimentOptions& options) {
  const sim::DisturbanceOptions& d = options.plant.disturbance;
  std::map<std::string, std::string> settings;
  settings["observation"] =
      options.plant.observation == sim::Observation::kVision ? "images" : "ground truth";
  settings["disturbance"] =
      std::string(sim::Name(d.wave)) + (d.during ? ", during controls" : "") +
      (d.between ? ", between controls for " + experiment::Exactly(d.pause_s) + " s" : "");
  std::string amplitudes;
  for (std::size_t k = 0; k < 6; ++k) {
    amplitudes += (k > 0 ? ", " : "") +
                  experiment::Exactly(k < 3 ? 1e3 * d.amplitude[k] : d.amplitude[k]) + " at " +
                  experiment::Exactly(d.frequency[k]);
  }
  settings["disturbance x, y, z [mm], roll, pitch, yaw [rad] at frequency"] = amplitudes;
  settings["arm"] = std::to_string(options.plant.arm.seed);
  settings["blur [px]"] = experiment::Exactly(options.plant.endoscope.blur_px);
  settings["noise of the image"] = experiment::Exactly(options.plant.endoscope.noise);
  settings["start scatter [m]"] = experiment::Exactly(options.plant.start_scatter_m);
  settings["arm error, mean [mm]"] = experiment::Exactly(1e3 * options.plant.arm.mean_error_m);
  settings["nu"] = experiment::Exactly(options.model.nu);
  std::string gammas;
  for (double gamma : options.model.gammas)
    gammas += (gammas.empty() ? "" : ", ") + experiment::Exactly(gamma);
  settings["gamma candidates [1/mm^2]"] = gammas;
  settings["held-out acceptance wanted"] = experiment::Exactly(options.model.acceptance);
  settings["support features"] = options.model.support_features;
  settings["whitened gamma"] = experiment::Exactly(options.model.whitened_gamma);
  settings["horizon"] = std::to_string(options.model.horizon);
  return settings;
}

// Averages over the curves at each iteration; a recovery that has ended stays at its last value, as
// in the paper's figure.
experiment::ReportSeries Average(const std::vector<std::vector<double>>& curves) {
  experiment::ReportSeries series;
  series.name = "mean of " + std::to_string(curves.size()) + " recoveries";
  std::size_t longest = 0;
  for (const auto& curve : curves) longest = std::max(longest, curve.size());
  const std::size_t stride = std::max<std::size_t>(1, longest / 100);
  const experiment::MeanCurve average = experiment::AverageCurves(curves, longest);
  for (std::size_t i = 0; i < longest; i += stride) {
    series.x.push_back(static_cast<double>(i));
    series.y.push_back(average.mean[i]);
    if (curves.size() == 1) continue;  // no standard error
    series.low.push_back(average.mean[i] - average.standard_error[i]);
    series.high.push_back(average.mean[i] + average.standard_error[i]);
  }
  return series;
}

struct StudiedMethod {
  std::string name;
  std::string constants;
  ProbeStudy study;
};

// Runs Algorithm 1 with each choice of its constants, from the same start states.
std::vector<StudiedMethod> StudyProbes(LineTrialRunner& runner,
                                       std::span<const std::string> methods,
                                       const experiment::EvaluationPlan& plan,
                                       std::span<const std::uint64_t> starts) {
  std::vector<StudiedMethod> studied;
  for (std::size_t m = 0; m < methods.size(); ++m) {
    const control::DfrOptions dfr = study::ParseMethod(methods[m], kOtherLineMethods).published_dfr
                                        ? control::DfrOptions{}
                                        : Controllers().dfr;
    studied.push_back({methods[m],
                       "g / (" + Text(1.0 / dfr.probe_fraction) + " lambda), g / (" +
                           Text(1.0 / dfr.step_fraction) + " lambda)",
                       ProbeStudy(runner.model(), runner.plant())});
    const auto episodes = std::min<std::size_t>(kStudiedEpisodes, starts.size());
    for (std::size_t i = 0; i < episodes; ++i) {
      runner.RunObserved(static_cast<int>(m), starts[i],
                         experiment::ControllerSeed(plan, 0, static_cast<int>(i)),
                         &studied.back().study, kStudiedControls);
    }
  }
  return studied;
}

std::string Rounded(double value, int digits) {
  return std::isfinite(value) ? core::Format("%.*f", digits, value) : "-";
}

experiment::ReportTable ProbeTable(const std::vector<StudiedMethod>& studied) {
  experiment::ReportTable table;
  table.heading = "Information in probes";
  table.caption =
      "Algorithm 1 leaves the lengths of probe and step open. This table compares probes of the "
      "first trial's first " +
      std::to_string(kStudiedEpisodes) + " episodes, at most " + std::to_string(kStudiedControls) +
      " controls each, in the frozen world, with the simulation's exact numbers. It has the median "
      "probe, the "
      "median error of the measured change of distance across a probe, and the share of probes "
      "whose measured change of g has the right sign, including the effect of the platform's "
      "motion. "
      "Out of reach: the gate's threshold lambda |u| exceeded g of every demonstrated "
      "state.";
  table.header = {"method",     "probe, step", "probes", "size [um]",   "error [um]",
                  "sign right", "recoveries",  "ended",  "out of reach"};
  // The ledger does not contain these results: only the run itself prints them.
  const std::string again = "line_tracking experiment --config FOLDER/run.toml --out FOLDER";
  for (const StudiedMethod& method : studied) {
    const ProbeStudy& study = method.study;
    std::vector<std::string>& commands = table.commands.emplace_back(table.header.size(), again);
    commands[0] = commands[1] = "";
    table.rows.push_back({method.name, method.constants, std::to_string(study.probes()),
                          Rounded(study.size_um(), 1), Rounded(study.error_um(), 1),
                          Rounded(100.0 * study.right_sign(), 0) + " %",
                          std::to_string(study.recoveries()), std::to_string(study.ended()),
                          std::to_string(study.out_of_reach())});
  }
  return table;
}

// Picks three episodes. Best: completed with the fewest controls. Worst: the collision with the
// most controls, otherwise the halt with the most. Median: in the middle of this order.
std::vector<std::pair<std::string, std::uint64_t>> PickEpisodes(const experiment::UnitResult& unit,
                                                                std::size_t method) {
  std::vector<std::size_t> order(unit.starts.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  const auto& episodes = unit.episodes[method];
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    if (episodes[a].outcome != episodes[b].outcome)
      return episodes[a].outcome < episodes[b].outcome;
    return episodes[a].controls < episodes[b].controls;
  });
  return {{"best", order.front()}, {"median", order[order.size() / 2]}, {"worst", order.back()}};
}

experiment::ReportOptions MakeReport(const ExperimentOptions& options,
                                     const experiment::EvaluationPlan& plan,
                                     const std::map<std::string, std::string>& settings) {
  experiment::ReportOptions report;
  report.title = "Line tracking";
  report.program = "line_tracking";
  report.introduction =
      "A da Vinci arm follows a red line on gauze that a Stewart platform moves, seen by an "
      "endoscope. Demonstrations are open-loop and undisturbed, so the learned policy has no "
      "feedback: recovery must supply it.";
  std::ranges::copy_if(plan.methods, std::inserter(report.unjudged, report.unjudged.end()),
                       study::IsComparison);
  for (const std::string& world : plan.learners) {
    report.learner_names[world] = world == "frozen" ? "frozen: the platform stops with the robot"
                                                    : world + " from picture to control";
  }
  for (const auto& [name, value] : settings) report.settings.emplace_back(name, value);
  report.tables.push_back({"The paper's robot",
                           "Sec. V-B, on the da Vinci; collisions -84 %, completions x 2.2.",
                           {"method", "completed", "halted", "collided"},
                           {{"Baseline", "24 %", "0 %", "76 %"}, {"DFR", "52 %", "36 %", "12 %"}}});
  const bool images = options.plant.observation == sim::Observation::kVision;
  report.notes.push_back(
      {"DFR's two constants",
       std::string(
           "Algorithm 1 requires a probe |u_delta| << g / lambda and a step eta < g / "
           "lambda; the paper does not give their values on its robot. \"DFR\" here probes "
           "with g / (10 lambda) and steps by g / (2 lambda); \"dfr-fine\" has the constants "
           "of the paper's simulations, g / (500 lambda) and g / (50 lambda). ") +
           (images ? "The table above shows their effect: the probe is shorter than the image's "
                     "error from picture to picture, the measured sign of its effect is nearly "
                     "random, and the steps are a random walk that the iteration limit ends. "
                     "With the simulation's exact numbers (--observation truth) both choices have "
                     "the same effect."
                   : "With the simulation's exact numbers, as here, both choices have the same "
                     "effect. With "
                     "images the fine probe is shorter than the error from picture to picture.") +
           " --methods baseline,dfr-fine runs whole episodes with the fine constants.\n\n"
           "If DFR halts with iteration-limit, the gate requires more than recovery reaches: "
           "its threshold "
           "lambda |u| grows with the kernel's gamma; with gamma 0.05 or more it exceeds the "
           "largest g of some time step. If it halts with outside-support, a control or the "
           "platform has moved the tip to g < 0, from which Algorithm 1 cannot return."});
  return report;
}

// Plots g over recoveries of Algorithm 1, from a trial's start states.
experiment::ReportFigure RecoveryFigure(LineTrialRunner& runner,
                                        const experiment::EvaluationPlan& plan,
                                        const std::string& world,
                                        std::span<const std::uint64_t> starts) {
  experiment::ReportPlot plot{.title = "g over the gate's threshold",
                              .x_label = "iteration of the recovery",
                              .y_min = 0.0,
                              .y_max = 1.0};
  for (std::size_t m = 0; m < plan.methods.size(); ++m) {
    if (study::ParseCompared(plan.methods[m], kOtherLineMethods).recovery !=
        control::Recovery::kDfr) {
      continue;
    }
    RecoveryCurves curves(kCurves);
    for (std::size_t i = 0; i < starts.size() && !curves.complete(); ++i) {
      runner.RunObserved(static_cast<int>(m), starts[i],
                         experiment::ControllerSeed(plan, 0, static_cast<int>(i)), &curves);
    }
    if (curves.curves().empty()) continue;
    experiment::ReportSeries series = Average(curves.curves());
    series.name = plan.methods[m] + ", " + series.name;
    series.style = experiment::MethodStyle(plan.methods[m]);
    plot.series.push_back(std::move(series));
  }
  return {"Recoveries",
          "Mean and standard error; 1 ends a recovery. From the first trial's start states, in the "
          "world " +
              world + ".",
          {plot}};
}

// Films the best, median and worst episode of "controller" or, without it, of the last method.
std::vector<experiment::ReportMedia> RecordEpisodes(LineTrialRunner& runner,
                                                    const experiment::EvaluationPlan& plan,
                                                    const experiment::UnitResult& unit,
                                                    const std::filesystem::path& folder) {
  const auto found = std::ranges::find(plan.methods, "controller") - plan.methods.begin();
  const auto shown = std::min(static_cast<std::size_t>(found), plan.methods.size() - 1);
  std::vector<experiment::ReportMedia> media;
  for (const auto& [name, start] : PickEpisodes(unit, shown)) {
    const std::filesystem::path path = folder / (name + ".mp4");
    const std::string title = core::Format("%s, %s", plan.methods[shown].c_str(), name.c_str());
    const control::RolloutResult result =
        RecordEpisode(runner, static_cast<int>(shown), title, unit.starts[start],
                      experiment::ControllerSeed(plan, 0, static_cast<int>(start)), path);
    media.push_back({path, title + " episode of the first trial: " + core::Name(result.outcome)});
  }
  return media;
}

}  // namespace

void RunExperiment(const ExperimentOptions& options) {
  const experiment::EvaluationPlan plan = MakePlan(options);
  ValueOf("--methods, --worlds", [&plan] { experiment::CheckPlan(plan); });
  const experiment::OutputFolder folder(options, plan);
  // Calibration takes seconds and runs at the first call: a shard that has no units or is rejected
  // skips it.
  calibration::CalibrationSummary calibration_summary;
  line_task::LineCalibration calibrated;
  std::once_flag once;
  const auto known = [&]() -> const line_task::LineCalibration& {
    std::call_once(once, [&] {
      calibrated = CalibratePlant(options.plant, kCalibrationFrames,
                                  core::DeriveSeed(options.seed, {kCalibrationStream}),
                                  &calibration_summary);
      if (!calibration_summary.converged) {
        throw std::runtime_error("the calibration did not converge: " +
                                 calibration_summary.message);
      }
      calibrated.Save(options.out / "calibration.dfr");
    });
    return calibrated;
  };

  // The first trial's model is saved, for videos and for users.
  const std::filesystem::path model_folder = options.out / "model";
  const auto make = [&](const experiment::EvaluationUnit& unit) {
    const auto trial = static_cast<std::uint64_t>(unit.trial);
    const imitation::DemonstrationSet set =
        Demonstrate(options.plant, known(), unit.demonstrations, kDemonstratedSteps,
                    core::DeriveSeed(options.seed, {kDemonstrationStream, trial}));
    LineModelOptions model = options.model;
    model.seed = core::DeriveSeed(options.seed, {kLearnerStream, trial});
    LineModel fitted = LineModel::Fit(set, model);
    if (unit.trial == 0 && unit.learner == plan.learners.front()) fitted.Save(model_folder);
    auto runner = std::make_unique<LineTrialRunner>(std::move(fitted), plan.methods,
                                                    InWorld(options.plant, unit.learner), known());
    runner->JudgeIn(plan, unit);
    return runner;
  };
  const std::map<std::string, std::string> settings = Settings(options);
  const auto check_film = [&](const std::filesystem::path& film) {
    CheckFilm(film, options.plant);
  };
  CheckExperimentVideo(options, check_film);
  const auto found =
      experiment::RunExperiment("line_tracking", plan, make, settings, options,
                                [&](const auto&, const auto& film) { check_film(film); });
  if (!found) return;
  const auto& [results, summary] = *found;

  experiment::ReportOptions report = MakeReport(options, plan, settings);
  static_cast<void>(known());
  report.settings.emplace_back("calibration, tips RMS [px]", Text(calibration_summary.tip_rms_px));

  // Study and videos use the first trial, which is learned and run again.
  const experiment::UnitResult& first = results.front();
  const std::unique_ptr<LineTrialRunner> again = make(first.unit);
  const std::array<std::string, 2> dfr = {"dfr", "dfr-fine"};
  LineTrialRunner studied_site(LineModel::Load(model_folder), {dfr.begin(), dfr.end()},
                               options.plant, known());
  const experiment::ReportTable probes =
      ProbeTable(StudyProbes(studied_site, dfr, plan, first.starts));
  report.tables.push_back(probes);
  experiment::ReportFigure recoveries =
      RecoveryFigure(*again, plan, first.unit.learner, first.starts);
  if (!recoveries.plots.front().series.empty()) report.figures.push_back(std::move(recoveries));
  if (options.video) report.media = RecordEpisodes(*again, plan, first, options.out);
  experiment::SaveReport(summary, report, options.out / "report.html");
  experiment::PrintTable(summary, std::cout);
  std::cout << study::MarksOf(plan.methods);
  std::cout << '\n';
  experiment::PrintTable(probes, std::cout);
  std::cout << '\n'
            << (options.out / "report.html").string() << " and summary.json written, with the "
            << "first trial's model and calibration.dfr for run and render\n";
}

}  // namespace dfr::apps::line_tracking
