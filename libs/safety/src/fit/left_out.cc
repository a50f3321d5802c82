#include "fit/left_out.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "dfr/control/guided/safety_filter.h"
#include "dfr/control/response/response_estimate.h"

namespace dfr::safety::internal {
namespace {

constexpr std::size_t kMostActions = 1000;

// Sums over replayed actions v, in units of an ordinary action.
struct Sums {
  explicit Sums(Eigen::Index control_dim)
      : v(Eigen::VectorXd::Zero(control_dim)), squares(v), missed(v) {}
  double count = 0.0;
  double changed = 0.0;
  double below_pass = 0.0;
  double outside = 0.0;
  double guessed = 0.0;     // Number of actions with a prediction.
  Eigen::VectorXd v;        // Sum of the actions with a prediction.
  Eigen::VectorXd squares;  // Sum of the squares of each entry.
  Eigen::VectorXd missed;   // Sum of squared errors of the predictions.
  std::vector<double> level_errors;

  [[nodiscard]] Replay Shares() const {
    if (!(count > 0.0)) return {};
    Replay replay{.changed = changed / count,
                  .below_pass = below_pass / count,
                  .ends_outside = outside / count,
                  .level_errors = level_errors};
    if (!(guessed > 0.0) || !(squares.sum() > 0.0)) return replay;
    const Eigen::VectorXd variances = squares - v.cwiseAbs2() / guessed;
    Eigen::Index most = 0;
    const double largest = variances.maxCoeff(&most);
    // A constant action is predicted perfectly.
    constexpr double kConstant = 1e-9;
    if (variances.sum() > kConstant * squares.sum()) {
      replay.explained = 1.0 - missed.sum() / variances.sum();
    }
    replay.error = missed.sum() / squares.sum();
    if (largest > kConstant * squares[most]) replay.entry_error = missed[most] / squares[most];
    return replay;
  }
};

void Judge(int phase, std::span<const double> z, std::span<const double> after,
           const Eigen::VectorXd& v, const core::LogDecisionFunction& support,
           const control::Levels& levels, const control::ResponseEstimate& estimate,
           control::SafetyFilter& filter, control::LocalFit& fit, Sums& sums) {
  estimate.FitAt(phase, z, fit);
  Eigen::VectorXd next = core::AsVector(z);
  fit.AddEffect(v, next);
  const double level = support.LogDecision(phase + 1, core::AsSpan(next), {});
  sums.count += 1.0;
  const double pass = levels.pass(phase + 1);
  sums.below_pass += level >= pass ? 0.0 : 1.0;
  Eigen::VectorXd applied = v;
  static_cast<void>(filter.Filter(fit, {phase + 1, levels.gate(phase + 1)}, pass, applied));
  sums.changed += applied == v ? 0.0 : 1.0;
  sums.outside += level >= 0.0 ? 0.0 : 1.0;
  const double error = std::abs(level - support.LogDecision(phase + 1, after, {}));
  if (std::isfinite(error)) sums.level_errors.push_back(error);
  Eigen::VectorXd guess = Eigen::VectorXd::Zero(v.size());
  if (!fit.NominalControl(guess)) return;
  sums.guessed += 1.0;
  sums.v += v;
  sums.squares += v.cwiseAbs2();
  sums.missed += (guess - v).cwiseAbs2();
}

}  // namespace

std::optional<Replay> ReplayLeftOut(const Recorded& recorded, const core::Folds& folds,
                                    std::span<const std::optional<kernel::WhitenedSupport>> without,
                                    const control::TaskView& task,
                                    const std::function<bool()>& going_on) {
  const control::Response& response = task.response();
  const std::vector<core::Matrix>& points = recorded.seen.points;
  const std::vector<core::Matrix>& contexts = recorded.seen.contexts;
  std::vector<core::Matrix> controls = recorded.seen.controls;
  std::size_t actions = 0;
  for (core::Matrix& c : controls) {
    c /= response.control_unit();
    actions += static_cast<std::size_t>(c.rows());
  }
  const std::size_t stride = std::max<std::size_t>(1, actions / kMostActions);
  Sums sums(response.control_dim());
  for (std::size_t fold = 0; fold < folds.size(); ++fold) {
    if (!without[fold]) continue;
    if (!going_on()) return std::nullopt;
    const kernel::WhitenedSupport& support = *without[fold];
    const control::ResponseEstimate estimate(
        std::make_shared<const control::TransitionStore>(
            core::WithoutFold(points, folds, fold), core::WithoutFold(controls, folds, fold),
            response.prior()->options(), core::WithoutFold(contexts, folds, fold)),
        {}, response.has_drift());
    control::LocalFit made = estimate.MakeFit();
    control::SafetyFilter filter({task.features(), support, task.levels(), response},
                                 {.least_intervention = true});
    std::size_t next = 0;
    for (std::size_t d = 0; d < controls.size(); ++d) {
      if (std::ranges::count(folds[fold], d) == 0) continue;
      std::vector<int> steps;
      Follow(support, points[d], &steps);
      for (Eigen::Index t = 0; t < controls[d].rows(); ++t, ++next) {
        if (next % stride != 0) continue;
        if (!contexts.empty()) made.SetContext(core::Row(contexts[d], t));
        Judge(steps[static_cast<std::size_t>(t)], core::Row(points[d], t),
              core::Row(points[d], t + 1), controls[d].row(t), support, task.levels(), estimate,
              filter, made, sums);
      }
    }
  }
  return sums.Shares();
}

}  // namespace dfr::safety::internal
