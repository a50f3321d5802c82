#include "dfr/control/guided/levels.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "dfr/control/constants.h"
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

std::vector<double> Read(core::ArchiveReader& archive, const char* what) {
  std::vector<double> values = archive.Numbers();
  if (values.empty() || !std::all_of(values.begin(), values.end(),
                                     [](double v) { return v >= 0.0 && std::isfinite(v); })) {
    archive.Fail(std::string(what) + " must be finite and not negative, one per time step");
  }
  return values;
}

}  // namespace

double EstimateSlack(std::vector<double> held_out_levels) {
  DFR_THROW_UNLESS(!held_out_levels.empty(), "there are no levels of held-out demonstrations");
  return std::max(LevelOptions().slack, -Quantile(held_out_levels, guided::kSlackQuantile));
}

void EdgeStay::Add(bool at_edge) noexcept {
  steps_ = guided::kEdgeMemory * steps_ + (at_edge ? 1.0 : 0.0);
}

Levels::Levels(const core::LogDecisionFunction& support, std::span<const core::Matrix> points,
               const LevelOptions& options)
    : slack_(options.slack) {
  DFR_THROW_UNLESS(options.gate_quantile >= 0.0 && options.gate_quantile <= 1.0,
                   "gate_quantile must lie in [0, 1], not " << options.gate_quantile);
  DFR_THROW_UNLESS(options.pass_quantile >= 0.0 && options.pass_quantile <= options.gate_quantile,
                   "pass_quantile must lie in [0, gate_quantile], not " << options.pass_quantile);
  DFR_THROW_UNLESS(options.edge_quantile >= 0.0 && options.edge_quantile <= 1.0,
                   "edge_quantile must lie in [0, 1], not " << options.edge_quantile);
  DFR_THROW_UNLESS(options.slack >= 0.0 && std::isfinite(options.slack),
                   "slack must be finite and not negative: " << options.slack);
  DFR_THROW_UNLESS(!points.empty(), "there are no demonstrations");
  for (const core::Matrix& z : points) {
    DFR_THROW_UNLESS(
        z.cols() == support.state_dim(),
        "there are " << z.cols() << " features, but the support takes " << support.state_dim());
  }
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

void Levels::SetHeldOut(std::span<const HeldOutLevels> held_out) {
  DFR_THROW_UNLESS(!held_out.empty(), "there are no levels of held-out demonstrations");
  std::vector<double> longest;
  std::vector<double> levels;
  longest.reserve(held_out.size());
  for (const HeldOutLevels& demonstration : held_out) {
    EdgeStay stay;
    double most = 0.0;
    for (std::size_t i = 0; i < demonstration.levels.size(); ++i) {
      stay.Add(demonstration.levels[i] < edge(demonstration.phases[i]));
      most = std::max(most, stay.steps());
    }
    longest.push_back(most);
    levels.insert(levels.end(), demonstration.levels.begin(), demonstration.levels.end());
  }
  if (!levels.empty()) {
    pass_depth_ = std::max(0.0, -Quantile(levels, guided::kPassDepthQuantile));
  }
  edge_stay_ = std::max(guided::kLeastEdgeStay, Quantile(longest, guided::kEdgeStayQuantile));
}

void Levels::SetPredictionErrors(std::span<const double> errors) {
  DFR_THROW_UNLESS(std::all_of(errors.begin(), errors.end(), [](double e) { return e >= 0.0; }),
                   "an error of a prediction is negative or NaN");
  std::vector<double> all(errors.begin(), errors.end());
  prediction_error_ = all.empty() ? 0.0 : Quantile(all, guided::kPredictionQuantile);
}

void Levels::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(gate_);
  archive.Numbers(pass_);
  archive.Numbers(edge_);
  archive.Numbers(median_);
  archive.Number(slack_);
  archive.Number(edge_stay_);
  archive.Number(pass_depth_);
  archive.Number(prediction_error_);
}

Levels Levels::Load(core::ArchiveReader& archive) {
  Levels levels;
  levels.gate_ = Read(archive, "gate levels");
  levels.pass_ = Read(archive, "pass levels");
  levels.edge_ = Read(archive, "edge levels");
  levels.median_ = Read(archive, "median levels");
  const std::size_t steps = levels.gate_.size();
  if (levels.pass_.size() != steps || levels.edge_.size() != steps ||
      levels.median_.size() != steps) {
    archive.Fail("gate, pass, edge and median levels must have the same number of time steps");
  }
  // Both levels result from interpolations with rounding errors.
  constexpr double kRounding = 1e-9;
  for (std::size_t t = 0; t < steps; ++t) {
    if (levels.pass_[t] > levels.gate_[t] * (1.0 + kRounding)) {
      archive.Fail("a pass level must not exceed the gate level of its time step");
    }
  }
  levels.slack_ = archive.Number();
  if (!(levels.slack_ >= 0.0 && std::isfinite(levels.slack_))) {
    archive.Fail("the slack must be finite and not negative");
  }
  levels.edge_stay_ = archive.Number();
  if (!(levels.edge_stay_ >= 0.0 && std::isfinite(levels.edge_stay_))) {
    archive.Fail("the stay at the edge must be finite and not negative");
  }
  levels.pass_depth_ = archive.Number();
  if (!(levels.pass_depth_ >= 0.0 && std::isfinite(levels.pass_depth_))) {
    archive.Fail("the pass depth must be finite and not negative");
  }
  levels.prediction_error_ = archive.Number();
  if (!(levels.prediction_error_ >= 0.0)) {
    archive.Fail("the error of predictions must not be negative or NaN");
  }
  return levels;
}

double Levels::Clamped(const std::vector<double>& values, int t) noexcept {
  return values[static_cast<std::size_t>(std::clamp(t, 0, static_cast<int>(values.size()) - 1))];
}

}  // namespace dfr::control
