#include "dfr/control/guided/guided_model.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "dfr/control/guided/constants.h"
#include "dfr/control/guided/jacobian_estimate.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

double Quantile(std::vector<double>& values, double q) {
  std::sort(values.begin(), values.end());
  const double position = q * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(position);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return values[below] + (position - static_cast<double>(below)) * (values[above] - values[below]);
}

// The share of what controls alone leave unexplained, in demonstrations that were left out, that
// remains with an own motion.
double WithOwnMotion(std::span<const core::Matrix> points, std::span<const core::Matrix> controls,
                     const JacobianOptions& options) {
  constexpr Eigen::Index kEnough = 2000;  // Transitions, of each half.
  Eigen::Index transitions = 0;
  for (const core::Matrix& c : controls) transitions += c.rows();
  const Eigen::Index stride = 1 + transitions / (2 * kEnough);
  double alone = 0.0;
  double together = 0.0;
  Eigen::VectorXd there(points[0].cols());
  for (const std::size_t half : {0U, 1U}) {
    std::vector<core::Matrix> shown_points;
    std::vector<core::Matrix> shown_controls;
    for (std::size_t d = half; d < points.size(); d += 2) {
      shown_points.push_back(points[d]);
      shown_controls.push_back(controls[d]);
    }
    const auto prior = std::make_shared<const JacobianPrior>(shown_points, shown_controls, options);
    JacobianEstimate without(prior, {}, /*own_motion=*/false);
    JacobianEstimate with(prior);
    for (std::size_t d = 1 - half; d < points.size(); d += 2) {
      for (Eigen::Index t = 0; t < controls[d].rows(); t += stride) {
        const Eigen::VectorXd v = controls[d].row(t);
        for (auto [estimate, error] : {std::pair{&without, &alone}, std::pair{&with, &together}}) {
          estimate->Compute(static_cast<int>(t), core::Row(points[d], t));
          there = points[d].row(t);
          estimate->AddEffect(v, there);
          *error += (points[d].row(t + 1).transpose() - there).squaredNorm();
        }
      }
    }
  }
  return alone > 0.0 ? together / alone : 1.0;
}

}  // namespace

double SlackFrom(std::vector<double> held_out_levels) {
  DFR_THROW_UNLESS(!held_out_levels.empty(), "there are no levels of unseen demonstrations");
  return std::max(GuidedModelOptions().slack, -Quantile(held_out_levels, guided::kSlackQuantile));
}

GuidedModel::GuidedModel(core::FeatureTransform features, const core::LogDecisionFunction& support,
                         std::span<const core::Trajectory> demonstrations,
                         const GuidedModelOptions& options)
    : features_(std::move(features)), support_(&support), slack_(options.slack) {
  DFR_THROW_UNLESS(features_.num_features() == support.state_dim(),
                   "there are " << features_.num_features() << " features, the support takes "
                                << support.state_dim());
  DFR_THROW_UNLESS(options.gate_quantile >= 0.0 && options.gate_quantile <= 1.0,
                   "gate_quantile must lie in [0, 1], not be " << options.gate_quantile);
  DFR_THROW_UNLESS(
      options.pass_quantile >= 0.0 && options.pass_quantile <= options.gate_quantile,
      "pass_quantile must lie in [0, gate_quantile], not be " << options.pass_quantile);
  DFR_THROW_UNLESS(options.slack >= 0.0, "slack must not be negative: " << options.slack);
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");

  std::vector<core::Matrix> points;
  std::vector<core::Matrix> controls;
  double square = 0.0;
  int moving = 0;
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const core::Trajectory& demonstration = demonstrations[d];
    DFR_THROW_UNLESS(demonstration.states.rows() == demonstration.controls.rows() + 1,
                     "demonstration " << d << " has " << demonstration.states.rows()
                                      << " states and " << demonstration.controls.rows()
                                      << " controls");
    DFR_THROW_UNLESS(demonstration.states.allFinite() && demonstration.controls.allFinite(),
                     "demonstration " << d << " has a non-finite entry");
    points.push_back(features_.Apply(demonstration.states));
    controls.push_back(demonstration.controls);
    for (Eigen::Index t = 0; t < controls.back().rows(); ++t) {
      const double norm = controls.back().row(t).squaredNorm();
      square += norm;
      moving += norm > 0.0 ? 1 : 0;
      largest_ = std::max(largest_, std::sqrt(norm));
    }
  }
  DFR_THROW_UNLESS(moving > 0, "no demonstrated control differs from zero");
  control_unit_ = std::sqrt(square / moving);
  largest_ /= control_unit_;
  for (core::Matrix& c : controls) c /= control_unit_;
  prior_ = std::make_shared<const JacobianPrior>(points, controls, options.jacobian);
  own_motion_ =
      points.size() >= 2 && WithOwnMotion(points, controls, options.jacobian) <= guided::kMostLeft;

  std::vector<double> levels;
  for (int t = 0; t < support.num_steps(); ++t) {
    levels.clear();
    for (const core::Matrix& z : points) {
      if (t < z.rows()) levels.push_back(support.LogDecision(t, core::Row(z, t), {}));
    }
    // A support may have more time steps than any demonstration has states.
    if (levels.empty()) break;
    gate_.push_back(std::max(0.0, Quantile(levels, options.gate_quantile)));
    pass_.push_back(std::max(0.0, Quantile(levels, options.pass_quantile)));
    edge_.push_back(std::max(0.0, Quantile(levels, options.edge_quantile)));
    median_.push_back(std::max(0.0, Quantile(levels, 0.5)));
  }
}

