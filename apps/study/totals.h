#pragma once

#include <algorithm>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "apps/study/study.h"
#include "dfr/experiment/intervals.h"

namespace dfr::study {

/// Returns a share in per cent.
[[nodiscard]] inline double Share(int count, int of) { return 100.0 * count / of; }

/// Returns the distinct values of a member of the rows, in their order.
template <typename Member>
[[nodiscard]] std::vector<std::string> Distinct(const std::vector<Row>& rows, Member member) {
  std::vector<std::string> values;
  for (const Row& row : rows) {
    if (std::ranges::count(values, row.*member) == 0) values.push_back(row.*member);
  }
  return values;
}

/// Returns true for a row whose method is another policy, not a guard of the row's policy.
[[nodiscard]] bool IsOtherPolicy(const Row& row);

/// Sums of the rows of one method around one policy, in independent clusters: tasks if there are at
/// least 5, otherwise the trials of each task. With fewer than 3 clusters episodes count as
/// independent.
class Totals {
 public:
  explicit Totals(const Row& row) : Totals(std::span(&row, 1)) {}
  explicit Totals(std::span<const Row> rows);

  [[nodiscard]] int episodes() const noexcept { return all_.episodes; }
  [[nodiscard]] const TrialCounts& counts() const noexcept { return all_; }
  /// Kind of clusters: "task", "trial" or "episode".
  [[nodiscard]] const char* clusters() const noexcept;

  /// 95 % interval of the ratio of the episodes counted by `count` to the episodes counted by `of`.
  /// @pre `of` counts at least one episode.
  [[nodiscard]] experiment::Interval IntervalOf(
      int TrialCounts::*count, int TrialCounts::*of = &TrialCounts::episodes) const;
  /// Share of the controls that equal the policy's bit for bit, averaged over rows and trials with
  /// equal weights. Absent if there were no controls, or if the method is another policy.
  [[nodiscard]] std::optional<double> passed() const noexcept;
  /// Interval of passed() by RatioInterval() over the clusters; absent if the clusters are
  /// episodes.
  [[nodiscard]] std::optional<experiment::Interval> PassedInterval() const;
  /// Mean size of a change; absent if no size is known.
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
