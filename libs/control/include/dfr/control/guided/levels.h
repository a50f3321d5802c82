#pragma once

#include <span>
#include <vector>

#include "dfr/control/constants.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Options for Levels.
struct LevelOptions {
  /// Quantile of l_t over demonstrated states at which the learned control passes, and towards
  /// which other controls are raised. A higher quantile keeps the state deeper inside, and the
  /// learned policy decides less often.
  double gate_quantile = 0.75;
  /// With least intervention, the learned control passes unchanged from this quantile on, if l >=
  /// 0. A higher quantile corrects earlier: weak policies fail less, and more controls of a good
  /// policy are changed (docs/recovery.md has the curve).
  double pass_quantile = 0.05;
  /// States below this quantile are at the edge of the support. A policy that stays there longer
  /// than demonstrations do must end deeper inside (Levels::edge_stay()).
  double edge_quantile = 0.25;
  /// States of the task may be outside the support down to l = -slack: for example, a displaced
  /// object must not stop the rest of the task. EstimateSlack() estimates the slack from
  /// demonstrations.
  double slack = 0.2;
};

/// Estimates the slack: the distance of the supervisor's states from a support fitted without them,
/// which is larger with fewer demonstrations. Returns minus the 0.2-quantile of l, at least the
/// default of LevelOptions.
/// @param held_out_levels  l of demonstrated states under supports fitted without them.
/// @throws std::invalid_argument if there are none.
[[nodiscard]] double EstimateSlack(std::vector<double> held_out_levels);

/// Number of steps at the edge of the support, with forgetting factor guided::kEdgeMemory.
class EdgeStay {
 public:
  void Reset() noexcept { steps_ = 0.0; }
  /// Records a step.
  void Add(bool at_edge) noexcept;
  [[nodiscard]] double steps() const noexcept { return steps_; }

 private:
  double steps_ = 0.0;
};

/// Levels of one demonstration under a support that was fitted without it.
struct HeldOutLevels {
  std::vector<double> levels;  ///< l of each state.
  std::vector<int> phases;     ///< Phase at which each level was evaluated.
};

/// Levels of l_t that demonstrations keep at each time step, the slack, the pass depth, and the
/// stay at the edge. Concurrent const calls are safe.
class Levels {
 public:
  /// @param points  features of demonstrated states, one matrix per demonstration.
  /// @throws std::invalid_argument if there are none, their widths differ from the support's
  /// state_dim(), or an option is out of range.
  Levels(const core::LogDecisionFunction& support, std::span<const core::Matrix> points,
         const LevelOptions& options = {});

  /// Sets edge_stay() to the 0.9-quantile of the longest stays of `held_out` at the edge, at least
  /// guided::kLeastEdgeStay, and pass_depth() to minus the quantile guided::kPassDepthQuantile of
  /// all levels, at least 0. @throws std::invalid_argument if there are none.
  void SetHeldOut(std::span<const HeldOutLevels> held_out);
  /// Sets prediction_error() to the quantile guided::kPredictionQuantile of `errors`, the absolute
  /// differences of l at predicted and at observed states of held-out demonstrations. The result
  /// is 0 if there are none. @throws std::invalid_argument if an error is negative or NaN.
  void SetPredictionErrors(std::span<const double> errors);

  /// Appends this object to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static Levels Load(core::ArchiveReader& archive);

  /// Returns hi_t >= 0: at this level of l_t, no correction is needed. Times out of range use the
  /// nearest time step.
  [[nodiscard]] double gate(int t) const noexcept { return Clamped(gate_, t); }
  /// Returns lo_t in [0, hi_t]: from this level of l_t on, the learned control may pass.
  [[nodiscard]] double pass(int t) const noexcept { return Clamped(pass_, t); }
  /// Returns the level of l_t below which a state is at the edge of the support, >= 0.
  [[nodiscard]] double edge(int t) const noexcept { return Clamped(edge_, t); }
  /// Returns the value of EdgeStay::steps() at which the level for passing a learned control starts
  /// to rise from pass() to gate(). It reaches gate() after guided::kEdgeRamp further steps. Equals
  /// guided::kLeastEdgeStay before SetHeldOut().
  [[nodiscard]] double edge_stay() const noexcept { return edge_stay_; }
  /// Returns the median of l_t over demonstrated states, >= 0.
  [[nodiscard]] double median(int t) const noexcept { return Clamped(median_, t); }
  /// Returns the depth >= 0 below pass() down to which the learned control passes in a world at
  /// rest: 5 % of the supervisor's states lie at least that far outside a support fitted without
  /// them. Equals 0 before SetHeldOut().
  [[nodiscard]] double pass_depth() const noexcept { return pass_depth_; }
  /// Returns the error of l at predicted states that 95 % of the predictions keep. A smaller
  /// distance from a level does not show on which side of it a control ends. Equals 0 before
  /// SetPredictionErrors().
  [[nodiscard]] double prediction_error() const noexcept { return prediction_error_; }
  /// Returns LevelOptions::slack.
  [[nodiscard]] double slack() const noexcept { return slack_; }

 private:
  Levels() = default;
  static double Clamped(const std::vector<double>& values, int t) noexcept;

  std::vector<double> gate_;
  std::vector<double> pass_;
  std::vector<double> edge_;
  std::vector<double> median_;
  double slack_ = 0.0;
  double pass_depth_ = 0.0;
  double prediction_error_ = 0.0;
  double edge_stay_ = guided::kLeastEdgeStay;
};

}  // namespace dfr::control
