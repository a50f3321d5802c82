#pragma once

#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "dfr/control/guided/jacobian_prior.h"
#include "dfr/core/archive.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// Options for GuidedModel.
struct GuidedModelOptions {
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
  /// to the side must not stop the rest. SlackFrom() has it from demonstrations.
  double slack = 0.2;
  JacobianOptions jacobian = {};
};

/// The slack that unseen demonstrations need: the supervisor's own states are as far outside an
/// estimate that has not seen them, the further the fewer demonstrations there are. The
/// 0.2-quantile of -l, and no less than GuidedModelOptions' default.
/// @param held_out_levels  l of demonstrated states under supports fitted without them.
/// @throws std::invalid_argument if there are none.
[[nodiscard]] double SlackFrom(std::vector<double> held_out_levels);

/// What guided recovery knows from the demonstrations: how deep inside the support they were, how
/// large their controls, how features answered them. Immutable; controllers share it.
class GuidedModel {
 public:
  /// `support` is one of features z = features(x). Borrows it; it must outlive this.
  /// @throws std::invalid_argument if shapes do not fit, no demonstrated control differs from zero,
  ///   or an option is out of range.
  GuidedModel(core::FeatureTransform features, const core::LogDecisionFunction& support,
              std::span<const core::Trajectory> demonstrations,
              const GuidedModelOptions& options = {});

  /// Appends to a file what is learned from demonstrations, without features and support.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and what is wrong with it,
  ///   for one that does not fit features and support.
  static GuidedModel Load(core::ArchiveReader& archive, core::FeatureTransform features,
                          const core::LogDecisionFunction& support);

  [[nodiscard]] const core::FeatureTransform& features() const noexcept { return features_; }
  [[nodiscard]] const core::LogDecisionFunction& support() const noexcept { return *support_; }
  [[nodiscard]] int control_dim() const noexcept { return prior_->control_dim(); }
  [[nodiscard]] const std::shared_ptr<const JacobianPrior>& prior() const noexcept {
    return prior_;
  }

  /// hi_t, the level of l_t at which there is nothing to do, >= 0.
  [[nodiscard]] double gate_level(int t) const noexcept { return Clamped(gate_, t); }
  /// lo_t <= hi_t, the level of l_t from which on the learned control may pass, >= 0.
  [[nodiscard]] double pass_level(int t) const noexcept { return Clamped(pass_, t); }
  /// The level of l_t below which a state is at the edge of the support, >= 0.
  [[nodiscard]] double edge_level(int t) const noexcept { return Clamped(edge_, t); }
  /// The median of l_t over demonstrated states, >= 0.
  [[nodiscard]] double median_level(int t) const noexcept { return Clamped(median_, t); }
  /// GuidedModelOptions::slack
  [[nodiscard]] double slack() const noexcept { return slack_; }
  /// us, the root mean square of |u|: the unit of v = u / us.
  [[nodiscard]] double control_unit() const noexcept { return control_unit_; }
  /// Whether features move by themselves: what they do explains, of demonstrations that an estimate
  /// has not seen, at least 40 % of what controls leave unexplained. Where it explains less, the
  /// estimate is better without.
  [[nodiscard]] bool own_motion() const noexcept { return own_motion_; }
  /// Largest demonstrated |v|.
  [[nodiscard]] double largest_control() const noexcept { return largest_; }

 private:
  GuidedModel(core::FeatureTransform features, const core::LogDecisionFunction& support)
      : features_(std::move(features)), support_(&support) {}
  static double Clamped(const std::vector<double>& values, int t) noexcept;

  core::FeatureTransform features_;
  const core::LogDecisionFunction* support_;
  std::shared_ptr<const JacobianPrior> prior_;
  std::vector<double> gate_;
  std::vector<double> pass_;
  std::vector<double> edge_;
  std::vector<double> median_;
  double largest_ = 0.0;
  double slack_ = 0.0;
  double control_unit_ = 1.0;
  bool own_motion_ = false;
};

/// @throws std::invalid_argument if the sizes of a policy are not those of the model, or there are
///   more than kMaxStepEntries features or control entries.
void CheckFits(const core::Policy& policy, const GuidedModel& model);

}  // namespace dfr::control
