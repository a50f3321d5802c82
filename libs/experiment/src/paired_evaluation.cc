#include "dfr/experiment/paired_evaluation.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <charconv>
#include <chrono>
#include <cstddef>
#include <ctime>
#include <exception>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <stdexcept>
#include <thread>
#include <tuple>
#include <utility>

#include "dfr/core/build_info.h"
#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "hwy/targets.h"
#include "ledger/ledger_file.h"
#include "ledger/ledger_line.h"

namespace dfr::experiment {
namespace {

// First elements of the seed paths: start states and controllers draw from independent streams.
constexpr std::uint64_t kStartStream = 0;
constexpr std::uint64_t kControllerStream = 1;

void CheckNames(const char* what, const std::vector<std::string>& names) {
  DFR_THROW_UNLESS(!names.empty(), "a plan needs at least one " << what);
  std::set<std::string> seen;
  for (const std::string& name : names) {
    DFR_THROW_UNLESS(seen.insert(name).second, what << " '" << name << "' is named twice");
  }
}

std::uint64_t Step(int value) { return static_cast<std::uint64_t>(value); }

// Returns the set that Highway chooses; better sets have lower bits.
std::string InstructionSet() {
  const std::int64_t sets = hwy::SupportedTargets();
  return hwy::TargetName(sets & -sets);
}

std::string HostName() {
  std::array<char, 256> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "unknown";
}

UnitResult RunUnit(const EvaluationPlan& plan, const EvaluationUnit& unit,
                   const MakeTrialRunner& make, ProgressMeter& meter,
                   const std::atomic<bool>& stop) {
  const std::unique_ptr<TrialRunner> runner = make(unit);
  const std::string label = internal::NameOf(unit);
  UnitResult result;
  result.unit = unit;
  result.episodes.resize(plan.methods.size());
  for (int i = 0; i < plan.episodes && !stop; ++i) {
    const auto [start, rejected] = DrawStart(plan, unit, i, *runner);
    result.redrawn += rejected;
    result.starts.push_back(start);
    const std::uint64_t controller = ControllerSeed(plan, unit.trial, i);
    for (std::size_t method = 0; method < plan.methods.size(); ++method) {
      result.episodes[method].push_back(runner->Run(static_cast<int>(method), start, controller));
      meter.Advance(1, label);
    }
  }
  result.measures = runner->Measures();
  result.counts = runner->Counts();
  return result;
}

}  // namespace

void CheckPlan(const EvaluationPlan& plan) {
  CheckNames("method", plan.methods);
  CheckNames("learner", plan.learners);
  DFR_THROW_UNLESS(!plan.demonstrations.empty() &&
                       std::ranges::adjacent_find(plan.demonstrations, std::greater_equal()) ==
                           plan.demonstrations.end(),
                   "a plan needs numbers of demonstrations, ascending and distinct");
  DFR_THROW_UNLESS(plan.demonstrations.front() > 0,
                   "demonstrations must be positive, not " << plan.demonstrations.front());
  DFR_THROW_UNLESS(plan.trials > 0, "trials must be positive, not " << plan.trials);
  DFR_THROW_UNLESS(plan.episodes > 0, "episodes must be positive, not " << plan.episodes);
  DFR_THROW_UNLESS(plan.max_redraws > 0, "max_redraws must be positive, not " << plan.max_redraws);
}

Shard ParseShard(std::string_view text) {
  Shard shard;
  const char* const end = text.data() + text.size();
  const auto index = std::from_chars(text.data(), end, shard.index);
  const bool slash = index.ec == std::errc() && index.ptr != end && *index.ptr == '/';
  const auto count = slash ? std::from_chars(index.ptr + 1, end, shard.count) : index;
  DFR_THROW_UNLESS(slash && count.ec == std::errc() && count.ptr == end && 1 <= shard.index &&
                       shard.index <= shard.count,
                   "a shard is K/N with 1 <= K <= N, as in 2/7, not '" << text << "'");
  return shard;
}

DrawnStart DrawStart(const EvaluationPlan& plan, const EvaluationUnit& unit, int start,
                     TrialRunner& runner) {
  for (int attempt = 0; attempt < plan.max_redraws; ++attempt) {
    const std::uint64_t seed = StartSeed(plan, unit.trial, start, attempt);
    if (runner.Accepts(seed)) return {seed, attempt};
  }
  throw std::runtime_error("none of " + std::to_string(plan.max_redraws) +
                           " drawn start states is inside the support (" + internal::NameOf(unit) +
                           ")");
}

std::uint64_t StartSeed(const EvaluationPlan& plan, int trial, int start, int attempt) noexcept {
  return core::DeriveSeed(plan.seed, {kStartStream, Step(trial), Step(start), Step(attempt)});
}

std::uint64_t ControllerSeed(const EvaluationPlan& plan, int trial, int start) noexcept {
  return core::DeriveSeed(plan.seed, {kControllerStream, Step(trial), Step(start)});
}

std::vector<UnitResult> Evaluate(const EvaluationPlan& plan, const MakeTrialRunner& make,
                                 const EvaluationOptions& options) {
  CheckPlan(plan);
  DFR_THROW_UNLESS(options.threads >= 0, "threads must not be negative: " << options.threads);
  DFR_THROW_UNLESS(1 <= options.shard.index && options.shard.index <= options.shard.count,
                   "there is no shard " << options.shard.index << " of " << options.shard.count);
  std::vector<EvaluationUnit> units = UnitsOf(plan);
  const auto border = [&](int shard) {
    return std::ssize(units) * std::int64_t{shard} / options.shard.count;
  };
  units = {units.begin() + border(options.shard.index - 1),
           units.begin() + border(options.shard.index)};
  std::vector<UnitResult> results(units.size());
  std::vector<std::size_t> to_do;
  std::optional<internal::LedgerWriter> ledger;
  std::map<std::tuple<int, int, std::string>, const UnitResult*> finished;
  if (!options.ledger.empty()) {
    ledger.emplace(options.ledger,
                   LedgerHeader{plan, options.settings, core::BuildCommit(), options.shard},
                   options);
    for (const LedgerRecord& record : ledger->finished()) {
      const EvaluationUnit& unit = record.result.unit;
      finished[{unit.trial, unit.demonstrations, unit.learner}] = &record.result;
    }
  }
  for (std::size_t i = 0; i < units.size(); ++i) {
    const auto found = finished.find({units[i].trial, units[i].demonstrations, units[i].learner});
    if (found != finished.end()) {
      results[i] = *found->second;
    } else {
      to_do.push_back(i);
    }
  }

  const auto episodes_per_unit =
      static_cast<std::int64_t>(plan.methods.size()) * std::int64_t{plan.episodes};
  ProgressMeter meter(episodes_per_unit * std::ssize(units), options.progress,
                      episodes_per_unit * (std::ssize(units) - std::ssize(to_do)));
  std::atomic<std::size_t> next{0};
  std::atomic<bool> stop{false};
  std::exception_ptr error;
  std::atomic<std::size_t> done{0};
  std::mutex mutex;  // protects error and ledger
  const std::string host = HostName();
  const std::string instructions = InstructionSet();
  const auto work = [&] {
    while (!stop && (options.stop == nullptr || !*options.stop)) {
      const std::size_t k = next++;
      if (k >= to_do.size()) return;
      const std::size_t i = to_do[k];
      try {
        const auto begin = std::chrono::steady_clock::now();
        UnitResult result = RunUnit(plan, units[i], make, meter, stop);
        if (stop) return;
        const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - begin;
        const std::lock_guard lock(mutex);
        if (ledger) {
          ledger->Append({result, host, wall.count(), std::time(nullptr), instructions});
        }
        results[i] = std::move(result);
        ++done;
      } catch (...) {
        stop = true;
        const std::lock_guard lock(mutex);
        if (!error) error = std::current_exception();
      }
    }
  };
  {
    const std::size_t wanted = options.threads > 0
                                   ? static_cast<std::size_t>(options.threads)
                                   : std::max(1u, std::thread::hardware_concurrency());
    std::vector<std::jthread> threads;
    for (std::size_t i = 1; i < std::min(wanted, to_do.size()); ++i) threads.emplace_back(work);
    work();
  }
  if (error) std::rethrow_exception(error);
  if (done < to_do.size()) {
    throw Interrupted("interrupted after " + std::to_string(units.size() - to_do.size() + done) +
                      " of " + std::to_string(units.size()) +
                      (ledger ? " units; the same command resumes from there"
                              : " units, which are lost; a run with --out keeps finished units"));
  }
  return results;
}

}  // namespace dfr::experiment
