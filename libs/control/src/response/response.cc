#include "dfr/control/response/response.h"

#include <algorithm>
#include <cmath>

#include "dfr/control/constants.h"
#include "dfr/control/response/few_values.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

// Calls visit(fit, d, t) for transitions of each half of the demonstrations, with fits to the other
// half. Stops if `going_on`, which is called for each demonstration, returns false.
template <typename Visit>
void VisitLeftOut(const FeatureTrajectories& demonstrations, std::span<const core::Matrix> controls,
                  const ResponseOptions& options, bool drift, const std::function<bool()>& going_on,
                  const Visit& visit) {
  constexpr Eigen::Index kEnough = 2000;  // Number of transitions of each half.
  const std::vector<core::Matrix>& points = demonstrations.points;
  const std::vector<core::Matrix>& contexts = demonstrations.contexts;
  Eigen::Index transitions = 0;
  for (const core::Matrix& c : controls) transitions += c.rows();
  const Eigen::Index stride = 1 + transitions / (2 * kEnough);
  for (const std::size_t half : {0U, 1U}) {
    std::vector<core::Matrix> shown_points;
    std::vector<core::Matrix> shown_controls;
    std::vector<core::Matrix> shown_contexts;
    for (std::size_t d = half; d < points.size(); d += 2) {
      shown_points.push_back(points[d]);
      shown_controls.push_back(controls[d]);
      if (!contexts.empty()) shown_contexts.push_back(contexts[d]);
    }
    const ResponseEstimate estimate(std::make_shared<const TransitionStore>(
                                        shown_points, shown_controls, options, shown_contexts),
                                    {}, drift);
    LocalFit fit = estimate.MakeFit();
    for (std::size_t d = 1 - half; d < points.size(); d += 2) {
      if (going_on && !going_on()) return;
      for (Eigen::Index t = 0; t < controls[d].rows(); t += stride) {
        if (!contexts.empty()) fit.SetContext(core::Row(contexts[d], t));
        estimate.FitAt(static_cast<int>(t), core::Row(points[d], t), fit);
        visit(fit, d, t);
      }
    }
  }
}

// Returns the variance of left-out demonstrations that controls and a drift leave unexplained, as a
// fraction of the variance that controls alone leave unexplained.
double WithDrift(const FeatureTrajectories& demonstrations, std::span<const core::Matrix> controls,
                 const ResponseOptions& options, const std::function<bool()>& going_on) {
  const std::vector<core::Matrix>& points = demonstrations.points;
  double alone = 0.0;
  double together = 0.0;
  Eigen::VectorXd there(points[0].cols());
  for (const bool drift : {false, true}) {
    double& error = drift ? together : alone;
    VisitLeftOut(demonstrations, controls, options, drift, going_on,
                 [&](LocalFit& fit, std::size_t d, Eigen::Index t) {
                   there = points[d].row(t);
                   fit.AddEffect(controls[d].row(t).transpose(), there);
                   error += (points[d].row(t + 1).transpose() - there).squaredNorm();
                 });
  }
  return alone > 0.0 ? together / alone : 1.0;
}

// Returns true if demonstrated changes predict controls of left-out demonstrations clearly worse
// than demonstrated controls alone. If observations are noisy, a demonstrated change contains the
// return of the noise to its mean. A control that reproduces this change is too large.
bool ChangesMislead(const FeatureTrajectories& demonstrations,
                    std::span<const core::Matrix> controls, const ResponseOptions& options,
                    bool drift, const std::function<bool()>& going_on) {
  double squares = 0.0;
  double alone = 0.0;
  double by_change = 0.0;
  Eigen::VectorXd v(controls[0].cols());
  VisitLeftOut(demonstrations, controls, options, drift, going_on,
               [&](LocalFit& fit, std::size_t d, Eigen::Index t) {
                 if (!fit.DemonstratedControl(v)) return;
                 squares += controls[d].row(t).squaredNorm();
                 alone += (controls[d].row(t).transpose() - v).squaredNorm();
                 (void)fit.NominalControl(v);
                 by_change += (controls[d].row(t).transpose() - v).squaredNorm();
               });
  return by_change > guided::kMostWorse * alone + guided::kNegligible * squares;
}

}  // namespace

