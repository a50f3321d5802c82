#include "apps/study/planar/commands.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "apps/study/planar/coverage.h"
#include "apps/study/planar/picture.h"
#include "apps/study/planar/proof.h"
#include "dfr/control/certified/certifier.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/intervals.h"
#include "dfr/kernel/cover_radius.h"
#include "dfr/sim/gallery/corridor.h"

namespace dfr::study::planar {
namespace {

struct PlanarStudy {
  std::string task = "corridor";
  int demonstrations = 120;
  std::uint64_t seed = 1;
  MethodOptions methods;
};

Methods FitMethods(const Task& task, const PlanarStudy& study) {
  return {task, Demonstrate(task, study.demonstrations, core::DeriveSeed(study.seed, {2, 0})),
          study.methods};
}

void PrintProof(ProofOptions options, bool mutations) {
  std::printf("%-10s %10s %12s %12s %9s %10s %9s %9s\n", "mutation", "controls", "left support",
              "violations", "probes", "recoveries", "filtered", "episodes");
  std::string failures;
  for (const Mutation mutation : kMutations) {
    if (mutation != Mutation::kNone && !mutations) continue;
    options.mutation = mutation;
    const ProofResult r = Prove(options);
    std::printf("%-10s %10lld %12lld %12lld %9lld %10lld %9lld %9lld\n", Name(mutation),
                static_cast<long long>(r.controls), static_cast<long long>(r.left),
                static_cast<long long>(r.violations), static_cast<long long>(r.probes),
                static_cast<long long>(r.recoveries), static_cast<long long>(r.filtered),
                static_cast<long long>(r.episodes));
    if (mutation != Mutation::kNone && r.left == 0) {
      failures.append(" the mutation ").append(Name(mutation)).append(" was not found;");
    } else if (mutation == Mutation::kNone && (r.left > 0 || r.violations > 0)) {
      failures.append(" the support was left;");
    }
  }
  if (!failures.empty()) throw std::runtime_error("the proof failed:" + failures);
}

// Formats a share of fits in per cent, with its 95 % interval and the exact prediction.
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

// Prints rows for cross-validation, and for held-out demonstrations without and with a confidence.
void PrintCoverage(CoverageOptions options, const std::vector<std::string>& worlds,
                   const std::vector<int>& demonstrations) {
  struct Guarantee {
    double hold_out;
    double confidence;
  };
  std::printf("shares of fits in %%: measured [95 %% interval] predicted by the exact law\n");
  std::printf("%-12s %4s %9s %11s %7s  %-18s %-28s %-24s %-24s\n", "world", "n", "hold-out",
              "confidence", "alarms", "mean rate +- 1.96 se", "fits that keep it",
              "eps falls short", "K falls short");
  for (const std::string& world : worlds) {
    for (const int n : demonstrations) {
      for (const Guarantee& guarantee :
           {Guarantee{0.0, 0.0}, Guarantee{0.5, 0.0}, Guarantee{0.5, 0.8}}) {
        options.world = world;
        options.demonstrations = n;
        options.hold_out = guarantee.hold_out;
        options.confidence = guarantee.confidence;
        const CoverageResult r = MeasureCoverage(options);
        std::printf("%-12s %4d %9.1f %11.1f %7.3f  %.3f +- %.3f       %-28s %-24s %-24s\n",
                    world.c_str(), n, guarantee.hold_out, r.confidence, r.promised, r.mean,
                    1.96 * r.mean_error, ShareOf(r.kept, options.fits, r.kept_chance).c_str(),
                    ShareOf(r.error_short, options.fits, r.short_chance).c_str(),
                    ShareOf(r.gain_short, options.fits, r.short_chance).c_str());
        std::fflush(stdout);
      }
    }
  }
}

// Numbers of demonstrated steps at a time step, and of steps that a certificate would pass.
struct Passing {
  int steps = 0;
  int passed = 0;
  [[nodiscard]] double percent() const { return steps > 0 ? 100.0 * passed / steps : 0.0; }
};

Passing CountPassing(const Methods& methods, int t) {
  const control::TaskView task = methods.model().view();
  const control::Response& response = task.response();
  control::Certifier certifier(methods.certificate(), task.features().num_features(),
                               response.control_dim(), response.control_unit());
  // The certificate assumes no drift, and J from demonstrations alone.
  const control::ResponseEstimate estimate(response.prior(), {}, /*drift=*/false);
  control::LocalFit fit = estimate.MakeFit();
  Passing passing;
  for (const core::Trajectory& d : methods.demonstrations()) {
    if (t >= d.controls.rows()) continue;
    const core::Matrix z = task.features().Apply(d.states);
    const Eigen::VectorXd v = d.controls.row(t) / response.control_unit();
    estimate.FitAt(t, core::Row(z, t), fit);
    ++passing.steps;
    passing.passed += certifier.StepFraction({task.support(), fit}, t, v) >= 1.0 ? 1 : 0;
  }
  return passing;
}

// Smallest clearance that demonstrations kept at time step t; absent if the task does not define
// it.
std::optional<double> ClearanceKept(const Task& task, const Methods& methods, int t) {
  const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get());
  std::optional<double> least;
  for (const core::Trajectory& d : methods.demonstrations()) {
    if (corridor == nullptr || t >= d.states.rows()) continue;
    const double clearance = corridor->Clearance(d.states(t, 0), d.states(t, 1));
    least = std::min(least.value_or(clearance), clearance);
  }
  return least;
}

// Prints the assumptions of a certificate per time step, and the share of demonstrated steps that
// it would pass.
void PrintCertificate(const PlanarStudy& study) {
  const Task task = MakeTask(study.task);
  const Methods methods = FitMethods(task, study);
  const core::FeatureTransform& features = methods.model().features();
  const kernel::WhitenedSupport& support = methods.model().feature_support();
  const control::Certificate certificate = methods.certificate();
  const control::EstimatedConstant& error = methods.direction_error();
  std::printf("assumptions of %s, %d demonstrations, in whitened features\n", task.name.c_str(),
              error.demonstrations);
  std::printf(
      "  no B_t(%.3g) meets the constraints: not checked, because they are unknown. True if\n"
      "  demonstrations kept the clearance below\n",
      certificate.level);
  std::printf(
      "  eps = %.4f, estimated approximately; the certificate assumes %.3g times this value\n",
      error.value, study.methods.error_factor);
  std::printf(
      "  features show the constraints; states are exact; what is issued is applied; states\n"
      "  are certified, not the paths between them\n");
  std::printf("%4s %9s %12s %12s %32s\n", "t", "R median", "clearance", "kept",
              "demonstrated steps that pass, %");
  int met = 0;
  int compared = 0;
  for (int t = 0; t < support.num_steps(); t += std::max(1, support.num_steps() / 12)) {
    std::vector<double> radius;
    for (const core::Trajectory& d : methods.demonstrations()) {
      if (t >= d.controls.rows()) continue;
      const core::Matrix z = features.Apply(d.states);
      Eigen::VectorXd shift(z.cols());
      const auto ball = control::ComputeSafeBall(support, t, core::Row(z, t), core::AsSpan(shift),
                                                 certificate.level);
      radius.push_back(std::max(0.0, ball.radius));
    }
    if (radius.empty()) continue;
    // Clearance in the unit of the state, in the direction in which it is largest.
    const Eigen::MatrixXd inverse = core::PseudoInverse(support.map(t) * features.scale());
    const double clearance =
        core::OperatorNorm(inverse) * kernel::CoverRadius(support.estimate(t), certificate.level);
    const std::optional<double> kept = ClearanceKept(task, methods, t);
    compared += kept ? 1 : 0;
    met += kept && *kept >= clearance ? 1 : 0;
    std::printf("%4d %9.4f %12.4g %12s %32.1f\n", t, core::Median(radius), clearance,
                kept ? core::Format("%.4g", *kept).c_str() : "-",
                CountPassing(methods, t).percent());
  }
  if (compared > 0) {
    std::printf("demonstrations kept the clearance at %d of these %d time steps\n", met, compared);
  } else {
    std::printf("this task does not define the clearance that demonstrations kept\n");
  }
}

void Picture(const PlanarStudy& study, const std::vector<std::string>& names, std::uint64_t start,
             const std::filesystem::path& folder) {
  const Task task = MakeTask(study.task);
  const Methods methods = FitMethods(task, study);
  std::filesystem::create_directories(folder);
  const std::vector<Episode> episodes = Record(task, methods, names, start);
  const Painter painter(task, methods);
  for (const Episode& episode : episodes) {
    // Frames as in the paper's Fig. 2: (a) the learned policy deep inside, (b) the first control
    // that differs from the learned one, (c) the first learned control after it, and the end.
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

void AddTask(CLI::App& command, PlanarStudy& study) {
  command.add_option("--task", study.task, "corridor, push or push-weak")
      ->check(apps::ReadBy(MakeTask))
      ->capture_default_str();
  command.add_option("--demonstrations", study.demonstrations, "number of demonstrations")
      ->check(apps::kModelDemonstrations)
      ->capture_default_str();
  command.add_option("--seed", study.seed, "random seed of the demonstrations")
      ->capture_default_str();
}

void AddCertificateOptions(CLI::App& command, MethodOptions& options) {
  command.add_option("--factor", options.error_factor, "safety factor on estimated eps")
      ->check(apps::kPositive)
      ->capture_default_str();
  command
      .add_option("--certified-level", options.certified_level,
                  "eta: certified-direction keeps l >= -eta")
      ->check(apps::kNotNegative)
      ->capture_default_str();
}

}  // namespace

void AddGamma(CLI::App& command, MethodOptions& options) {
  command
      .add_option("--gamma", options.gamma,
                  "gamma of the whitened support, which guard and controller use")
      ->check(apps::kPositive)
      ->capture_default_str();
}

void AddMethodOptions(CLI::App& command, MethodOptions& options) {
  AddGamma(command, options);
  AddCertificateOptions(command, options);
  command.add_option("--raw-gamma", options.raw_gamma, "gamma of DFR's support; 0: the task's")
      ->check(apps::kNotNegative)
      ->capture_default_str();
}

void AddProof(CLI::App& app, Commands& commands) {
  const auto proof = std::make_shared<ProofOptions>();
  const auto mutations = std::make_shared<bool>(false);
  auto* prove =
      app.add_subcommand("prove", "Test the theorem of certified-direction in random worlds");
  prove->add_option("--steps", proof->steps, "controls")
      ->check(apps::kPositive)
      ->capture_default_str();
  prove->add_option("--seed", proof->seed, "random seed of the worlds")->capture_default_str();
  prove
      ->add_option("--dimensions", proof->most_dimensions,
                   "largest number of dimensions; worlds have 2 or more")
      ->check(CLI::Range(2, 64))
      ->capture_default_str();
  prove->add_option("--state-error", proof->state_error, "length of the errors of observed states")
      ->check(apps::kNotNegative)
      ->capture_default_str();
  prove->add_flag("--mutations", *mutations, "also test that deliberate mistakes are found");
  commands.emplace_back(prove, [=] { PrintProof(*proof, *mutations); });
}

void AddCoverage(CLI::App& app, Commands& commands) {
  const auto options = std::make_shared<CoverageOptions>();
  const auto worlds = std::make_shared<std::vector<std::string>>(CoverageWorlds());
  const auto numbers = std::make_shared<std::vector<int>>(std::vector{10, 20, 60});
  auto* cover = app.add_subcommand("coverage", "Measure how often the bounds of a fit hold");
  cover->add_option("--worlds", *worlds, "worlds, with one row each; default: all")
      ->delimiter(',')
      ->check(CLI::IsMember(CoverageWorlds()));
  cover->add_option("--demonstrations", *numbers, "numbers of demonstrations, with one row each")
      ->delimiter(',')
      ->check(CLI::Range(6, 10'000))
      ->capture_default_str();
  cover->add_option("--fits", options->fits, "number of fits in each row")
      ->check(CLI::Range(2, 1'000'000))
      ->capture_default_str();
  cover->add_option("--further", options->further, "number of demonstrations to evaluate a fit")
      ->check(apps::kCount)
      ->capture_default_str();
  cover->add_option("--seed", options->seed, "random seed")->capture_default_str();
  commands.emplace_back(cover, [=] { PrintCoverage(*options, *worlds, *numbers); });
}

void AddCertificate(CLI::App& app, Commands& commands) {
  const auto study = std::make_shared<PlanarStudy>();
  auto* certificate =
      app.add_subcommand("certificate", "Print the assumptions of certified-direction");
  AddTask(*certificate, *study);
  AddGamma(*certificate, study->methods);
  AddCertificateOptions(*certificate, study->methods);
  commands.emplace_back(certificate, [=] { PrintCertificate(*study); });
}

void AddFigure(CLI::App& app, Commands& commands) {
  const auto study = std::make_shared<PlanarStudy>();
  const auto start = std::make_shared<std::uint64_t>(3);
  const auto folder = std::make_shared<std::filesystem::path>("planar");
  const auto methods = std::make_shared<std::vector<std::string>>(
      std::vector<std::string>{"baseline", "dfr", "controller"});
  auto* figure = app.add_subcommand(
      "figure",
      "Write pictures and a video of one start state of a planar task, like the paper's Fig. 2");
  AddTask(*figure, *study);
  AddMethodOptions(*figure, study->methods);
  figure->add_option("--start", *start, "random seed of the start state")->capture_default_str();
  core::WritesFolder(figure->add_option("--out", *folder, "folder for the pictures and the video"))
      ->capture_default_str();
  figure->add_option("--methods", *methods, "methods, with one picture each")
      ->delimiter(',')
      ->check(apps::ReadBy([](const std::string& name) {
        static_cast<void>(ParseMethod(name, kPlanarMethods));
        static_cast<void>(SupportOf(name));
      }))
      ->capture_default_str();
  commands.emplace_back(figure, [=] { Picture(*study, *methods, *start, *folder); });
}

}  // namespace dfr::study::planar
