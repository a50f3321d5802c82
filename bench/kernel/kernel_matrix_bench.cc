// Checks that every fit converges. Draws random problems from the whole range of valid input:
// sizes, entries, kernel widths, nu, duplicates, clusters, scales, outliers. Verifies the results
// of a fit in double, and compares its objective with LIBSVM's if LIBSVM needs only seconds.
//
//   kernel_matrix_bench [--cells=N] [--most=SAMPLES] [--seed=N] [--seconds=S] [--minutes=M]
//
// Interrupts a fit after S seconds and counts it as interrupted. M limits the whole run.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <limits>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "bench/kernel/peers.h"
#include "bench/kernel/trajectories.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::bench {
namespace {

constexpr double kTolerance = 1e-3;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Options {
  int cells = 1000;
  int most = 50000;
  std::uint64_t seed = 1;
  double seconds = 10.0;
  double minutes = 3.0;

  static Options Parse(int argc, char** argv) {
    Options o;
    for (int i = 1; i < argc; ++i) {
      const std::string argument = argv[i];
      const auto at = argument.find('=');
      const std::string key = argument.substr(0, at);
      char* end = nullptr;
      const double value =
          at == std::string::npos ? -1.0 : std::strtod(argument.c_str() + at + 1, &end);
      if (end == nullptr || *end != '\0' || !(value >= 0.0)) o.Refuse(argument);
      if (key == "--cells") {
        o.cells = static_cast<int>(value);
      } else if (key == "--most" && value >= 2.0) {
        o.most = static_cast<int>(value);
      } else if (key == "--seed") {
        o.seed = static_cast<std::uint64_t>(value);
      } else if (key == "--seconds") {
        o.seconds = value;
      } else if (key == "--minutes") {
        o.minutes = value;
      } else if (key == "--benchmark_min_time") {  // a smoke test
        o.cells = 60;
        o.most = 500;
      } else {
        o.Refuse(argument);
      }
    }
    return o;
  }

 private:
  [[noreturn]] static void Refuse(const std::string& argument) {
    throw std::invalid_argument("invalid argument '" + argument +
                                "'; valid: --cells=N --most=SAMPLES (2 or more) --seed=N "
                                "--seconds=S --minutes=M");
  }
};

constexpr std::array<const char*, 8> kKinds = {"normal", "duplicates", "clusters",   "tiny",
                                               "huge",   "scales",     "an outlier", "drifting"};

core::Matrix Samples(std::size_t kind, int n, int d, core::Random& random) {
  const std::string_view name = kKinds[kind];
  if (name == "drifting") return DriftingTrajectories(n, d, random());
  core::Matrix x(n, d);
  for (double& entry : x.reshaped()) entry = random.Normal();
  for (Eigen::Index i = 0; i < n; ++i) {
    if (name == "duplicates" && i % 3 != 0) x.row(i) = x.row(i / 3);
    if (name == "clusters") x.row(i).array() += 100.0 * static_cast<double>(i % 4);
  }
  if (name == "tiny") x *= 1e-9;
  if (name == "huge") x = (1e9 * x).array() + 1e12;
  if (name == "scales") {
    for (Eigen::Index k = 0; k < d; ++k) x.col(k) *= std::pow(10.0, random.Uniform(-3.0, 3.0));
  }
  if (name == "an outlier") x.row(n / 2).setConstant(1e9);
  return x;
}

double MedianSquaredDistance(const core::Matrix& samples, core::Random& random) {
  std::vector<double> squared;
  for (int pair = 0; pair < 2000; ++pair) {
    const auto i = static_cast<Eigen::Index>(random.Below(samples.rows()));
    const auto j = static_cast<Eigen::Index>(random.Below(samples.rows()));
    const double square = (samples.row(i) - samples.row(j)).squaredNorm();
    if (square > 0.0) squared.push_back(square);
  }
  if (squared.empty()) return 1.0;
  const auto middle = squared.begin() + static_cast<std::ptrdiff_t>(squared.size() / 2);
  std::nth_element(squared.begin(), middle, squared.end());
  return *middle;
}

// Draws a number between the bounds, uniformly on a logarithmic scale, and sometimes a bound
// itself.
double Between(double low, double high, core::Random& random) {
  const double u = std::clamp(random.Uniform(-0.1, 1.1), 0.0, 1.0);
  return std::clamp(low * std::pow(high / low, u), low, high);
}

// Returns max G over alpha > 0 minus min G over alpha < 1 in LIBSVM's scale, computed from the
// definition. Uses all samples, or some of them if there are many.
double Gap(const core::Matrix& samples, const kernel::FitSummary& summary, double nu,
           double gamma) {
  constexpr double kMostWork = 1e9;
  const Eigen::Index n = samples.rows();
  const double total = nu * static_cast<double>(n);
  std::vector<Eigen::Index> support;
  for (Eigen::Index i = 0; i < n; ++i) {
    if (summary.alpha[i] > 0.0) support.push_back(i);
  }
  const double work =
      static_cast<double>(support.size()) * static_cast<double>(n * (samples.cols() + 20));
  const auto step = static_cast<Eigen::Index>(std::ceil(work / kMostWork));
  double largest = -kInfinity;
  double smallest = kInfinity;
  for (Eigen::Index i = 0; i < n; i += step) {
    double g = 0.0;
    for (const Eigen::Index j : support) {
      g += summary.alpha[j] * std::exp(-gamma * (samples.row(i) - samples.row(j)).squaredNorm());
    }
    if (summary.alpha[i] > 0.0) largest = std::max(largest, total * g);
    if (total * summary.alpha[i] < 1.0 - 1e-12) smallest = std::min(smallest, total * g);
  }
  return std::max(0.0, largest - smallest);
}

// Results of the problems of up to `most` samples.
struct Row {
  int most;
  int cells = 0;
  int converged = 0;
  int stalled = 0;
  int limited = 0;  // ended by the limit of iterations
  int interrupted = 0;
  int wrong = 0;
  double worst_gap = 0.0;
  int compared = 0;
  double worst_excess = -kInfinity;  // relative excess over LIBSVM's objective
  double slowest = 0.0;
};

class Matrix {
 public:
  explicit Matrix(const Options& options) : options_(options) {}

