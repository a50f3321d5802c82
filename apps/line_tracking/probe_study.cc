#include "probe_study.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "dfr/core/numerics/quantile.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr std::size_t kDistance = 2;  // index in LineTrackingPlant's state

double MedianOrNan(std::vector<double> values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  return core::Median(values);
}

}  // namespace

ProbeStudy::ProbeStudy(const LineModel& model, const sim::LineTrackingPlant& plant)
    : model_(&model), plant_(&plant) {
  for (const core::Trajectory& demonstration : model.demonstrations().trajectories) {
    for (int t = 0; t < demonstration.num_steps(); ++t) {
      const auto i = static_cast<std::size_t>(t);
      if (i == largest_g_.size()) largest_g_.push_back(-std::numeric_limits<double>::infinity());
      largest_g_[i] = std::max(
          largest_g_[i], model.task().support().Decision(t, core::Row(demonstration.states, t)));
    }
  }
}

void ProbeStudy::OnStart(std::span<const double> /*x*/) {
  before_ = plant_->TrueState();
  recovering_ = false;
}

void ProbeStudy::OnControl(const control::RolloutEvent& event) {
  const control::Step& step = event.step;
  const std::array<double, 4> after = plant_->TrueState();
  if (step.mode == control::Mode::kPolicy) {
    if (recovering_) ++ended_;
    recovering_ = false;
  } else if (!recovering_) {
    recovering_ = true;
    ++recoveries_;
    const auto t = std::min(static_cast<std::size_t>(step.t), largest_g_.size() - 1);
    if (step.threshold >= largest_g_[t]) ++out_of_reach_;
  }
  if (step.mode == control::Mode::kProbe && std::isfinite(event.next_x[kDistance])) {
    const core::DecisionFunction& support = model_->task().support();
    const double seen = support.Decision(step.t, event.next_x) - step.g;
    const double real = support.Decision(step.t, after) - support.Decision(step.t, before_);
    if (seen * real > 0.0) ++right_;
    sizes_um_.push_back(1e6 * sim::LineTrackingPlant::kStep * std::hypot(event.u[0], event.u[1]));
    errors_um_.push_back(1e3 * std::abs(event.next_x[kDistance] - event.x[kDistance] -
                                        (after[kDistance] - before_[kDistance])));
  }
  before_ = after;
}

void ProbeStudy::OnEnd(const control::RolloutResult& /*result*/) { recovering_ = false; }

double ProbeStudy::size_um() const { return MedianOrNan(sizes_um_); }
double ProbeStudy::error_um() const { return MedianOrNan(errors_um_); }

double ProbeStudy::right_sign() const noexcept {
  return sizes_um_.empty() ? std::numeric_limits<double>::quiet_NaN()
                           : static_cast<double>(right_) / static_cast<double>(sizes_um_.size());
}

}  // namespace dfr::apps::line_tracking
