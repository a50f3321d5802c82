// Training compared with LIBSVM, OpenCV and dlib, with the same stopping tolerance.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bench/kernel/contest.h"
#include "bench/kernel/machine.h"
#include "bench/kernel/peers.h"
#include "bench/kernel/trajectories.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"
#include "gaussian/gaussian_sum.h"
#include "support/fit_sharing.h"
#include "support/states_at.h"

namespace dfr::bench {
namespace {

constexpr double kTolerance = 1e-3;
constexpr double kMemoryMib = 200.0;  // size of LIBSVM's cache

enum class Data { kPooled, kDrifting };

struct TrainingCase {
  int n;
  int d;
  double gamma;
  double nu;
  Data data = Data::kPooled;
  bool libsvm_only = false;  // the other libraries take minutes
};

// KKT gap and objective in LIBSVM's scale, computed in double from the support vectors alone.
struct Audit {
  double gap = 0.0;
  double objective = 0.0;
};

Audit Check(const kernel::OneClassSvm& svm, const kernel::FitSummary& summary,
            const core::Matrix& samples, double nu) {
  std::vector<double> g(static_cast<std::size_t>(samples.rows()));
  svm.DecisionBatch(samples, g);
  Audit audit;
  double largest = -std::numeric_limits<double>::infinity();
  double smallest = std::numeric_limits<double>::infinity();
  const double scale = svm.libsvm_scale();
  const double bound = 1.0 / (nu * static_cast<double>(samples.rows()));
  for (std::size_t i = 0; i < g.size(); ++i) {
    const double gradient = (g[i] + svm.rho()) * scale;
    const double alpha = summary.alpha[static_cast<Eigen::Index>(i)];
    if (alpha > 0.0) largest = std::max(largest, gradient);
    if (alpha < bound * (1.0 - 1e-9)) smallest = std::min(smallest, gradient);
    audit.objective += 0.5 * alpha * scale * gradient;
  }
  audit.gap = largest - smallest;
  return audit;
}

void Train(const TrainingCase& c, const ContestOptions& options, std::vector<CaseResult>& results) {
  char name[80];
  std::snprintf(name, sizeof(name), "%s n=%d d=%d gamma=%.3g nu=%g",
                c.data == Data::kPooled ? "train" : "drift", c.n, c.d, c.gamma, c.nu);
  if (!options.Selects(name)) return;
  const core::Matrix samples =
      c.data == Data::kPooled ? PooledTrajectories(c.n, c.d, 3) : DriftingTrajectories(c.n, c.d, 8);
  const PeerOptions peer_options{.nu = c.nu, .gamma = c.gamma, .tolerance = kTolerance};
  const kernel::OneClassSvmOptions ours{
      .nu = c.nu, .gamma = c.gamma, .tolerance = kTolerance, .memory_mib = kMemoryMib};
  kernel::FitSummary summary;
  const auto svm = kernel::OneClassSvm::Fit(samples, ours, &summary);
  const Audit audit = Check(svm, summary, samples, c.nu);
  std::string wrong;
  char text[80];
  if (audit.gap > 1.1 * kTolerance) {
    std::snprintf(text, sizeof(text), "KKT gap %.2e", audit.gap);
    wrong = text;
  }
  std::unique_ptr<Peer> libsvm;
  std::vector<Contestant> contestants;
  contestants.push_back({"ours", [&] { (void)kernel::OneClassSvm::Fit(samples, ours); }, wrong});
  contestants.push_back({"LIBSVM", [&] { libsvm = TrainLibsvm(samples, peer_options); }, ""});
  if (!c.libsvm_only) {
    contestants.push_back({"OpenCV", [&] { (void)TrainOpenCv(samples, peer_options); }, ""});
    contestants.push_back({"dlib", [&] { (void)TrainDlib(samples, peer_options); }, ""});
  }
  const std::optional<std::int64_t> avx2 = options.SecondTarget();
  if (avx2) {
    contestants.push_back({"ours with AVX2",
                           [&] {
                             kernel::internal::ForceTarget(*avx2);
                             (void)kernel::OneClassSvm::Fit(samples, ours);
                             kernel::internal::ForceTarget(0);
                           },
                           "", false});
  }
  CaseResult result{name, RunContest(contestants, 1, options), 0.0, {}};
  // This check is not timed, because it evaluates the kernel for each pair of support vectors.
  const double excess = audit.objective / LibsvmObjective(*libsvm) - 1.0;
  // Our objective may be lower. An excess of 1e-4 over LIBSVM's indicates another solution.
  if (excess > 1e-4) result.timings[0].wrong = "objective " + std::to_string(excess) + " too high";
  const auto support = static_cast<std::size_t>(svm.num_support_vectors());
  result.bound_nanoseconds =
      static_cast<double>(support) * DecisionBound(Measure(), static_cast<std::size_t>(c.n),
                                                   static_cast<std::size_t>(c.d), 4, true);
  result.counters = {{"sv", static_cast<double>(support)},
                     {"libsvm_sv", static_cast<double>(libsvm->num_support_vectors())},
                     {"iterations", static_cast<double>(summary.iterations)},
                     {"gap", audit.gap},
                     {"objective_excess", excess}};
  if (avx2 && !options.smoke()) {
    result.counters.emplace_back("libsvm_over_avx2",
                                 result.timings[1].nanoseconds / result.timings.back().nanoseconds);
  }
  PrintRow(result);
  results.push_back(std::move(result));
}

// One estimate per time step: 100 problems of 120 samples of 12 entries.
class PerStep {
 public:
  PerStep() {
    const core::Matrix states = 0.3 * PooledTrajectories(kDemonstrations * kSteps, 12, 4);
    for (int i = 0; i < kDemonstrations; ++i) {
      demonstrations_.push_back(states.middleRows(i * kSteps, kSteps));
    }
    for (int t = 0; t < kSteps; ++t) {
      core::Matrix problem(kDemonstrations, 12);
      for (int i = 0; i < kDemonstrations; ++i) problem.row(i) = states.row(i * kSteps + t);
      problems_.push_back(problem);
    }
  }

