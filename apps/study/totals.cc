#include "apps/study/totals.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <set>
#include <utility>

#include "apps/study/runner.h"
#include "dfr/study/controller_factory.h"

namespace dfr::study {
namespace {

constexpr std::size_t kFewTasks = 5;
constexpr std::size_t kFewClusters = 3;

// A row without trials counts as one trial.
std::vector<TrialCounts> TrialsOf(const Row& row) {
  if (!row.trials.empty()) return row.trials;
  return {static_cast<const TrialCounts&>(row)};
}

}  // namespace

TrialCounts& TrialCounts::operator+=(const TrialCounts& other) noexcept {
  episodes += other.episodes;
  completed += other.completed;
  collided += other.collided;
  halted += other.halted;
  saved += other.saved;
  harmed += other.harmed;
  intervened += other.intervened;
  intervened_completed += other.intervened_completed;
  left_alone += other.left_alone;
  left_alone_completed += other.left_alone_completed;
  controls += other.controls;
  changed += other.changed;
  alarmed_failures += other.alarmed_failures;
  alarmed_successes += other.alarmed_successes;
  return *this;
}

bool IsOtherPolicy(const Row& row) { return row.controller != kAlone && IsPolicy(row.controller); }

Totals::Totals(std::span<const Row> rows) {
  std::set<std::string> tasks;
  for (const Row& row : rows) tasks.insert(row.task);
  by_task_ = tasks.size() >= kFewTasks;
  std::map<std::pair<std::string, std::size_t>, std::size_t> places;
  for (const Row& row : rows) {
    const std::vector<TrialCounts> trials = TrialsOf(row);
    for (std::size_t t = 0; t < trials.size(); ++t) {
      const auto [place, is_new] =
          places.try_emplace({row.task, by_task_ ? 0 : t}, clusters_.size());
      if (is_new) {
        clusters_.emplace_back();
        passed_.emplace_back();
      }
      const TrialCounts& trial = trials[t];
      all_ += trial;
      clusters_[place->second] += trial;
      if (trial.controls == 0.0 || IsOtherPolicy(row)) continue;
      passed_[place->second].numerator += 1.0 - trial.changed / trial.controls;
      passed_[place->second].denominator += 1.0;
    }
    change_ += row.change;
    sized_changes_ += row.sized_changes;
  }
}

const char* Totals::clusters() const noexcept {
  if (clusters_.size() < kFewClusters) return "episode";
  return by_task_ ? "task" : "trial";
}

experiment::Interval Totals::IntervalOf(int TrialCounts::*count, int TrialCounts::*of) const {
  if (clusters_.size() < kFewClusters) return experiment::ProportionInterval(all_.*count, all_.*of);
  std::vector<experiment::ClusterCount> counts;
  for (const TrialCounts& cluster : clusters_) {
    counts.push_back({.successes = cluster.*count, .episodes = cluster.*of});
  }
  return experiment::ClusteredInterval(counts);
}

std::optional<double> Totals::passed() const noexcept {
  double shares = 0.0;
  double weight = 0.0;
  for (const experiment::RatioPart& part : passed_) {
    shares += part.numerator;
    weight += part.denominator;
  }
  if (weight == 0.0) return std::nullopt;
  return shares / weight;
}

std::optional<experiment::Interval> Totals::PassedInterval() const {
  if (clusters_.size() < kFewClusters) return std::nullopt;
  auto interval = experiment::RatioInterval(passed_);
  if (interval) interval->high = std::min(interval->high, 1.0);
  return interval;
}

std::optional<double> Totals::change() const noexcept {
  if (sized_changes_ == 0) return std::nullopt;
  return change_ / sized_changes_;
}

}  // namespace dfr::study
