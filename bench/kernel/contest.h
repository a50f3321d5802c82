#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace dfr::bench {

/// Command line that every contest understands, in the words of Google Benchmark.
struct ContestOptions {
  std::string filter;      ///< --benchmark_filter=TEXT: cases whose name contains it.
  double min_time = 0.01;  ///< --benchmark_min_time=SECONDS a round; 0: one repetition, untimed.
  int rounds = 9;          ///< --rounds=N; the median round counts.
  std::string json;        ///< --benchmark_out=FILE; PROGRAM.json unless it is a smoke run
  std::string picture;     ///< --picture=FILE.svg; PROGRAM.svg unless it is a smoke run
  std::string target;      ///< --target=NAME: our instruction set, AVX2 say, not the best.

  /// @throws std::invalid_argument naming the argument it does not know.
  static ContestOptions Parse(int argc, char** argv);
  [[nodiscard]] bool Selects(const std::string& name) const;
  /// Restricts our own code to --target, before any estimate is made.
  /// @throws std::invalid_argument with the names there are, if this machine has none such.
  void ForceTarget() const;
  /// AVX2 where this machine has better and no --target was given: what else to time.
  [[nodiscard]] std::optional<std::int64_t> SecondTarget() const;
  [[nodiscard]] bool smoke() const { return min_time == 0.0; }
};

/// One way to do a job. `run` does `operations` of it; `wrong` says why its answers do not count
/// (empty: they agree with the reference), and then it is not timed.
struct Contestant {
  std::string name;
  std::function<void()> run;
  std::string wrong;
  bool peer = true;  ///< Another library; not the subject in another form.
};

struct Timing {
  std::string name;
  double nanoseconds = 0.0;  ///< CPU time of one operation, median over the rounds; 0: not timed.
  std::string wrong;
  bool peer = true;
};

/// Times contestants in turn, round after round, so that a machine that drifts treats all alike.
/// The first one is the subject, the others its peers.
std::vector<Timing> RunContest(const std::vector<Contestant>& contestants, int operations,
                               const ContestOptions& options);

/// A case with its timings, bound (ns, 0: none) and remarks.
struct CaseResult {
  std::string name;
  std::vector<Timing> timings;
  double bound_nanoseconds = 0.0;
  std::vector<std::pair<std::string, double>> counters;
};

/// Prints one row a case: the subject's time, every other's as a multiple of it, the best peer's
/// with a mark where it is below kLeastRatio, and the subject's multiple of the bound.
void PrintRow(const CaseResult& result);
inline constexpr double kLeastRatio = 8.0;

/// Writes what the options ask for: all cases as JSON, and the ratios as a bar chart.
void WriteReports(const std::string& title, const std::vector<CaseResult>& results,
                  const ContestOptions& options);

/// Failure if the subject of any case gave a wrong answer.
[[nodiscard]] int ExitCode(const std::vector<CaseResult>& results);

/// CPU time of this process, in seconds.
[[nodiscard]] double CpuSeconds();

}  // namespace dfr::bench
