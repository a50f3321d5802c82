#include "dfr/experiment/summary.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <ostream>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/text/format.h"

namespace dfr::experiment {
namespace {

using Json = nlohmann::ordered_json;

// With fewer trials, clustered intervals are too wide to be useful.
constexpr int kFewTrials = 5;

// Trial t belongs to cluster t % NumClusters(). Trials that share a supervisor are dependent.
int NumClusters(const EvaluationPlan& plan) {
  return plan.supervisors >= kFewTrials ? std::min(plan.supervisors, plan.trials) : plan.trials;
}

// Sums over the episodes of a cell.
struct Tally {
  int episodes = 0;
  int completed = 0;
  int halted = 0;
  int collided = 0;
  std::int64_t controls = 0;
  std::int64_t recovery_controls = 0;
  std::int64_t changed_controls = 0;
  std::int64_t sized_changes = 0;
  double change = 0.0;
  double seconds = 0.0;
  int redrawn = 0;
  // For each outcome, the counts of all clusters.
  std::map<core::Outcome, std::vector<ClusterCount>> clusters;
  std::map<std::string, int> halt_causes;
  std::map<std::string, int> collision_causes;

  void Add(const EpisodeResult& episode, int cluster) {
    ++episodes;
    for (const core::Outcome outcome :
         {core::Outcome::kCompleted, core::Outcome::kHalted, core::Outcome::kCollided}) {
      std::vector<ClusterCount>& counts = clusters[outcome];
      counts.resize(std::max(counts.size(), static_cast<std::size_t>(cluster) + 1));
      ++counts[static_cast<std::size_t>(cluster)].episodes;
      counts[static_cast<std::size_t>(cluster)].successes += episode.outcome == outcome ? 1 : 0;
    }
    controls += episode.controls;
    recovery_controls += episode.recovery_controls;
    changed_controls += episode.changed_controls;
    sized_changes += episode.sized_changes;
    change += episode.change;
    seconds += episode.seconds;
    switch (episode.outcome) {
      case core::Outcome::kCompleted:
        ++completed;
        break;
      case core::Outcome::kHalted:
        ++halted;
        ++halt_causes[episode.cause];
        break;
      case core::Outcome::kCollided:
        ++collided;
        ++collision_causes[episode.cause];
        break;
    }
  }

