// Single decisions and batches, compared with LIBSVM, OpenCV, dlib and plain Eigen.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bench/kernel/contest.h"
#include "bench/kernel/machine.h"
#include "bench/kernel/peers.h"
#include "bench/kernel/trajectories.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::bench {
namespace {

constexpr int kQueries = 1024;

struct Fitted {
  Fitted(int sv, int d) : samples(PooledTrajectories(2 * sv, d, 1)) {
    queries = PooledTrajectories(kQueries, d, 2);
    options.nu = 0.47;
    options.gamma = 1.0 / d;
    svm = kernel::OneClassSvm::Fit(
        samples, {.nu = options.nu, .gamma = options.gamma, .tolerance = options.tolerance});
    scale = svm->libsvm_scale();
    expected.resize(kQueries);
    for (int i = 0; i < kQueries; ++i) {
      long double sum = 0.0L;
      for (Eigen::Index j = 0; j < svm->alpha().size(); ++j) {
        const double squared = (queries.row(i) - svm->support_vectors().row(j)).squaredNorm();
        sum += static_cast<long double>(svm->alpha()[j]) * std::exp(-options.gamma * squared);
      }
      expected[static_cast<std::size_t>(i)] = static_cast<double>(sum) - svm->rho();
    }
  }
  // Returns a message if the maximum error over all queries, as a fraction of rho, exceeds
  // `tolerance`; otherwise an empty string.
  template <typename Decide>
  std::string Check(Decide&& decide, double tolerance) const {
    double worst = 0.0;
    for (int i = 0; i < kQueries; ++i) {
      worst = std::max(worst, std::abs(decide(i) - expected[static_cast<std::size_t>(i)]));
    }
    if (worst <= tolerance * svm->rho()) return "";
    char text[60];
    std::snprintf(text, sizeof(text), "wrong answer, by %.1e rho", worst / svm->rho());
    return text;
  }
  core::Matrix samples, queries;
  PeerOptions options;
  std::optional<kernel::OneClassSvm> svm;
  double scale = 1.0;
  std::vector<double> expected;
};

volatile double sink;

using Decide = std::function<double(int)>;

// An implementation. `factor` times `decide` is g in our scale, up to `tolerance` times rho.
struct Entrant {
  std::string name;
  Decide decide;
  std::function<void(std::span<double>)> decide_all;
  double factor;
  double tolerance;  // peers are fitted separately, to a tolerance of 1e-3
  // Largest difference between a batch and single queries, in our scale. Ours agree bitwise.
  double batch_tolerance;
};

class DecisionCase {
 public:
  DecisionCase(int d, int sv) : fitted_(sv, d), d_(d) {
    const auto& f = fitted_;
    single_ = f.svm->InSinglePrecision();
    Add("double", *f.svm, 1e-12);
    Add("float", *single_, 2e-6);
    peers_.emplace_back("LIBSVM", TrainLibsvm(f.samples, f.options));
    peers_.emplace_back("OpenCV", TrainOpenCv(f.samples, f.options));
    peers_.emplace_back("dlib", TrainDlib(f.samples, f.options));
    peers_.emplace_back("Eigen", PlainEigen(f.svm->support_vectors(), f.svm->alpha() * f.scale,
                                            f.options.gamma, f.svm->rho() * f.scale));
    for (auto& [name, peer] : peers_) {
      peer->Prepare(f.queries);
      entrants_.push_back({name, [p = peer.get()](int i) { return p->Decide(i); },
                           [p = peer.get()](std::span<double> g) { p->DecideAll(g); },
                           1.0 / f.scale, 5e-2, 1e-6});
    }
  }

  // Queries change on every call, as on the robot, because the branch predictor would learn a
  // repeated query.
  void Warm(const ContestOptions& options, std::vector<CaseResult>& results) const {
    std::vector<Contestant> contestants;
    for (const Entrant& e : entrants_) {
      const auto all = [&e] {
        double sum = 0.0;
        for (int i = 0; i < kQueries; ++i) sum += e.decide(i);
        sink = sum;
      };
      contestants.push_back({e.name, all, Check(e)});
    }
    Report("one query", RunContest(contestants, kQueries, options), results);
  }

  void Batch(const ContestOptions& options, std::vector<CaseResult>& results) const {
    std::vector<double> g(kQueries);
    std::vector<Contestant> contestants;
    for (const Entrant& e : entrants_) {
      contestants.push_back({e.name, [&] { e.decide_all(g); }, Check(e)});
    }
    Report("batch", RunContest(contestants, kQueries, options), results);
  }