FeatureTrajectories::FeatureTrajectories(const core::FeatureTransform& features,
                                         std::span<const core::Trajectory> demonstrations) {
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const core::Trajectory& demonstration = demonstrations[d];
    DFR_THROW_UNLESS(demonstration.states.rows() == demonstration.controls.rows() + 1,
                     "demonstration " << d << " has " << demonstration.states.rows()
                                      << " states and " << demonstration.controls.rows()
                                      << " controls; one state more than controls is needed");
    DFR_THROW_UNLESS(demonstration.states.allFinite() && demonstration.controls.allFinite(),
                     "demonstration " << d << " has a non-finite entry");
    points.push_back(features.Apply(demonstration.states));
    controls.push_back(demonstration.controls);
  }
}

double RootMeanSquare(std::span<const core::Matrix> controls) {
  double square = 0.0;
  int moving = 0;
  for (const core::Matrix& c : controls) {
    for (const auto& control : c.rowwise()) {
      square += control.squaredNorm();
      moving += control.squaredNorm() > 0.0 ? 1 : 0;
    }
  }
  DFR_THROW_UNLESS(moving > 0, "all demonstrated controls are zero");
  return std::sqrt(square / moving);
}

Response::Response(const FeatureTrajectories& demonstrations, const ResponseOptions& options,
                   const std::function<bool()>& going_on) {
  DFR_THROW_UNLESS(!demonstrations.points.empty(), "there are no demonstrations");
  std::vector<core::Matrix> controls = demonstrations.controls;
  control_unit_ = RootMeanSquare(controls);
  for (const core::Matrix& c : controls) {
    for (const auto& control : c.rowwise()) largest_ = std::max(largest_, control.norm());
  }
  largest_ /= control_unit_;
  for (core::Matrix& c : controls) c /= control_unit_;
  // Checks shapes and options.
  prior_ = std::make_shared<const TransitionStore>(demonstrations.points, controls, options,
                                                   demonstrations.contexts);
  std::vector<FewValues> values(static_cast<std::size_t>(controls[0].cols()));
  for (const core::Matrix& c : controls) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      for (const double value : c.col(static_cast<Eigen::Index>(i))) values[i].Add(value);
    }
  }
  for (const FewValues& entry : values) {
    values_.push_back(entry.values());
    // An entry with a single value leaves no choice.
    if (values_.back().size() == 1) values_.back().clear();
  }
  if (controls.size() < 2) return;
  has_drift_ = WithDrift(demonstrations, controls, options, going_on) <= guided::kMostLeft;
  if (!options.measured_changes ||
      !ChangesMislead(demonstrations, controls, options, has_drift_, going_on)) {
    return;
  }
  ResponseOptions chosen = options;
  chosen.measured_changes = false;
  prior_ = std::make_shared<const TransitionStore>(demonstrations.points, controls, chosen,
                                                   demonstrations.contexts);
}

void Response::Save(core::ArchiveWriter& archive) const {
  archive.Number(largest_);
  archive.Number(control_unit_);
  archive.Integer(has_drift_ ? 1 : 0);
  prior_->Save(archive);
  for (const std::vector<double>& values : values_) archive.Numbers(values);
}

Response Response::Load(core::ArchiveReader& archive) {
  Response response;
  response.largest_ = archive.Number();
  if (!(response.largest_ >= 0.0 && std::isfinite(response.largest_))) {
    archive.Fail("the largest control must be finite and not negative");
  }
  response.control_unit_ = archive.Number();
  if (!(response.control_unit_ > 0.0 && std::isfinite(response.control_unit_))) {
    archive.Fail("the unit of controls must be finite and positive");
  }
  response.has_drift_ = archive.IntegerIn(0, 1) == 1;
  response.prior_ = std::make_shared<const TransitionStore>(TransitionStore::Load(archive));
  for (int i = 0; i < response.control_dim(); ++i) {
    response.values_.push_back(archive.Numbers());
    const std::vector<double>& values = response.values_.back();
    if (values.size() > guided::kMostFew || !std::is_sorted(values.begin(), values.end()) ||
        !std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); })) {
      archive.Fail("an entry of a control must have few values, finite and in ascending order");
    }
  }
  return response;
}

}  // namespace dfr::control
