#pragma once

#include <span>
#include <vector>

#include "dfr/core/archive.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Options for Levels.
struct LevelOptions {
  /// A quantile of l_t over demonstrated states: where the learned control passes, and what others
  /// aim at. Higher keeps deeper inside and lets the learned policy decide less often.
  double gate_quantile = 0.75;
  /// The same where the policy drives: the learned control passes as it is from this quantile on,
  /// or from l = 0. Higher corrects earlier: fewer failures of weak policies, more of a good one's
  /// controls changed (docs/recovery.md has the curve).
  double pass_quantile = 0.05;
  /// States below this quantile are at the edge of the support. A policy that stays there has to
  /// end deeper inside (guided::kEdgeGrace).
  double edge_quantile = 0.25;
  /// How far outside the support states of the task still are, l = -slack: an object that is off
  /// to the side must not stop the rest. EstimateSlack() has it from demonstrations.
  double slack = 0.2;
};

/// The slack that unseen demonstrations need: the supervisor's own states are as far outside an
/// estimate that has not seen them, the further the fewer demonstrations there are. The
/// 0.2-quantile of -l, and no less than LevelOptions' default.
/// @param held_out_levels  l of demonstrated states under supports fitted without them.
/// @throws std::invalid_argument if there are none.
[[nodiscard]] double EstimateSlack(std::vector<double> held_out_levels);

/// How deep inside the support demonstrations were at each time step, and how far outside the task
/// may go. A value; immutable.
class Levels {
 public:
  /// @param points  features of demonstrated states, one matrix a demonstration.
  /// @throws std::invalid_argument if there are none, their widths are not the support's
  ///   state_dim(), or an option is out of range.
  Levels(const core::LogDecisionFunction& support, std::span<const core::Matrix> points,
         const LevelOptions& options = {});

  /// Appends all of it to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and what is wrong with it.
  static Levels Load(core::ArchiveReader& archive);

  /// hi_t, the level of l_t at which there is nothing to do, >= 0. Times out of range use the
  /// nearest one.
  [[nodiscard]] double gate(int t) const noexcept { return Clamped(gate_, t); }
  /// lo_t <= hi_t, the level of l_t from which on the learned control may pass, >= 0.
  [[nodiscard]] double pass(int t) const noexcept { return Clamped(pass_, t); }
  /// The level of l_t below which a state is at the edge of the support, >= 0.
  [[nodiscard]] double edge(int t) const noexcept { return Clamped(edge_, t); }
  /// The median of l_t over demonstrated states, >= 0.
  [[nodiscard]] double median(int t) const noexcept { return Clamped(median_, t); }
  /// LevelOptions::slack
  [[nodiscard]] double slack() const noexcept { return slack_; }

 private:
  Levels() = default;
  static double Clamped(const std::vector<double>& values, int t) noexcept;

  std::vector<double> gate_;
  std::vector<double> pass_;
  std::vector<double> edge_;
  std::vector<double> median_;
  double slack_ = 0.0;
};

}  // namespace dfr::control