  // Measures the wall time of one query with cold caches: the median of many rounds. An "empty"
  // call only reads the query; its time is the overhead of a cold call.
  void Cold(const ContestOptions& options, std::vector<CaseResult>& results) const {
    std::vector<char> other(std::size_t{48} << 20, 1);
    std::vector<Entrant> entrants = entrants_;
    entrants.push_back(
        {"empty", [this](int i) { return fitted_.queries(i, 0); }, {}, 1.0, 0.0, 0.0});
    std::vector<std::vector<double>> times(entrants.size());
    const int rounds = options.smoke() ? 1 : 25;
    for (int round = 0; round < rounds; ++round) {
      for (std::size_t i = 0; i < entrants.size(); ++i) {
        for (std::size_t k = 0; k < other.size(); k += 64) ++other[k];
        const auto start = std::chrono::steady_clock::now();
        sink = entrants[i].decide(round);
        const auto stop = std::chrono::steady_clock::now();
        times[i].push_back(std::chrono::duration<double, std::nano>(stop - start).count());
      }
    }
    std::vector<Timing> timings;
    timings.reserve(entrants_.size());
    for (std::size_t i = 0; i < entrants_.size(); ++i) {
      timings.push_back({entrants_[i].name, core::Median(times[i]), Check(entrants_[i])});
    }
    Report("cold", timings, results, {{"empty call ns", core::Median(times.back())}});
  }

 private:
  void Add(const char* name, const kernel::OneClassSvm& svm, double tolerance) {
    entrants_.push_back(
        {name, [this, &svm](int i) { return svm.Decision(core::Row(fitted_.queries, i)); },
         [this, &svm](std::span<double> g) { svm.DecisionBatch(fitted_.queries, g); }, 1.0,
         tolerance, 0.0});
  }

  std::string Check(const Entrant& e) const {
    std::vector<double> all(kQueries);
    e.decide_all(all);
    for (int i = 0; i < kQueries; ++i) {
      const double difference = std::abs(all[static_cast<std::size_t>(i)] - e.decide(i));
      if (!(e.factor * difference <= e.batch_tolerance)) {
        return "batch differs from single queries";
      }
    }
    return fitted_.Check([&](int i) { return e.factor * e.decide(i); }, e.tolerance);
  }

  // Reports one row for each of our two precisions, against the same peers.
  void Report(const char* what, const std::vector<Timing>& timings,
              std::vector<CaseResult>& results,
              const std::vector<std::pair<std::string, double>>& counters = {}) const {
    const auto terms = static_cast<std::size_t>(fitted_.svm->num_support_vectors());
    for (const std::size_t ours : {0u, 1u}) {
      const std::size_t bytes = ours == 0 ? 8 : 4;
      char name[80];
      std::snprintf(name, sizeof(name), "%s %s d=%d sv=%zu", what, timings[ours].name.c_str(), d_,
                    terms);
      CaseResult result{name, {timings[ours]}, 0.0, counters};
      result.timings.insert(result.timings.end(), timings.begin() + 2, timings.end());
      if (std::string(what) != "cold") {
        result.bound_nanoseconds = DecisionBound(Measure(), terms, static_cast<std::size_t>(d_),
                                                 bytes, std::string(what) == "batch");
      }
      PrintRow(result);
      results.push_back(std::move(result));
    }
  }

  Fitted fitted_;
  int d_;
  std::optional<kernel::OneClassSvm> single_;
  std::vector<std::pair<std::string, std::unique_ptr<Peer>>> peers_;
  std::vector<Entrant> entrants_;
};

}  // namespace
}  // namespace dfr::bench

int main(int argc, char** argv) try {
  using namespace dfr::bench;
  const ContestOptions options = ContestOptions::Parse(argc, argv);
  options.ForceTarget();
  std::printf("%s\n", Describe(Measure()).c_str());
  std::vector<CaseResult> results;
  for (const int d : {3, 9, 16, 32}) {
    for (const int sv : {20, 64, 256, 600, 5000}) {
      if (options.smoke() && sv > 300) continue;
      char name[40];
      std::snprintf(name, sizeof(name), "d=%d sv=%d", d, sv);
      if (!options.Selects(name)) continue;
      const DecisionCase contest(d, sv);
      contest.Warm(options, results);
      if (sv >= 256) contest.Batch(options, results);
      if (sv >= 64 && sv <= 600) contest.Cold(options, results);
    }
  }
  WriteReport("Decision function", results, options);
  return ExitCode(results);
} catch (const std::invalid_argument& e) {
  std::fprintf(stderr, "kernel_decision_bench: %s\n", e.what());
  return 2;
} catch (const std::exception& e) {
  std::fprintf(stderr, "kernel_decision_bench: %s\n", e.what());
  return EXIT_FAILURE;
}