  // Trains all problems at once, then each from the alpha of the previous time step.
  void Train(const ContestOptions& options, std::vector<CaseResult>& results) const {
    const kernel::TimeVaryingSupportOptions ours{
        .svm = {.nu = kNu, .gamma = kGamma, .tolerance = kTolerance}};
    std::vector<kernel::FitSummary> summaries;
    (void)kernel::TimeVaryingSupport::Fit(demonstrations_, ours, &summaries);
    Run("100 problems of n=120 d=12 gamma=5",
        {"ours", [&] { (void)kernel::TimeVaryingSupport::Fit(demonstrations_, ours); }, ""},
        Peers({kGamma}), options, results);
    const auto warm = [&] {
      for (std::size_t t = 0; t < problems_.size(); ++t) {
        kernel::OneClassSvmOptions svm = ours.svm;
        svm.start = core::AsSpan(std::as_const(summaries[t == 0 ? 0 : t - 1].alpha));
        (void)kernel::OneClassSvm::Fit(problems_[t], svm);
      }
    };
    Run("100 problems of n=120 from the last step", {"ours", warm, ""}, Peers({kGamma}), options,
        results);
  }

  // Fits the grid of one fold of SelectModel().
  void TrainGrid(const ContestOptions& options, std::vector<CaseResult>& results) const {
    const std::vector<double> gammas = {0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0};
    kernel::TimeVaryingSupportOptions ours{.svm = {.nu = kNu, .tolerance = kTolerance}};
    std::vector<kernel::internal::NuGamma> grid;
    for (const double gamma : gammas) grid.push_back({kNu, gamma});
    std::vector<Contestant> peers = Peers(gammas);
    const auto separately = [&] {
      for (const double gamma : gammas) {
        ours.svm.gamma = gamma;
        (void)kernel::TimeVaryingSupport::Fit(demonstrations_, ours);
      }
    };
    peers.push_back({"each gamma by itself", separately, "", false});
    Run("100 problems of n=120, 7 gammas",
        {"ours",
         [&] {
           (void)kernel::internal::FitGrid(kernel::internal::Views(demonstrations_), ours, grid);
         },
         ""},
        peers, options, results);
  }

