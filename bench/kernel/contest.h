#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace dfr::bench {

/// Command line of all contests, with Google Benchmark's option names.
struct ContestOptions {
  std::string filter;      ///< --benchmark_filter=TEXT: runs cases whose name contains TEXT.
  double min_time = 0.01;  ///< --benchmark_min_time=SECONDS per round; 0: one untimed repetition.
  int rounds = 9;          ///< --rounds=N; the result is the median over the rounds.
  std::string json;        ///< --benchmark_out=FILE; PROGRAM.json unless it is a smoke run
  std::string target;      ///< --target=NAME: our instruction set, such as AVX2; empty: the best.

  /// @throws std::invalid_argument naming the unknown argument.
  static ContestOptions Parse(int argc, char** argv);
  [[nodiscard]] bool Selects(const std::string& name) const;
  /// Restricts our code to --target, before any estimate is made.
  /// @throws std::invalid_argument listing the valid names if this machine lacks the target.
  void ForceTarget() const;
  /// Returns AVX2 as a second target if this machine has a better target and no --target was given.
  [[nodiscard]] std::optional<std::int64_t> SecondTarget() const;
  [[nodiscard]] bool smoke() const { return min_time == 0.0; }
};

/// One implementation of a job. One call of `run` does all operations of a contest. If `wrong` is
/// not empty, it describes a wrong answer, and the contestant is not timed.
struct Contestant {
  std::string name;
  std::function<void()> run;
  std::string wrong;
  bool peer = true;  ///< False if it is another form of the subject.
};

struct Timing {
  std::string name;
  double nanoseconds = 0.0;  ///< CPU time of one operation, median over the rounds; 0: not timed.
  std::string wrong;
  bool peer = true;
};

/// Times contestants alternately in rounds: a drift of the machine's speed affects all of them
/// equally. The first contestant is the subject, and the rest are its peers.
std::vector<Timing> RunContest(const std::vector<Contestant>& contestants, int operations,
                               const ContestOptions& options);

/// A case with its timings, bound (ns, 0: none) and further numbers.
struct CaseResult {
  std::string name;
  std::vector<Timing> timings;
  double bound_nanoseconds = 0.0;
  std::vector<std::pair<std::string, double>> counters;
};

/// Prints the row of a case: the subject's time, each peer's as a multiple of it, a mark if the
/// smallest multiple is below kLeastRatio, and the time as a multiple of the bound.
void PrintRow(const CaseResult& result);
inline constexpr double kLeastRatio = 8.0;

/// Writes all cases as JSON to ContestOptions::json, if it is set.
void WriteReport(const std::string& title, const std::vector<CaseResult>& results,
                 const ContestOptions& options);

/// Returns failure if the subject of any case gave a wrong answer.
[[nodiscard]] int ExitCode(const std::vector<CaseResult>& results);

}  // namespace dfr::bench
