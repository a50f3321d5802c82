#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "apps/study/study.h"
#include "dfr/experiment/intervals.h"

namespace dfr::study {

/// Rows of one method around one policy added up, in clusters that are independent of each other:
/// tasks where there are at least 5, else the trials of each task. With fewer than 3 clusters
/// episodes count as independent.
class Totals {
 public:
  explicit Totals(const Row& row) : Totals(std::span(&row, 1)) {}
  explicit Totals(std::span<const Row> rows);

  [[nodiscard]] int episodes() const noexcept { return all_.episodes; }
  [[nodiscard]] const TrialCounts& counts() const noexcept { return all_; }
  /// "task", "trial" or "episode".
  [[nodiscard]] const char* clusters() const noexcept;

  /// 95 % interval of the share of the episodes that `count` counts.
  [[nodiscard]] experiment::Interval IntervalOf(int TrialCounts::*count) const;
  /// Share of the controls that are the policy's to the bit, a mean over rows and trials: long
  /// episodes count no more than short ones. Absent without a control.
  [[nodiscard]] std::optional<double> passed() const noexcept;
  /// Its interval, RatioInterval() over the clusters; absent where those are episodes.
  [[nodiscard]] std::optional<experiment::Interval> PassedInterval() const;
  /// Mean size of a change. Absent where none is known.
  [[nodiscard]] std::optional<double> change() const noexcept;

 private:
  bool by_task_ = false;
  TrialCounts all_;
  std::vector<TrialCounts> clusters_;
  std::vector<experiment::RatioPart> passed_;  // [cluster]
  double change_ = 0.0;
  int sized_changes_ = 0;
};

}  // namespace dfr::study
