#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <tuple>
#include <vector>

#include "dfr/core/features/feature_transform.h"
#include "dfr/core/trajectory.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/rollout_runner.h"
#include "dfr/safety/task_model.h"
#include "dfr/study/placebo.h"

namespace dfr::study {

/// A RolloutRunner whose methods may be placebos. Before its first episode, a placebo takes its
/// rate from the method kJudged around the same policy in all episodes of the unit. These episodes
/// run only once: they are also the results of that method.
class PlaceboRunner : public experiment::RolloutRunner {
 public:
  /// Sets the unit whose episodes determine the rates of placebos. Without this call, placebos are
  /// rejected.
  void JudgeIn(const experiment::EvaluationPlan& plan, const experiment::EvaluationUnit& unit) {
    plan_ = plan;
    unit_ = unit;
  }
  [[nodiscard]] experiment::EpisodeResult Run(int method, std::uint64_t start_seed,
                                              std::uint64_t controller_seed) override;

 protected:
  using RolloutRunner::RolloutRunner;
  /// Creates the controller of a method that is not a placebo.
  using Maker = std::function<std::unique_ptr<control::Controller>(const std::string&)>;
  /// Adds the controllers of `methods`. A placebo wraps the method "baseline" around the same
  /// policy: the policy alone. Its corrections are computed by locally weighted regression on the
  /// demonstrations. Borrows the task.
  /// @throws std::invalid_argument as CheckPlacebos() does.
  void AddAll(const std::vector<std::string>& methods, const Maker& make, const FittedTask& task,
              std::span<const core::Trajectory> demonstrations);

  /// Overrides must call this function.
  void Begin(int method, std::uint64_t start_seed) override;
  /// Returns "placebo" if a placebo's correction collided.
  [[nodiscard]] std::string CauseOf(const control::RolloutResult& result) const override;

 private:
  // Returns the fraction of the controls that the judged method changed.
  [[nodiscard]] double RateOf(int judged);

  struct Compared {
    Placebo* placebo = nullptr;  // null: the method is not a placebo
    int judged = 0;              // index of the judged method
    bool has_rate = false;
  };
  std::vector<Compared> compared_;  // [method]
  std::set<int> judged_;            // indices of the judged methods
  experiment::EvaluationPlan plan_ = {};
  std::optional<experiment::EvaluationUnit> unit_ = {};
  int running_ = 0;  // index of the method
  std::map<std::tuple<int, std::uint64_t, std::uint64_t>, experiment::EpisodeResult>
      known_;  // episodes of the judged methods
};

}  // namespace dfr::study