void GuidedModel::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(gate_);
  archive.Numbers(pass_);
  archive.Numbers(edge_);
  archive.Numbers(median_);
  archive.Number(largest_);
  archive.Number(slack_);
  archive.Number(control_unit_);
  archive.Integer(own_motion_ ? 1 : 0);
  prior_->Save(archive);
}

GuidedModel GuidedModel::Load(core::ArchiveReader& archive, core::FeatureTransform features,
                              const core::LogDecisionFunction& support) {
  GuidedModel model(std::move(features), support);
  const auto levels = [&](const char* what) {
    std::vector<double> values = archive.Numbers();
    if (values.empty() || !std::all_of(values.begin(), values.end(),
                                       [](double v) { return v >= 0.0 && std::isfinite(v); })) {
      archive.Fail(std::string(what) + " must be finite and not negative, one a time step");
    }
    return values;
  };
  model.gate_ = levels("gate levels");
  model.pass_ = levels("pass levels");
  model.edge_ = levels("edge levels");
  model.median_ = levels("median levels");
  model.largest_ = archive.Number();
  if (!(model.largest_ >= 0.0 && std::isfinite(model.largest_))) {
    archive.Fail("the largest control must be finite and not negative");
  }
  model.slack_ = archive.Number();
  model.control_unit_ = archive.Number();
  model.own_motion_ = archive.IntegerIn(0, 1) == 1;
  if (!(model.slack_ >= 0.0 && std::isfinite(model.slack_) && model.control_unit_ > 0.0 &&
        std::isfinite(model.control_unit_))) {
    archive.Fail("slack and the unit of controls must be finite, and the unit positive");
  }
  model.prior_ = std::make_shared<const JacobianPrior>(JacobianPrior::Load(archive));
  if (model.prior_->feature_dim() != model.features_.num_features()) {
    archive.Fail("the Jacobian prior is one of " + std::to_string(model.prior_->feature_dim()) +
                 " features, there are " + std::to_string(model.features_.num_features()));
  }
  return model;
}

void CheckFits(const core::Policy& policy, const GuidedModel& model) {
  DFR_THROW_UNLESS(policy.state_dim() == model.features().state_dim(),
                   "the policy takes states of " << policy.state_dim() << " entries, the features "
                                                 << model.features().state_dim());
  DFR_THROW_UNLESS(policy.control_dim() == model.control_dim(),
                   "the policy gives " << policy.control_dim()
                                       << " control entries, demonstrations "
                                       << model.control_dim());
  DFR_THROW_UNLESS(
      std::max(model.features().num_features(), model.control_dim()) <= kMaxStepEntries,
      "guided recovery takes at most " << kMaxStepEntries << " features and control entries");
}

double GuidedModel::Clamped(const std::vector<double>& values, int t) noexcept {
  return values[static_cast<std::size_t>(std::clamp(t, 0, static_cast<int>(values.size()) - 1))];
}

}  // namespace dfr::control