 private:
  static constexpr int kDemonstrations = 120;
  static constexpr int kSteps = 100;
  static constexpr double kNu = 0.05;
  static constexpr double kGamma = 5.0;

  [[nodiscard]] std::vector<Contestant> Peers(const std::vector<double>& gammas) const {
    const auto all = [this, gammas](auto&& train) {
      return [this, gammas, train] {
        for (const double gamma : gammas) {
          for (const core::Matrix& problem : problems_) {
            (void)train(problem, PeerOptions{.nu = kNu, .gamma = gamma, .tolerance = kTolerance});
          }
        }
      };
    };
    return {{"LIBSVM", all(TrainLibsvm), ""},
            {"OpenCV", all(TrainOpenCv), ""},
            {"dlib", all(TrainDlib), ""}};
  }

  static void Run(const char* name, Contestant ours, const std::vector<Contestant>& peers,
                  const ContestOptions& options, std::vector<CaseResult>& results) {
    if (!options.Selects(name)) return;
    std::vector<Contestant> contestants = {std::move(ours)};
    contestants.insert(contestants.end(), peers.begin(), peers.end());
    CaseResult result{name, RunContest(contestants, 1, options), 0.0, {}};
    PrintRow(result);
    results.push_back(std::move(result));
  }

  std::vector<core::Matrix> demonstrations_, problems_;
};

}  // namespace
}  // namespace dfr::bench

int main(int argc, char** argv) try {
  using namespace dfr::bench;
  ContestOptions options = ContestOptions::Parse(argc, argv);
  if (options.smoke()) options.filter = "n=120 ";
  options.rounds = std::min(options.rounds, 3);
  options.ForceTarget();
  std::printf("%s\n", Describe(Measure()).c_str());
  std::vector<CaseResult> results;
  constexpr TrainingCase kCases[] = {{120, 9, 5.0, 0.05},
                                     {1200, 9, 5.0, 0.05},
                                     {1200, 9, 1.0 / 9.0, 0.05},
                                     {12000, 3, 5.0, 0.05},
                                     {1200, 9, 1.0 / 9.0, 0.5},
                                     {12000, 9, 1.0 / 9.0, 0.05},
                                     {12000, 9, 1.0 / 9.0, 0.5},
                                     {12000, 9, 1.0 / 9.0, 0.8},
                                     {12000, 9, 5.0, 0.05},
                                     {12000, 32, 1.0 / 32, 0.05},
                                     {50000, 9, 1.0 / 9.0, 0.05},
                                     {100000, 9, 1.0 / 9.0, 0.05},
                                     {50000, 9, 5.0, 0.05, Data::kPooled, true},
                                     {120, 9, 5.0, 0.05, Data::kDrifting},
                                     {1200, 9, 5.0, 0.05, Data::kDrifting},
                                     {12000, 9, 5.0, 0.05, Data::kDrifting},
                                     {12000, 16, 5.0, 0.05, Data::kDrifting},
                                     {12000, 32, 5.0, 0.05, Data::kDrifting},
                                     {50000, 9, 5.0, 0.05, Data::kDrifting, true}};
  for (const TrainingCase& c : kCases) {
    Train(c, options, results);
  }
  const PerStep per_step;
  per_step.Train(options, results);
  per_step.TrainGrid(options, results);
  WriteReport("Training", results, options);
  return ExitCode(results);
} catch (const std::invalid_argument& e) {
  std::fprintf(stderr, "kernel_training_bench: %s\n", e.what());
  return 2;
} catch (const std::exception& e) {
  std::fprintf(stderr, "kernel_training_bench: %s\n", e.what());
  return EXIT_FAILURE;
}
