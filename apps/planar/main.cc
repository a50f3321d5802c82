// Guided recovery and the certified modes on planar tasks: experiments, ablations, drift studies,
// proofs by stress, certificates and pictures.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "apps/planar/evaluation.h"
#include "apps/planar/page.h"
#include "apps/planar/picture.h"
#include "apps/planar/proof.h"
#include "dfr/core/random.h"
#include "dfr/experiment/intervals.h"

namespace dfr::apps::planar {
namespace {

std::vector<std::string> AllMethods() {
  return {"baseline",
          "early-stopping",
          "dfr",
          "guided",
          "lwr",
          "knn",
          "certified-lipschitz",
          "certified-radius",
          "certified-direction"};
}

void PrintHeading() {
  std::printf("%-32s %-22s %6s  %-20s %-20s %9s\n", "method", "completed %", "halted", "collided %",
              "controls per recovery", "us/episode");
}

// One row: shares with 95 % intervals, controls per recovery as mean (median, 90 % quantile).
void PrintRow(const std::string& name, const PlanarResult& result, std::size_t method,
              bool causes) {
  int n = 0, completed = 0, collided = 0;
  double seconds = 0.0;
  std::map<std::string, int> why;
  for (const auto& unit : result.units) {
    for (const experiment::EpisodeResult& episode : unit.episodes[method]) {
      ++n;
      completed += episode.outcome == core::Outcome::kCompleted ? 1 : 0;
      collided += episode.outcome == core::Outcome::kCollided ? 1 : 0;
      seconds += episode.seconds;
      if (episode.outcome != core::Outcome::kCompleted) {
        ++why[std::string(core::Name(episode.outcome)) + " by " + episode.cause];
      }
    }
  }
  std::vector<int> lengths = result.recovery_lengths[method];
  std::sort(lengths.begin(), lengths.end());
  double mean = 0.0;
  for (const int length : lengths) mean += length;
  const auto quantile = [&](double q) {
    return lengths.empty()
               ? 0
               : lengths[static_cast<std::size_t>(q * static_cast<double>(lengths.size() - 1))];
  };
  const auto c = experiment::ProportionInterval(completed, n);
  const auto k = experiment::ProportionInterval(collided, n);
  std::printf("%-32s %5.1f [%5.1f, %5.1f]  %6.1f  %5.1f [%4.1f, %5.1f]  %7.1f (%d, %d)  %12.0f\n",
              name.c_str(), 100.0 * completed / n, 100.0 * c.low, 100.0 * c.high,
              100.0 * (n - completed - collided) / n, 100.0 * collided / n, 100.0 * k.low,
              100.0 * k.high, lengths.empty() ? 0.0 : mean / static_cast<double>(lengths.size()),
              quantile(0.5), quantile(0.9), 1e6 * seconds / n);
  if (causes) {
    for (const auto& [cause, count] : why) std::printf("    %5d %s\n", count, cause.c_str());
  }
}

void Experiment(const PlanarStudy& study, bool causes) {
  const PlanarResult result = RunStudy(study);
  PrintHeading();
  for (std::size_t m = 0; m < study.plan.methods.size(); ++m) {
    PrintRow(study.plan.methods[m], result, m, causes);
  }
}

// Every part off, one at a time; then the features' and the support's.
void Ablate(PlanarStudy study, bool causes) {
  study.plan.methods = {"baseline", "guided", "lwr"};
  for (const std::string_view part : control::GuidedPartNames()) {
    if (part != "drift") study.plan.methods.push_back("guided-without-" + std::string(part));
  }
  // Parts can hide each other's work, or harm.
  for (const std::string_view parts :
       {"share+slack", "demonstrated+overtaking", "slack+demonstrated", "probing+online-jacobian",
        "share+slack+demonstrated+overtaking+probing+online-jacobian"}) {
    study.plan.methods.push_back("guided-without-" + std::string(parts));
  }
  Experiment(study, causes);
  study.plan.methods = {"guided"};
  PlanarStudy variant = study;
  variant.methods.whitening = false;
  PrintRow("guided-without-whitening", RunStudy(variant), 0, causes);
  variant = study;
  variant.methods.phase_whitening = false;
  PrintRow("guided-without-phase-whitening", RunStudy(variant), 0, causes);
  variant = study;
  variant.methods.hold_ended = false;
  PrintRow("guided-without-held-goals", RunStudy(variant), 0, causes);
  variant = study;
  variant.methods.window = 0;
  PrintRow("guided-without-pooling", RunStudy(variant), 0, causes);
}

// The plant differs from the one that was demonstrated on; and few demonstrations.
void Drift(const PlanarStudy& study, bool causes) {
  const double length = study.task == "corridor" ? 1.0 : 0.1;
  const auto row = [&](const std::string& what, const PlanarStudy& variant) {
    std::printf("%s\n", what.c_str());
    const PlanarResult result = RunStudy(variant);
    for (std::size_t m = 0; m < variant.plan.methods.size(); ++m) {
      PrintRow("  " + variant.plan.methods[m], result, m, causes);
    }
  };
  PrintHeading();
  row("as demonstrated", study);
  for (const double degrees : {10.0, 20.0, 40.0}) {
    PlanarStudy variant = study;
    variant.disturbance.rotation_sd = degrees * 3.14159265358979 / 180.0;
    row("control turned, sd " + std::to_string(static_cast<int>(degrees)) + " degrees", variant);
  }
  for (const double scale : {0.2, 0.4}) {
    PlanarStudy variant = study;
    variant.disturbance.scale_sd = scale;
    row("control scaled, sd of log " + std::to_string(scale).substr(0, 3), variant);
  }
  for (const double bias : {0.1, 0.2}) {
    PlanarStudy variant = study;
    variant.disturbance.bias = bias;
    row("actuator bias " + std::to_string(bias).substr(0, 3) + " of its range", variant);
  }
  for (const double noise : {0.005, 0.02}) {
    PlanarStudy variant = study;
    variant.disturbance.observation_noise = noise * length;
    row("observation noise, sd " + std::to_string(noise * length).substr(0, 6), variant);
  }
  for (const int demonstrations : {10, 20, 40}) {
    PlanarStudy variant = study;
    variant.plan.demonstrations = {demonstrations};
    row(std::to_string(demonstrations) + " demonstrations", variant);
  }
}

void PrintProof(std::int64_t steps, std::uint64_t seed) {
  std::printf("%-20s %10s %12s %12s %9s %10s %9s %9s\n", "mode", "controls", "left support",
              "false alarms", "probes", "recoveries", "filtered", "episodes");
  bool holds = true;
  for (const auto kind : {control::CertificateKind::kLipschitz, control::CertificateKind::kRadius,
                          control::CertificateKind::kDirection}) {
    const ProofResult r = Prove(kind, steps, seed);
    std::printf("%-20s %10lld %12lld %12lld %9lld %10lld %9lld %9lld\n", Name(kind),
                static_cast<long long>(r.controls), static_cast<long long>(r.left),
                static_cast<long long>(r.violations), static_cast<long long>(r.probes),
                static_cast<long long>(r.recoveries), static_cast<long long>(r.filtered),
                static_cast<long long>(r.episodes));
    holds = holds && r.left == 0 && r.violations == 0;
  }
  if (!holds) throw std::runtime_error("a certified mode left its support");
}

// What a certificate rests on, per time step, and how much of the demonstrations it would let pass.
void PrintCertificate(const PlanarStudy& study) {
  const Task task = MakeTask(study.task);
  const Methods methods(
      task,
      Demonstrate(task, study.plan.demonstrations.at(0), core::DeriveSeed(study.plan.seed, {2, 0})),
      study.methods);
  const control::GuidedModel& model = methods.recovery(SupportKind::kCertified).model();
  const core::LogDecisionFunction& support = model.support();
  const control::Certificate certificate = methods.certificate(control::CertificateKind::kRadius);
  const control::EstimatedConstant& gain = methods.gain();
  const control::EstimatedConstant& error = methods.direction_error();
  std::printf("assumptions of %s, %d demonstrations; features are in units of %.4g\n",
              task.name.c_str(), gain.demonstrations, 1.0 / model.features().scale()(0, 0));
  std::printf("  no B_t meets the constraints (not checked: they are unknown)\n");
  std::printf("  K   = %.4f per unit of control, %s\n", certificate.gain,
              task.gain > 0.0 ? "given" : "estimated");
  std::printf(
      "  K^  = %.4f from demonstrations: with %.0f %% confidence %.1f %% of further ones "
      "stay below\n",
      gain.value, 100 * gain.confidence, 100 * gain.coverage);
  std::printf("  eps = %.4f likewise\n", error.value);
  std::printf("%4s %9s %9s %11s %9s %22s %22s %22s\n", "t", "L", "lambda=LK", "g/L median",
              "r median", "demonstrated steps certified, % (lipschitz, radius, direction)", "", "");
  control::JacobianEstimate estimate(model.prior());
  for (int t = 0; t < support.num_steps(); t += std::max(1, support.num_steps() / 12)) {
    std::vector<double> lipschitz, radius;
    int steps = 0, by_lipschitz = 0, by_radius = 0, by_direction = 0;
    for (const core::Trajectory& d : methods.demonstrations()) {
      if (t >= d.controls.rows()) continue;
      const core::Matrix z = model.features().Apply(d.states);
      const Eigen::VectorXd here = z.row(t);
      Eigen::VectorXd shift(here.size());
      const auto ball =
          control::ComputeSafeBall(support, t, core::AsSpan(here), core::AsSpan(shift));
      const double room = support.Decision(t, core::AsSpan(here)) / support.lipschitz_bound(t);
      lipschitz.push_back(std::max(0.0, room));
      radius.push_back(std::max(0.0, ball.worst_radius()));
      const double norm = d.controls.row(t).norm();
      estimate.Compute(t, core::AsSpan(here));
      const Eigen::VectorXd effect =
          estimate.jacobian() * d.controls.row(t).transpose() / model.control_unit();
      ++steps;
      by_lipschitz += certificate.gain * norm <= room ? 1 : 0;
      by_radius += certificate.gain * norm <= ball.worst_radius() ? 1 : 0;
      by_direction += control::LargestShare(ball, core::AsSpan(shift), core::AsSpan(effect),
                                            certificate.direction_error * norm) >= 1.0
                          ? 1
                          : 0;
    }
    const auto median = [](std::vector<double>& v) {
      std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
      return v[v.size() / 2];
    };
    if (steps == 0) continue;
    std::printf("%4d %9.4f %9.4f %11.4f %9.4f %22.1f %22.1f %22.1f\n", t,
                support.lipschitz_bound(t), support.lipschitz_bound(t) * certificate.gain,
                median(lipschitz), median(radius), 100.0 * by_lipschitz / steps,
                100.0 * by_radius / steps, 100.0 * by_direction / steps);
  }
}

void Picture(const PlanarStudy& study, std::uint64_t start, const std::filesystem::path& folder) {
  const Task task = MakeTask(study.task);
  const Methods methods(
      task,
      Demonstrate(task, study.plan.demonstrations.at(0), core::DeriveSeed(study.plan.seed, {2, 0})),
      study.methods);
  std::filesystem::create_directories(folder);
  const std::vector<Episode> episodes = Record(task, methods, study.plan.methods, start);
  const Painter painter(task, methods);
  for (const Episode& episode : episodes) {
    // As in the paper's Fig. 2: (a) the learned policy deep inside, (b) the first control that is
    // not the learned one, (c) when that is over; and the end.
    const auto learned = [&](int i) {
      const control::Step& step = episode.shots[static_cast<std::size_t>(i)].step;
      return step.mode == control::Mode::kPolicy && !step.filtered;
    };
    const int last = static_cast<int>(episode.shots.size()) - 1;
    int first = 0;
    while (first < last && (learned(first) || first == 0)) ++first;
    int over = first;
    while (over < last && !learned(over)) ++over;
    painter.WritePng(episode, std::array{first / 2, first, over, last},
                     folder / (episode.method + ".png"));
  }
  painter.WriteVideo(episodes, folder / "planar.mp4");
  WritePage(task, methods, episodes, folder / "planar.html");
  std::printf("%s, planar.mp4 and pictures beside it\n", (folder / "planar.html").c_str());
}

}  // namespace
}  // namespace dfr::apps::planar