  [[nodiscard]] Cell ToCell(const std::string& method, const std::string& learner,
                            int demonstrations, int trials) const {
    const auto share = [&](int count, core::Outcome outcome) {
      return Share{static_cast<double>(count) / episodes,
                   trials < kFewTrials ? ProportionInterval(count, episodes)
                                       : ClusteredInterval(clusters.at(outcome))};
    };
    Cell cell;
    cell.method = method;
    cell.learner = learner;
    cell.demonstrations = demonstrations;
    cell.trials = trials;
    cell.episodes = episodes;
    cell.completed = share(completed, core::Outcome::kCompleted);
    cell.halted = share(halted, core::Outcome::kHalted);
    cell.collided = share(collided, core::Outcome::kCollided);
    cell.seconds_per_trajectory = seconds / episodes;
    cell.controls_per_trajectory = static_cast<double>(controls) / episodes;
    cell.recovery_controls = static_cast<double>(recovery_controls) / episodes;
    if (controls > 0) {
      cell.passed = 1.0 - static_cast<double>(changed_controls) / static_cast<double>(controls);
    }
    if (sized_changes > 0) cell.change = change / static_cast<double>(sized_changes);
    cell.redrawn_starts = redrawn;
    cell.halt_causes = halt_causes;
    cell.collision_causes = collision_causes;
    return cell;
  }
};

std::optional<double> Ratio(double value, double reference) {
  if (!(reference > 0.0) || !std::isfinite(value)) return std::nullopt;
  return value / reference;
}

// Compares a method with the reference. A unit is a cluster, or a start state if trials are few.
Contrast MakeContrast(const EvaluationPlan& plan, std::size_t method, const std::string& learner,
                      std::span<const UnitResult> results) {
  Contrast contrast;
  contrast.method = plan.methods[method];
  contrast.against = plan.methods[0];
  contrast.learner = learner;
  const bool by_trial = plan.trials >= kFewTrials;
  const int clusters = by_trial ? NumClusters(plan) : plan.trials;
  contrast.clusters = !by_trial ? "episodes" : clusters < plan.trials ? "supervisors" : "trials";
  const auto units_per_trial = static_cast<std::size_t>(by_trial ? 1 : plan.episodes);
  std::vector<PairedCounts> units(static_cast<std::size_t>(clusters) * units_per_trial);
  std::vector<DiscordantPairs> pairs(units.size());
  for (const UnitResult& result : results) {
    if (result.unit.learner != learner) continue;
    for (std::size_t k = 0; k < static_cast<std::size_t>(plan.episodes); ++k) {
      const core::Outcome outcome = result.episodes[method][k].outcome;
      const core::Outcome reference = result.episodes[0][k].outcome;
      const std::size_t i =
          static_cast<std::size_t>(result.unit.trial % clusters) * units_per_trial +
          (by_trial ? 0 : k);
      PairedCounts& unit = units[i];
      unit.stratum = by_trial ? 0 : result.unit.trial;
      ++unit.episodes;
      unit.completed += outcome == core::Outcome::kCompleted ? 1 : 0;
      unit.reference_completed += reference == core::Outcome::kCompleted ? 1 : 0;
      const bool collided = outcome == core::Outcome::kCollided;
      const bool reference_collided = reference == core::Outcome::kCollided;
      unit.collided += collided ? 1 : 0;
      unit.reference_collided += reference_collided ? 1 : 0;
      pairs[i].only_first += collided && !reference_collided ? 1 : 0;
      pairs[i].only_second += reference_collided && !collided ? 1 : 0;
    }
  }
  contrast.ratios = EstimateContrast(units);
  for (const DiscordantPairs& pair : pairs) {
    contrast.only_method_collided += pair.only_first;
    contrast.only_reference_collided += pair.only_second;
  }
  contrast.mcnemar_p = ClusteredMcNemar(pairs);
  return contrast;
}

void Check(const EvaluationPlan& plan, std::span<const UnitResult> results) {
  const std::size_t expected =
      static_cast<std::size_t>(plan.trials) * plan.demonstrations.size() * plan.learners.size();
  DFR_THROW_UNLESS(results.size() == expected,
                   "the plan has " << expected << " units, not " << results.size());
  for (const UnitResult& result : results) {
    bool complete = result.episodes.size() == plan.methods.size();
    for (const auto& episodes : result.episodes) {
      complete = complete && std::ssize(episodes) == plan.episodes;
    }
    DFR_THROW_UNLESS(complete && result.unit.trial >= 0 && result.unit.trial < plan.trials,
                     "the results of trial " << result.unit.trial << " with "
                                             << result.unit.demonstrations << " demonstrations, "
                                             << result.unit.learner << ", do not fit the plan");
  }
}

Json ToJson(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? Json(*value) : Json();
}

Json ToJson(const std::optional<Interval>& interval) {
  return interval ? Json::array({interval->low, interval->high}) : Json();
}

Json ToJson(const Cell& cell) {
  Json json = {{"method", cell.method}, {"learner", cell.learner}};
  json["demonstrations"] = cell.demonstrations > 0 ? Json(cell.demonstrations) : Json();
  json["trials"] = cell.trials;
  json["episodes"] = cell.episodes;
  const auto add = [&](const std::string& name, const Share& share) {
    json[name] = share.value;
    json[name + "_interval"] = {share.interval.low, share.interval.high};
  };
  add("completed", cell.completed);
  add("halted", cell.halted);
  add("collided", cell.collided);
  json["controls_per_trajectory"] = cell.controls_per_trajectory;
  json["recovery_controls"] = cell.recovery_controls;
  json["passed"] = ToJson(cell.passed);
  json["change"] = ToJson(cell.change);
  json["redrawn_starts"] = cell.redrawn_starts;
  json["halt_causes"] = cell.halt_causes;
  json["collision_causes"] = cell.collision_causes;
  return json;
}

Json ToJson(const Contrast& contrast) {
  return {{"method", contrast.method},
          {"against", contrast.against},
          {"learner", contrast.learner},
          {"collision_reduction", ToJson(contrast.ratios.collision_reduction)},
          {"interval", ToJson(contrast.ratios.collision_reduction_interval)},
          {"collision_reduction_interval", ToJson(contrast.ratios.collision_reduction_interval)},
          {"completion_ratio", ToJson(contrast.ratios.completion_ratio)},
          {"completion_ratio_interval", ToJson(contrast.ratios.completion_ratio_interval)},
          {"clusters", contrast.clusters},
          {"controls_ratio", ToJson(contrast.controls_ratio)},
          {"only_method_collided", contrast.only_method_collided},
          {"only_reference_collided", contrast.only_reference_collided},
          {"mcnemar_p", contrast.mcnemar_p}};
}

std::string Percent(const Share& share) {
  return core::Format("%5.1f [%5.1f,%5.1f]", 100.0 * share.value, 100.0 * share.interval.low,
                      100.0 * share.interval.high);
}

std::string Percent(const std::optional<double>& value, const std::optional<Interval>& interval,
                    bool sign) {
  if (!value) return "-";
  std::string text = core::Format(sign ? "%+.0f %%" : "%.0f %%", 100.0 * *value);
  if (interval)
    text += core::Format(" [%.0f, %.0f]", 100.0 * interval->low, 100.0 * interval->high);
  return text;
}

}  // namespace

Summary Summarize(const EvaluationPlan& plan, std::span<const UnitResult> results,
                  const SummaryOptions& options) {
  Check(plan, results);
  Summary summary;
  summary.experiment = options.experiment;
  summary.preset = options.preset;
  summary.commit = options.commit;
  summary.seed = plan.seed;
  for (const std::string& learner : plan.learners) {
    std::vector<double> seconds;
    std::vector<double> controls;
    for (std::size_t method = 0; method < plan.methods.size(); ++method) {
      const bool own = method > 0 && std::ranges::count(plan.policies, plan.methods[method]) > 0;
      const auto add = [&](std::vector<Cell>& cells, Cell cell) {
        if (own) cell.passed.reset();
        cells.push_back(std::move(cell));
      };
      Tally all;
      for (const int demonstrations : plan.demonstrations) {
        Tally tally;
        for (const UnitResult& result : results) {
          if (result.unit.learner != learner || result.unit.demonstrations != demonstrations) {
            continue;
          }
          tally.redrawn += result.redrawn;
          all.redrawn += result.redrawn;
          for (const EpisodeResult& episode : result.episodes[method]) {
            tally.Add(episode, result.unit.trial % NumClusters(plan));
            all.Add(episode, result.unit.trial % NumClusters(plan));
          }
        }
        DFR_THROW_UNLESS(
            tally.episodes == plan.trials * plan.episodes,
            "the results lack units with " << demonstrations << " demonstrations, " << learner);
        add(summary.cells,
            tally.ToCell(plan.methods[method], learner, demonstrations, plan.trials));
      }
      add(summary.averages, all.ToCell(plan.methods[method], learner, 0, plan.trials));
      const Cell& average = summary.averages.back();
      seconds.push_back(average.seconds_per_trajectory);
      controls.push_back(average.controls_per_trajectory);
      if (method == 0) continue;
      Contrast contrast = MakeContrast(plan, method, learner, results);
      contrast.seconds_ratio = Ratio(seconds.back(), seconds.front());
      contrast.controls_ratio = Ratio(controls.back(), controls.front());
      summary.contrasts.push_back(std::move(contrast));
    }
  }

  std::map<std::string, std::map<std::pair<std::string, int>, std::pair<double, int>>> measures;
  for (const UnitResult& result : results) {
    for (const auto& [name, value] : result.measures) {
      auto& [sum, count] = measures[name][{result.unit.learner, result.unit.demonstrations}];
      if (!std::isfinite(value)) continue;  // the unit does not define it
      sum += value;
      ++count;
    }
  }
  for (const auto& [name, by_unit] : measures) {
    for (const std::string& learner : plan.learners) {
      for (const int demonstrations : plan.demonstrations) {
        const auto found = by_unit.find({learner, demonstrations});
        if (found == by_unit.end()) continue;
        const auto [sum, count] = found->second;
        // NaN if no unit defines it.
        summary.measures.push_back({name, learner, demonstrations, sum / count});
      }
    }
  }
  return summary;
}

std::string ToJson(const Summary& summary) {
  Json json = {{"experiment", summary.experiment}, {"preset", summary.preset},
               {"commit", summary.commit},         {"seed", summary.seed},
               {"cells", Json::array()},           {"averages", Json::array()},
               {"contrasts", Json::array()},       {"measures", Json::array()}};
  for (const Cell& cell : summary.cells) json["cells"].push_back(ToJson(cell));
  for (const Cell& cell : summary.averages) json["averages"].push_back(ToJson(cell));
  for (const Contrast& contrast : summary.contrasts) json["contrasts"].push_back(ToJson(contrast));
  for (const MeasureMean& measure : summary.measures) {
    json["measures"].push_back({{"name", measure.name},
                                {"learner", measure.learner},
                                {"demonstrations", measure.demonstrations},
                                {"mean", ToJson(std::optional<double>(measure.mean))}});
  }
  return json.dump(1) + "\n";
}

void SaveSummary(const Summary& summary, const std::filesystem::path& path) {
  core::ReplaceFile(path, ToJson(summary));
}

void SaveTimes(const Summary& summary, const std::filesystem::path& path) {
  Json json = {{"cells", Json::array()}, {"averages", Json::array()}, {"contrasts", Json::array()}};
  const auto add = [&](const char* list, const std::vector<Cell>& cells) {
    for (const Cell& cell : cells) {
      json[list].push_back(
          {{"method", cell.method},
           {"learner", cell.learner},
           {"demonstrations", cell.demonstrations > 0 ? Json(cell.demonstrations) : Json()},
           {"seconds_per_trajectory", ToJson(cell.seconds_per_trajectory)}});
    }
  };
  add("cells", summary.cells);
  add("averages", summary.averages);
  for (const Contrast& contrast : summary.contrasts) {
    json["contrasts"].push_back({{"method", contrast.method},
                                 {"against", contrast.against},
                                 {"learner", contrast.learner},
                                 {"seconds_ratio", ToJson(contrast.seconds_ratio)}});
  }
  core::ReplaceFile(path, json.dump(1) + "\n");
}

void PrintTable(const Summary& summary, std::ostream& out) {
  std::size_t width = 6;
  for (const Cell& cell : summary.averages) width = std::max(width, cell.method.size());
  const int name_width = static_cast<int>(width);
  const char* const heads = "  %-*s  %19s  %19s  %19s  %9s  %8s  %8s  %6s";
  std::string learner;
  for (const Cell& average : summary.averages) {
    if (average.learner != learner) {
      learner = average.learner;
      const double drawn = average.episodes + average.redrawn_starts;
      out << "\nlearner " << learner << ": all data points, " << average.episodes
          << " episodes per method in " << average.trials << " trials, %"
          << (average.trials < kFewTrials ? " (too few to cluster by: intervals treat episodes as "
                                            "independent)"
                                          : "")
          << core::Format("; %.1f %% of the start states drawn were outside and drawn again\n",
                          100.0 * average.redrawn_starts / drawn)
          << core::Format(heads, name_width, "method", "completed", "halted", "collided",
                          "ms/traj.", "controls", "passed %", "change")
          << "\n";
    }
    out << core::Format(
               "  %-*s  %s  %s  %s  %9.3f  %8.1f  %8s  %6s", name_width, average.method.c_str(),
               Percent(average.completed).c_str(), Percent(average.halted).c_str(),
               Percent(average.collided).c_str(), 1e3 * average.seconds_per_trajectory,
               average.controls_per_trajectory,
               average.passed ? core::Format("%.1f", 100.0 * *average.passed).c_str() : "-",
               average.change ? core::Format("%.2f", *average.change).c_str() : "-")
        << "\n";
    for (const Contrast& contrast : summary.contrasts) {
      if (contrast.learner != learner || contrast.method != average.method) continue;
      std::optional<double> change;
      std::optional<Interval> change_interval;
      if (contrast.ratios.collision_reduction) change = -*contrast.ratios.collision_reduction;
      if (const auto& interval = contrast.ratios.collision_reduction_interval) {
        change_interval = Interval{-interval->high, -interval->low};
      }
      out << core::Format("  %-*s  against %s: ", name_width, "", contrast.against.c_str())
          << "completions "
          << Percent(contrast.ratios.completion_ratio, contrast.ratios.completion_ratio_interval,
                     false)
          << ", collisions " << Percent(change, change_interval, true);
      if (contrast.seconds_ratio) out << core::Format(", time x%.2f", *contrast.seconds_ratio);
      out << "\n";
    }
  }
  // One row per data point, one column per method. Only summary.json contains the intervals.
  std::vector<std::string> methods;
  for (const Cell& cell : summary.averages) {
    if (std::find(methods.begin(), methods.end(), cell.method) == methods.end()) {
      methods.push_back(cell.method);
    }
  }
  learner.clear();
  for (const Cell& average : summary.averages) {
    if (average.learner == learner) continue;
    learner = average.learner;
    std::map<int, std::vector<const Cell*>> by_demonstrations;
    for (const Cell& cell : summary.cells) {
      if (cell.learner == learner) by_demonstrations[cell.demonstrations].push_back(&cell);
    }
    out << "\nlearner " << learner << ": completed / halted / collided, %\n  demos";
    for (const std::string& method : methods) out << core::Format("  %20s", method.c_str());
    out << "\n";
    for (const auto& [demonstrations, cells] : by_demonstrations) {
      out << core::Format("  %5d", demonstrations);
      for (const Cell* cell : cells) {
        out << core::Format("   %5.1f /%5.1f /%5.1f", 100.0 * cell->completed.value,
                            100.0 * cell->halted.value, 100.0 * cell->collided.value);
      }
      out << "\n";
    }
  }
}

}  // namespace dfr::experiment
