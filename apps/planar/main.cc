// Guided recovery and the certified modes on planar tasks: experiments, ablations, drift studies,
// proofs by stress, coverage of fits, certificates and pictures.

#include <CLI/CLI.hpp>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
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
#include "apps/planar/coverage.h"
#include "apps/planar/evaluation.h"
#include "apps/planar/picture.h"
#include "apps/planar/proof.h"
#include "dfr/control/certifier.h"
#include "dfr/core/random.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/intervals.h"
#include "dfr/kernel/cover_radius.h"

namespace dfr::apps::planar {
namespace {

std::vector<std::string> AllMethods() {
  return {"baseline",
          "early-stopping",
          "dfr",
          "guided",
          "true-jacobian",
          "lwr",
          "knn",
          "ensemble",
          "dart",
          "dagger",
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
  const std::vector<PlanarResult> results = RunVariants("planar", {{"polynomial", study}});
  if (results.empty()) return;
  PrintHeading();
  for (std::size_t m = 0; m < study.plan.methods.size(); ++m) {
    PrintRow(study.plan.methods[m], results.front(), m, causes);
  }
  std::fputs(MarksOf(study.plan.methods).c_str(), stdout);
}

// Every part off, one at a time; then the features' and the support's.
void Ablate(PlanarStudy study, bool causes) {
  study.plan.methods = {"baseline", "guided", "lwr"};
  for (const std::string_view part : control::GuidedPartNames()) {
    if (part != "drift") study.plan.methods.push_back("guided-without-" + std::string(part));
  }
  // Parts can hide each other's work, or harm.
  for (const std::string_view parts : {"reach+demonstrated", "online-jacobian+own-motion+observer",
                                       "reach+demonstrated+online-jacobian+own-motion+observer"}) {
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
  std::vector<Variant> variants;
  const auto row = [&](const std::string& what, const PlanarStudy& variant) {
    variants.push_back({what, variant});
  };
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
  const std::vector<PlanarResult> results = RunVariants("planar drift", variants);
  if (results.empty()) return;
  PrintHeading();
  for (std::size_t v = 0; v < variants.size(); ++v) {
    std::printf("%s\n", variants[v].name.c_str());
    for (std::size_t m = 0; m < study.plan.methods.size(); ++m) {
      PrintRow("  " + study.plan.methods[m], results[v], m, causes);
    }
  }
}

void PrintProof(ProofOptions options, bool mutations) {
  std::printf("%-20s %-10s %10s %12s %12s %9s %10s %9s %9s\n", "mode", "mutation", "controls",
              "left support", "violations", "probes", "recoveries", "filtered", "episodes");
  std::string failures;
  for (const auto kind : {control::CertificateKind::kLipschitz, control::CertificateKind::kRadius,
                          control::CertificateKind::kDirection}) {
    for (const Mutation mutation : MutationsOf(kind)) {
      if (mutation != Mutation::kNone && !mutations) continue;
      options.kind = kind;
      options.mutation = mutation;
      const ProofResult r = Prove(options);
      std::printf("%-20s %-10s %10lld %12lld %12lld %9lld %10lld %9lld %9lld\n", Name(kind),
                  Name(mutation), static_cast<long long>(r.controls),
                  static_cast<long long>(r.left), static_cast<long long>(r.violations),
                  static_cast<long long>(r.probes), static_cast<long long>(r.recoveries),
                  static_cast<long long>(r.filtered), static_cast<long long>(r.episodes));
      if (mutation != Mutation::kNone && r.left == 0) {
        failures.append(" the mutation ").append(Name(mutation));
        failures.append(" of ").append(Name(kind)).append(" was not found;");
      } else if (mutation == Mutation::kNone && (r.left > 0 || r.violations > 0)) {
        failures.append(" ").append(Name(kind)).append(" left its support;");
      }
    }
  }
  if (!failures.empty()) throw std::runtime_error("the proof failed:" + failures);
}

// A share of fits as per cent, with its 95 % interval and what exact promises would show.
std::string ShareOf(int count, int fits, double chance) {
  const auto interval = experiment::ProportionInterval(count, fits);
  std::array<char, 64> text{};
  if (chance < 0.0) {
    std::snprintf(text.data(), text.size(), "%.1f [%.1f, %.1f] -", 100.0 * count / fits,
                  100.0 * interval.low, 100.0 * interval.high);
  } else {
    std::snprintf(text.data(), text.size(), "%.1f [%.1f, %.1f] %.1f", 100.0 * count / fits,
                  100.0 * interval.low, 100.0 * interval.high, 100.0 * chance);
  }
  return text.data();
}

// A row each for demonstrations that are left out in turn, held out, held out with a confidence.
void PrintCoverage(CoverageOptions options, const std::vector<std::string>& worlds,
                   const std::vector<int>& demonstrations) {
  struct Promise {
    double hold_out;
    double confidence;
  };
  std::printf(
      "shares of fits in %%: measured [95 %% interval] as the law of exact promises has it\n");
  std::printf("%-12s %4s %9s %11s %7s  %-18s %-28s %-24s %-24s\n", "world", "n", "hold-out",
              "confidence", "alarms", "mean rate +- 1.96 se", "fits that keep it",
              "eps falls short", "K falls short");
  for (const std::string& world : worlds) {
    for (const int n : demonstrations) {
      for (const Promise& promise : {Promise{0.0, 0.0}, Promise{0.5, 0.0}, Promise{0.5, 0.8}}) {
        options.world = world;
        options.demonstrations = n;
        options.hold_out = promise.hold_out;
        options.confidence = promise.confidence;
        const CoverageResult r = MeasureCoverage(options);
        std::printf("%-12s %4d %9.1f %11.1f %7.3f  %.3f +- %.3f       %-28s %-24s %-24s\n",
                    world.c_str(), n, promise.hold_out, r.confidence, r.promised, r.mean,
                    1.96 * r.mean_error, ShareOf(r.kept, options.fits, r.kept_chance).c_str(),
                    ShareOf(r.error_short, options.fits, r.short_chance).c_str(),
                    ShareOf(r.gain_short, options.fits, r.short_chance).c_str());
        std::fflush(stdout);
      }
    }
  }
}

// How many demonstrated steps from time step t a mode would let pass.
struct Passing {
  int steps = 0;
  int passed = 0;
  [[nodiscard]] double percent() const { return steps > 0 ? 100.0 * passed / steps : 0.0; }
};

Passing CountPassing(const Methods& methods, control::CertificateKind kind, int t) {
  const control::GuidedModel& model = methods.recovery(SupportOf(control::Name(kind))).model();
  control::Certifier certifier(methods.certificate(kind), model.features().num_features(),
                               model.control_dim(), model.control_unit());
  // What a certificate assumes.
  control::JacobianEstimate estimate(model.prior(), {}, /*own_motion=*/false);
  Passing passing;
  for (const core::Trajectory& d : methods.demonstrations()) {
    if (t >= d.controls.rows()) continue;
    const core::Matrix z = model.features().Apply(d.states);
    const Eigen::VectorXd v = d.controls.row(t) / model.control_unit();
    estimate.Compute(t, core::Row(z, t));
    ++passing.steps;
    passing.passed +=
        certifier.Share({model.support(), estimate, core::Row(z, t)}, t, v) >= 1.0 ? 1 : 0;
  }
  return passing;
}

// What a certificate rests on, per time step, and how much of the demonstrations it would let pass.
void PrintCertificate(const PlanarStudy& study) {
  const Task task = MakeTask(study.task);
  const Methods methods(
      task,
      Demonstrate(task, study.plan.demonstrations.at(0), core::DeriveSeed(study.plan.seed, {2, 0})),
      study.methods);
  const safety::GuidedRecovery& certified = methods.recovery(SupportKind::kCertified);
  const core::LogDecisionFunction& support = certified.model().support();
  const control::Certificate certificate = methods.certificate(control::CertificateKind::kRadius);
  const control::EstimatedConstant& gain = methods.gain();
  const control::EstimatedConstant& error = methods.direction_error();
  const double unit = 1.0 / certified.features().scale()(0, 0);
  std::printf("assumptions of %s, %d demonstrations; features of K are in units of %.4g\n",
              task.name.c_str(), gain.demonstrations, unit);
  std::printf(
      "  no B_t(%.3g) meets the constraints: not checked, for they are unknown. It is so if\n"
      "  demonstrations kept the clearance below\n",
      certificate.level);
  std::printf("  K   = %.4f per unit of control, %s\n", certificate.gain,
              task.gain > 0.0 ? "given" : "estimated");
  std::printf(
      "  K^  = %.4f from demonstrations: with %.0f %% confidence %.1f %% of further ones "
      "stay below\n",
      gain.value, 100 * gain.confidence, 100 * gain.coverage);
  std::printf("  eps = %.4f, whitened features, so far approximately; times %.3g it is trusted\n",
              error.value, study.methods.gain_factor);
  std::printf(
      "  features show the constraints; states are exact; what is issued is applied; states\n"
      "  are certified, not the paths between them\n");
  std::printf("%4s %9s %9s %11s %9s %12s %12s %40s\n", "t", "L", "lambda=LK", "g/L median",
              "r median", "clearance K", "of direction",
              "demonstrated steps that pass, % (L, r, direction)");
  const core::FeatureTransform& whitening = methods.recovery(SupportKind::kGuided).features();
  for (int t = 0; t < support.num_steps(); t += std::max(1, support.num_steps() / 12)) {
    std::vector<double> lipschitz, radius;
    for (const core::Trajectory& d : methods.demonstrations()) {
      if (t >= d.controls.rows()) continue;
      const core::Matrix z = certified.features().Apply(d.states);
      Eigen::VectorXd shift(z.cols());
      const auto ball = control::ComputeSafeBall(support, t, core::Row(z, t), core::AsSpan(shift),
                                                 certificate.level);
      lipschitz.push_back(
          std::max(0.0, support.Decision(t, core::Row(z, t)) / support.lipschitz_bound(t)));
      radius.push_back(std::max(0.0, ball.worst_radius()));
    }
    if (radius.empty()) continue;
    const auto median = [](std::vector<double>& v) {
      std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
      return v[v.size() / 2];
    };
    // In the state's own unit, in its worst direction.
    const auto& guided = methods.recovery(SupportKind::kGuided).support();
    const Eigen::MatrixXd inverse = (guided.map(t) * whitening.scale()).inverse();
    const double by_gain =
        unit * kernel::CoverRadius(certified.support().estimate(t), certificate.level);
    const double by_direction =
        inverse.operatorNorm() * kernel::CoverRadius(guided.estimate(t), certificate.level);
    std::printf("%4d %9.4f %9.4f %11.4f %9.4f %12.4g %12.4g %12.1f %12.1f %12.1f\n", t,
                support.lipschitz_bound(t), support.lipschitz_bound(t) * certificate.gain,
                median(lipschitz), median(radius), by_gain, by_direction,
                CountPassing(methods, control::CertificateKind::kLipschitz, t).percent(),
                CountPassing(methods, control::CertificateKind::kRadius, t).percent(),
                CountPassing(methods, control::CertificateKind::kDirection, t).percent());
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
  std::printf("%s, and pictures beside it\n", (folder / "planar.mp4").c_str());
}

}  // namespace
}  // namespace dfr::apps::planar

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  using namespace dfr::apps::planar;  // NOLINT: this is their main
  CLI::App app("Recovery and certificates on planar tasks");
  app.require_subcommand(1);
  PlanarStudy study;
  study.plan.methods = AllMethods();
  study.plan.learners = {"polynomial"};
  study.plan.demonstrations = {120};
  study.plan.trials = 10;
  study.plan.episodes = 100;
  study.run.seed = 1;
  bool causes = false;
  const auto common = [&](CLI::App* command) {
    command->add_option("--task", study.task, "corridor, push or push-weak")->capture_default_str();
    command->add_option("--demonstrations", study.plan.demonstrations)
        ->delimiter(',')
        ->capture_default_str();
    command->add_option("--gamma", study.methods.gamma, "of guided recovery's support")
        ->capture_default_str();
    command->add_option("--raw-gamma", study.methods.raw_gamma, "of DFR's support; 0: the task's")
        ->capture_default_str();
    command->add_option("--certified-gamma", study.methods.certified_gamma)->capture_default_str();
    command->add_option("--factor", study.methods.gain_factor, "safety factor on estimated K, eps")
        ->capture_default_str();
    command
        ->add_option("--certified-level", study.methods.certified_level,
                     "eta: the certified modes keep l >= -eta")
        ->check(dfr::apps::kNotNegative)
        ->capture_default_str();
  };
  const auto seeded = [&](CLI::App* command) {
    command->add_option("--seed", study.run.seed)->capture_default_str();
  };
  const auto runs = [&](CLI::App* command) {
    common(command);
    command->add_option("--trials", study.plan.trials)->capture_default_str();
    command->add_option("--episodes", study.plan.episodes, "per trial")->capture_default_str();
    command->add_flag("--causes", causes, "why episodes did not complete");
  };
  auto* experiment = app.add_subcommand("experiment", "Compare methods from the same start states");
  runs(experiment);
  dfr::experiment::AddRunOptions(*experiment, study.run);
  experiment->add_option("--methods", study.plan.methods)->delimiter(',');
  auto* ablate = app.add_subcommand("ablate", "Each part of guided recovery off, one at a time");
  runs(ablate);
  seeded(ablate);
  ablate->add_option("--threads", study.run.threads, "0: one per core")->capture_default_str();
  auto* drift = app.add_subcommand("drift", "Rotation, scale, bias, noise, few demonstrations");
  runs(drift);
  dfr::experiment::AddRunOptions(*drift, study.run);
  std::vector<std::string> drift_methods = {"baseline", "dfr", "guided", "lwr"};
  drift->add_option("--methods", drift_methods)->delimiter(',');
  ProofOptions proof;
  bool mutations = false;
  auto* prove = app.add_subcommand("prove", "Stress Proposition 1 of each certified mode");
  prove->add_option("--steps", proof.steps, "controls of each mode")->capture_default_str();
  prove->add_option("--seed", proof.seed)->capture_default_str();
  prove->add_option("--dimensions", proof.most_dimensions, "worlds have 2 to so many")
      ->check(CLI::Range(2, 64))
      ->capture_default_str();
  prove->add_option("--state-error", proof.state_error, "length of errors of observed states")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  prove->add_flag("--mutations", mutations, "mistakes that must be found, too");
  CoverageOptions coverage;
  std::vector<std::string> worlds = CoverageWorlds();
  std::vector<int> numbers = {10, 20, 60};
  auto* cover = app.add_subcommand("coverage", "How often what fits promise comes true");
  cover->add_option("--worlds", worlds)->delimiter(',')->check(CLI::IsMember(worlds));
  cover->add_option("--demonstrations", numbers)
      ->delimiter(',')
      ->check(CLI::Range(6, 10'000))
      ->capture_default_str();
  cover->add_option("--fits", coverage.fits, "of each row")
      ->check(CLI::Range(2, 1'000'000))
      ->capture_default_str();
  cover->add_option("--further", coverage.further, "demonstrations that judge a fit")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  cover->add_option("--seed", coverage.seed)->capture_default_str();
  auto* certificate = app.add_subcommand("certificate", "What the certified modes rest on");
  common(certificate);
  seeded(certificate);
  auto* picture = app.add_subcommand("picture", "Pictures and a video of one start state");
  common(picture);
  seeded(picture);
  std::uint64_t start = 3;
  std::filesystem::path folder = "planar";
  std::vector<std::string> picture_methods = {"baseline", "dfr", "guided"};
  picture->add_option("--start", start, "seed of the start state")->capture_default_str();
  picture->add_option("--out", folder)->capture_default_str();
  picture->add_option("--methods", picture_methods)->delimiter(',');
  dfr::apps::CheckNumbers(app);
  if (const auto code = dfr::experiment::Parse(app, argc, argv)) return *code;
  study.plan.seed = study.run.seed;

  if (*experiment) Experiment(study, causes);
  if (*ablate) Ablate(study, causes);
  if (*drift) {
    study.plan.methods = drift_methods;
    Drift(study, causes);
  }
  if (*prove) PrintProof(proof, mutations);
  if (*cover) PrintCoverage(coverage, worlds, numbers);
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
