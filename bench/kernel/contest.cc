#include "bench/kernel/contest.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string_view>

#include "bench/cpu_seconds.h"
#include "bench/kernel/machine.h"
#include "dfr/core/numerics/quantile.h"
#include "gaussian/gaussian_sum.h"

namespace dfr::bench {

ContestOptions ContestOptions::Parse(int argc, char** argv) {
  ContestOptions options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    const auto value = [&](std::string_view key, auto&& assign) {
      if (!argument.starts_with(key)) return false;
      assign(std::string(argument.substr(key.size())));
      return true;
    };
    const bool known =
        value("--benchmark_filter=", [&](std::string v) { options.filter = std::move(v); }) ||
        value("--benchmark_min_time=",
              [&](const std::string& v) { options.min_time = std::strtod(v.c_str(), nullptr); }) ||
        value("--rounds=", [&](const std::string& v) { options.rounds = std::atoi(v.c_str()); }) ||
        value("--benchmark_out=", [&](std::string v) { options.json = std::move(v); }) ||
        value("--target=", [&](std::string v) { options.target = std::move(v); });
    if (!known || options.rounds < 1 || !(options.min_time >= 0.0)) {
      throw std::invalid_argument(
          "invalid argument '" + std::string(argument) +
          "'; valid: --benchmark_filter=TEXT --benchmark_min_time=SECONDS --rounds=N "
          "--benchmark_out=FILE.json --target=NAME");
    }
  }
  if (!options.smoke() && options.json.empty()) options.json = std::string(argv[0]) + ".json";
  return options;
}

void ContestOptions::ForceTarget() const {
  if (target.empty()) return;
  std::string names;
  for (const std::int64_t candidate : kernel::internal::SupportedTargets()) {
    if (kernel::internal::TargetName(candidate) == target) {
      kernel::internal::ForceTarget(candidate);
      return;
    }
    names += std::string(" ") + kernel::internal::TargetName(candidate);
  }
  throw std::invalid_argument("--target: this machine has no '" + target + "'; valid:" + names);
}

bool ContestOptions::Selects(const std::string& name) const {
  return name.find(filter) != std::string::npos;
}

std::optional<std::int64_t> ContestOptions::SecondTarget() const {
  if (!target.empty()) return std::nullopt;
  const std::vector<std::int64_t> targets = kernel::internal::SupportedTargets();
  const auto second = std::find_if(targets.begin() + 1, targets.end(), [](std::int64_t candidate) {
    return std::string_view(kernel::internal::TargetName(candidate)) == "AVX2";
  });
  return second == targets.end() ? std::nullopt : std::optional(*second);
}

std::vector<Timing> RunContest(const std::vector<Contestant>& contestants, int operations,
                               const ContestOptions& options) {
  std::vector<Timing> timings;
  std::vector<int> repetitions;
  std::vector<std::vector<double>> samples(contestants.size());
  for (const Contestant& c : contestants) {
    timings.push_back({c.name, 0.0, c.wrong, c.peer});
    repetitions.push_back(1);
    if (!c.wrong.empty()) continue;
    const double start = CpuSeconds();
    c.run();
    const double once = std::max(CpuSeconds() - start, 1e-7);
    repetitions.back() = static_cast<int>(std::clamp(std::ceil(options.min_time / once), 1.0, 1e6));
    // Slower contestants are timed once, because their noise is negligible.
    constexpr double kLong = 1.0;
    if (once > kLong) {
      repetitions.back() = 0;
      samples[repetitions.size() - 1].push_back(once / operations * 1e9);
    }
  }
  if (options.smoke()) return timings;
  for (int round = 0; round < options.rounds; ++round) {
    for (std::size_t i = 0; i < contestants.size(); ++i) {
      if (!contestants[i].wrong.empty() || repetitions[i] == 0) continue;
      const double start = CpuSeconds();
      for (int k = 0; k < repetitions[i]; ++k) contestants[i].run();
      samples[i].push_back((CpuSeconds() - start) / repetitions[i] / operations * 1e9);
    }
  }
  for (std::size_t i = 0; i < contestants.size(); ++i) {
    if (!samples[i].empty()) timings[i].nanoseconds = core::Median(samples[i]);
  }
  return timings;
}

void PrintRow(const CaseResult& result) {
  const Timing& subject = result.timings.at(0);
  const bool milliseconds = subject.nanoseconds > 1e5;
  std::printf("%-38s", result.name.c_str());
  if (!subject.wrong.empty()) {
    std::printf(" not timed: %s\n", subject.wrong.c_str());
    return;
  }
  if (subject.nanoseconds == 0.0) {
    std::printf(" ran, untimed\n");
    return;
  }
  std::printf(" %9.4g %s", subject.nanoseconds * (milliseconds ? 1e-6 : 1.0),
              milliseconds ? "ms" : "ns");
  for (std::size_t i = 1; i < result.timings.size(); ++i) {
    const Timing& peer = result.timings[i];
    if (!peer.wrong.empty()) {
      std::printf("  %s: %s", peer.name.c_str(), peer.wrong.c_str());
    } else {
      std::printf("  %s %.1fx", peer.name.c_str(), peer.nanoseconds / subject.nanoseconds);
    }
  }
  const Timing* best = nullptr;
  for (std::size_t i = 1; i < result.timings.size(); ++i) {
    const Timing& timing = result.timings[i];
    if (!timing.peer || timing.nanoseconds == 0.0) continue;
    if (best == nullptr || timing.nanoseconds < best->nanoseconds) best = &timing;
  }
  if (best != nullptr) {
    const double ratio = best->nanoseconds / subject.nanoseconds;
    std::printf("  best peer %.1fx%s", ratio, ratio < kLeastRatio ? " BELOW 8x" : "");
  }
  if (result.bound_nanoseconds > 0.0) {
    std::printf("  bound %.2fx", subject.nanoseconds / result.bound_nanoseconds);
  }
  for (const auto& [name, value] : result.counters) std::printf("  %s %g", name.c_str(), value);
  std::printf("\n");
  std::fflush(stdout);
}

int ExitCode(const std::vector<CaseResult>& results) {
  const bool wrong = std::any_of(results.begin(), results.end(), [](const CaseResult& r) {
    return !r.timings.at(0).wrong.empty();
  });
  return wrong ? EXIT_FAILURE : EXIT_SUCCESS;
}

void WriteReport(const std::string& title, const std::vector<CaseResult>& results,
                 const ContestOptions& options) {
  if (options.json.empty()) return;
  nlohmann::json cases = nlohmann::json::array();
  for (const CaseResult& r : results) {
    nlohmann::json timings = nlohmann::json::array();
    for (const Timing& t : r.timings) {
      timings.push_back({{"name", t.name}, {"cpu_nanoseconds", t.nanoseconds}, {"wrong", t.wrong}});
    }
    nlohmann::json counters = nlohmann::json::object();
    for (const auto& [name, value] : r.counters) counters[name] = value;
    cases.push_back({{"name", r.name},
                     {"timings", timings},
                     {"bound_nanoseconds", r.bound_nanoseconds},
                     {"counters", counters}});
  }
  std::ofstream file(options.json);
  if (!file) throw std::runtime_error(options.json + ": cannot be written");
  file << nlohmann::json{{"title", title}, {"machine", Describe(Measure())}, {"cases", cases}}.dump(
              1)
       << '\n';
  std::printf("wrote %s\n", options.json.c_str());
}

}  // namespace dfr::bench