  // Draws problem `number`, fits it and checks the result.
  void Fit(int number) {
    core::Random random(core::DeriveSeed(options_.seed, {static_cast<std::uint64_t>(number)}));
    const auto kind = static_cast<std::size_t>(random.Below(kKinds.size()));
    const int n = static_cast<int>(std::lround(Between(2, options_.most, random)));
    const int d = static_cast<int>(std::lround(Between(1, 256, random)));
    const core::Matrix samples = Samples(kind, n, d, random);
    const double width = Between(1e-6, 1e6, random);
    const double gamma = width / MedianSquaredDistance(samples, random);
    const double nu = Between(1.0 / n, 1.0, random);
    const std::string name =
        core::Format("cell %d: %d x %d, %s, gamma %.2g over the median, nu %.3g", number, n, d,
                     kKinds[kind], width, nu);

    using Clock = std::chrono::steady_clock;
    const auto start = Clock::now();
    const auto seconds = [&] {
      return std::chrono::duration<double>(Clock::now() - start).count();
    };
    kernel::FitSummary summary;
    const auto svm = kernel::OneClassSvm::Fit(
        samples,
        {.nu = nu,
         .gamma = gamma,
         .tolerance = kTolerance,
         .threads = 0,
         .progress = [&](const kernel::FitProgress&) { return seconds() < options_.seconds; }},
        &summary);
    Row& row = *std::find_if(rows_.begin(), rows_.end(), [n](const Row& r) { return n <= r.most; });
    ++row.cells;
    row.slowest = std::max(row.slowest, seconds());
    using Reason = kernel::FitSummary::Reason;
    if (summary.reason == Reason::kInterrupted) {
      ++row.interrupted;
      std::printf("%s: interrupted after %.1f s at a gap of %.2g\n", name.c_str(), seconds(),
                  summary.kkt_gap);
      return;
    }
    if (summary.reason == Reason::kMaxIterations) {
      ++row.limited;
      std::printf("LIMIT %s: %lld iterations left a gap of %.2g\n", name.c_str(),
                  static_cast<long long>(summary.iterations), summary.kkt_gap);
      return;
    }
    if (summary.reason != Reason::kConverged) {
      ++row.stalled;
      std::printf("%s: doubles allow no better than a gap of %.2g\n", name.c_str(),
                  summary.kkt_gap);
      return;
    }
    ++row.converged;
    const double gap = Gap(samples, summary, nu, gamma);
    row.worst_gap = std::max(row.worst_gap, gap);
    // Allows for the rounding of the gap that is computed from the definition.
    if (gap > kTolerance * (1.0 + 1e-6) + 1e-12 * nu * n || !std::isfinite(svm.rho())) {
      ++row.wrong;
      std::printf("WRONG %s: the gap is %.3g, not %.3g\n", name.c_str(), gap, summary.kkt_gap);
    }
    if (n > kMostCompared) return;
    const auto peer = TrainLibsvm(samples, {.nu = nu, .gamma = gamma, .tolerance = kTolerance});
    const double objective = LibsvmObjective(*peer);
    ++row.compared;
    row.worst_excess = std::max(row.worst_excess, summary.objective / objective - 1.0);
    // Both objectives are within tolerance * nu n of the minimum, and LIBSVM rounds its kernel to
    // float.
    if (summary.objective > objective * (1.0 + 1e-6) + kTolerance * nu * n) {
      ++row.wrong;
      std::printf("WRONG %s: the objective is %.9g, LIBSVM's %.9g\n", name.c_str(),
                  summary.objective, objective);
    }
  }