int main(int argc, char** argv) try {
  using namespace dfr::apps::planar;  // NOLINT: this is their main
  CLI::App app("Recovery and certificates on planar tasks");
  app.require_subcommand(1);
  PlanarStudy study;
  study.plan.methods = AllMethods();
  study.plan.learners = {"polynomial"};
  study.plan.demonstrations = {120};
  study.plan.trials = 10;
  study.plan.episodes = 100;
  study.plan.seed = 1;
  bool causes = false;
  const auto common = [&](CLI::App* command) {
    command->add_option("--task", study.task, "corridor, push or push-weak")->capture_default_str();
    command->add_option("--demonstrations", study.plan.demonstrations)
        ->delimiter(',')
        ->capture_default_str();
    command->add_option("--seed", study.plan.seed)->capture_default_str();
    command->add_option("--gamma", study.methods.gamma, "of guided recovery's support")
        ->capture_default_str();
    command->add_option("--raw-gamma", study.methods.raw_gamma, "of DFR's support; 0: the task's")
        ->capture_default_str();
    command->add_option("--certified-gamma", study.methods.certified_gamma)->capture_default_str();
    command->add_option("--factor", study.methods.gain_factor, "safety factor on estimated K, eps")
        ->capture_default_str();
  };
  const auto runs = [&](CLI::App* command) {
    common(command);
    command->add_option("--trials", study.plan.trials)->capture_default_str();
    command->add_option("--episodes", study.plan.episodes, "per trial")->capture_default_str();
    command->add_option("--threads", study.threads, "0: one per core")->capture_default_str();
    command->add_flag("--causes", causes, "why episodes did not complete");
  };
  auto* experiment = app.add_subcommand("experiment", "Compare methods from the same start states");
  runs(experiment);
  experiment->add_option("--methods", study.plan.methods)->delimiter(',');
  auto* ablate = app.add_subcommand("ablate", "Each part of guided recovery off, one at a time");
  runs(ablate);
  auto* drift = app.add_subcommand("drift", "Rotation, scale, bias, noise, few demonstrations");
  runs(drift);
  std::vector<std::string> drift_methods = {"baseline", "dfr", "guided", "lwr"};
  drift->add_option("--methods", drift_methods)->delimiter(',');
  std::int64_t steps = 1'000'000;
  auto* prove = app.add_subcommand("prove", "Stress Proposition 1 of each certified mode");
  prove->add_option("--steps", steps, "controls of each mode")->capture_default_str();
  prove->add_option("--seed", study.plan.seed)->capture_default_str();
  auto* certificate = app.add_subcommand("certificate", "What the certified modes rest on");
  common(certificate);
  auto* picture = app.add_subcommand("picture", "Pictures, a video and a page to scrub through");
  common(picture);
  std::uint64_t start = 3;
  std::filesystem::path folder = "planar";
  std::vector<std::string> picture_methods = {"baseline", "dfr", "guided"};
  picture->add_option("--start", start, "seed of the start state")->capture_default_str();
  picture->add_option("--out", folder)->capture_default_str();
  picture->add_option("--methods", picture_methods)->delimiter(',');
  dfr::apps::CheckNumbers(app);
  CLI11_PARSE(app, argc, argv);

  if (*experiment) Experiment(study, causes);
  if (*ablate) Ablate(study, causes);
  if (*drift) {
    study.plan.methods = drift_methods;
    Drift(study, causes);
  }
  if (*prove) PrintProof(steps, study.plan.seed);
  if (*certificate) PrintCertificate(study);
  if (*picture) {
    study.plan.methods = picture_methods;
    Picture(study, start, folder);
  }
  return EXIT_SUCCESS;
} catch (const std::exception& e) {
  std::cerr << "planar: " << e.what() << '\n';
  return EXIT_FAILURE;
}