  // Returns true if all uninterrupted fits meet their tolerance or the limit of doubles.
  [[nodiscard]] bool Print() const {
    std::printf("%-15s %6s %10s %8s %6s %12s %6s %10s %9s %13s %9s\n", "samples", "cells",
                "converged", "stalled", "limit", "interrupted", "wrong", "worst gap", "compared",
                "worst excess", "slowest");
    bool right = true;
    int least = 2;
    for (const Row& row : rows_) {
      if (row.cells > 0) {
        std::printf("%6d to %-6d %6d %10d %8d %6d %12d %6d %10.2g %9d %13s %7.2f s\n", least,
                    row.most, row.cells, row.converged, row.stalled, row.limited, row.interrupted,
                    row.wrong, row.worst_gap, row.compared,
                    row.compared > 0 ? core::Format("%.1e", row.worst_excess).c_str() : "",
                    row.slowest);
      }
      least = row.most + 1;
      right &= row.wrong == 0 && row.limited == 0;
    }
    std::printf(
        "A fit stalls where doubles allow no smaller gap. 'compared' counts the fits that LIBSVM "
        "also\ndid, 'worst excess' is the largest relative excess over its objective. Tolerance "
        "%g, seed %llu.\n",
        kTolerance, static_cast<unsigned long long>(options_.seed));
    return right;
  }

 private:
  static constexpr int kMostCompared = 1000;

  Options options_;
  std::vector<Row> rows_ = {{10}, {100}, {1000}, {10000}, {std::numeric_limits<int>::max()}};
};

}  // namespace
}  // namespace dfr::bench

int main(int argc, char** argv) try {
  using namespace dfr::bench;
  const Options options = Options::Parse(argc, argv);
  Matrix matrix(options);
  const auto end = std::chrono::steady_clock::now() +
                   std::chrono::milliseconds(static_cast<std::int64_t>(60e3 * options.minutes));
  for (int number = 0; number < options.cells && std::chrono::steady_clock::now() < end; ++number) {
    matrix.Fit(number);
  }
  return matrix.Print() ? EXIT_SUCCESS : EXIT_FAILURE;
} catch (const std::invalid_argument& e) {
  std::fprintf(stderr, "kernel_matrix_bench: %s\n", e.what());
  return 2;
} catch (const std::exception& e) {
  std::fprintf(stderr, "kernel_matrix_bench: %s\n", e.what());
  return EXIT_FAILURE;
}
