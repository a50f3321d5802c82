#include "fit_task.h"

#include <algorithm>
#include <utility>

#include "dfr/control/phase_tracker.h"
#include "dfr/control/published/lambda.h"
#include "dfr/core/folds.h"
#include "state_decision.h"

namespace dfr::safety::internal {
namespace {

// Points inside that a gap test allows, as a share of its time steps or of its points if these are
// more, and how often gamma may be doubled for it.
constexpr double kMostInGaps = 0.05;
constexpr int kMostDoublings = 2;
// States of left-out demonstrations that are to be inside, before a support of many time steps
// pools more of them. It may do so twice.
constexpr double kWantedInside = 0.85;
constexpr int kMostWidenings = 2;
core::FeatureTransform Whitened(const core::FeatureSelection& selection,
                                std::span<const core::Trajectory> ordered) {
  std::vector<core::Matrix> states;
  states.reserve(ordered.size());
  for (const core::Trajectory& demonstration : ordered) states.push_back(demonstration.states);
  return core::FeatureTransform::Whitening(selection, states);
}

std::vector<core::Trajectory> Ordered(std::span<const core::Trajectory> demonstrations,
                                      std::span<const std::size_t> order) {
  std::vector<core::Trajectory> ordered;
  ordered.reserve(order.size());
  for (const std::size_t d : order) ordered.push_back(demonstrations[d]);
  return ordered;
}

// How many groups demonstrations are left out in: two must remain to fit to.
int NumFolds(std::size_t demonstrations, int most) {
  return std::min(most, std::max(2, static_cast<int>(demonstrations / 2)));
}

// The demonstrations of each fold under a support that has not seen them, in the order of `order`;
// nothing if `going_on` says so. Where there are three, one has no support. `without`, if given,
// receives the supports.
std::optional<HeldOut> LeaveOut(std::span<const core::Matrix> points, const core::Folds& folds,
                                std::span<const std::size_t> order,
                                const kernel::WhitenedSupportOptions& options,
                                const std::function<bool(double share)>& going_on,
                                std::vector<std::optional<kernel::WhitenedSupport>>* without) {
  std::vector<HeldOut> each(points.size());
  if (without != nullptr) without->assign(folds.size(), std::nullopt);
  for (std::size_t fold = 0; fold < folds.size(); ++fold) {
    if (!going_on(static_cast<double>(fold) / static_cast<double>(folds.size()))) {
      return std::nullopt;
    }
    std::vector<core::Matrix> others;
    others.reserve(points.size());
    for (const std::size_t d : core::Others(folds, fold, order)) others.push_back(points[d]);
    if (others.size() < 2) continue;
    auto support = kernel::WhitenedSupport::Fit(others, options);
    for (const std::size_t d : folds[fold]) each[d].Add(support, points[d]);
    if (without != nullptr) (*without)[fold] = std::move(support);
  }
  HeldOut all;
  for (const std::size_t d : order) {
    all.worst.insert(all.worst.end(), each[d].worst.begin(), each[d].worst.end());
    all.inside += each[d].inside;
    all.states += each[d].states;
    all.inside_throughout += each[d].inside_throughout;
  }
  return all;
}

std::shared_ptr<const TaskModel> WithLambda(std::shared_ptr<const GuidedRecovery> guided,
                                            std::span<const core::Trajectory> demonstrations) {
  std::vector<double> lambda =
      control::EstimateLambda(StateDecision(guided->features(), guided->support()), demonstrations);
  return std::make_shared<const TaskModel>(std::move(guided), std::move(lambda));
}

}  // namespace

std::vector<double> Follow(const core::LogDecisionFunction& support, const core::Matrix& states,
                           std::vector<int>* steps) {
  control::PhaseTracker tracker(support);
  std::vector<double> levels;
  if (steps != nullptr) steps->clear();
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    levels.push_back(tracker.Follow(core::Row(states, i)));
    if (steps != nullptr) steps->push_back(tracker.phase());
  }
  return levels;
}

bool TooManyInGaps(const kernel::GapTest& gaps) {
  return gaps.inside > kMostInGaps * std::max(gaps.steps, gaps.points);
}

Recorded::Recorded(const core::FeatureSelection& selection,
                   std::span<const core::Trajectory> demonstrations, const ActionSpace& actions)
    : order(core::ContentOrder(demonstrations)),
      ordered(Ordered(demonstrations, order)),
      measured(actions.Measured(ordered)),
      features(Whitened(selection, ordered)) {
  points.reserve(demonstrations.size());
  for (const core::Trajectory& demonstration : demonstrations) {
    points.push_back(features.Apply(demonstration.states));
  }
  in_order.reserve(order.size());
  for (const std::size_t d : order) in_order.push_back(points[d]);
}

void HeldOut::Add(const core::LogDecisionFunction& support, const core::Matrix& points) {
  const std::vector<double> levels = Follow(support, points, nullptr);
  const double lowest = *std::min_element(levels.begin(), levels.end());
  worst.push_back(-lowest);
  inside_throughout += lowest >= 0.0 ? 1 : 0;
  states += static_cast<double>(levels.size());
  inside += static_cast<double>(
      std::count_if(levels.begin(), levels.end(), [](double l) { return l >= 0.0; }));
}

std::optional<TaskFit> FitTask(const Recorded& recorded,
                               const kernel::WhitenedSupportOptions& options, int folds,
                               const std::function<bool(std::string_view, double)>& going_on) {
  const std::vector<core::Matrix>& points = recorded.points;
  kernel::WhitenedSupportOptions support = options;
  std::optional<kernel::WhitenedSupport> to_all;
  kernel::GapTest gaps;
  for (int doubled = 0;; ++doubled) {
    if (!going_on("looking for gaps", 0.0)) return std::nullopt;
    to_all = kernel::WhitenedSupport::Fit(recorded.in_order, support);
    gaps = kernel::TestGaps(*to_all, recorded.in_order);
    if (!TooManyInGaps(gaps) || doubled == kMostDoublings) break;
    support.svm.gamma *= 2.0;
  }

  const int num_folds = NumFolds(points.size(), folds);
  const core::Folds stratified = core::StratifiedFolds(points, num_folds);
  std::optional<HeldOut> left_out;
  std::vector<std::optional<kernel::WhitenedSupport>> without;
  for (int widened = 0;; ++widened) {
    left_out = LeaveOut(
        points, stratified, recorded.order, support,
        [&](double s) {
          return going_on("leaving demonstrations out", 0.3 * (widened + s) / (1 + kMostWidenings));
        },
        &without);
    if (!left_out) return std::nullopt;
    if (left_out->inside >= kWantedInside * left_out->states || widened == kMostWidenings) break;
    kernel::WhitenedSupportOptions wider = support;
    wider.window_share = std::min(1.0, 2.0 * support.window_share);
    if (wider.Stride(to_all->num_steps()) == support.Stride(to_all->num_steps())) break;
    auto wider_to_all = kernel::WhitenedSupport::Fit(recorded.in_order, wider);
    const kernel::GapTest wider_gaps = kernel::TestGaps(wider_to_all, recorded.in_order);
    if (TooManyInGaps(wider_gaps) && !TooManyInGaps(gaps)) break;
    gaps = wider_gaps;
    support = wider;
    to_all = std::move(wider_to_all);
  }
  std::optional<HeldOut> contiguous = LeaveOut(
      points, core::ContiguousFolds(points.size(), num_folds), recorded.order, support,
      [&](double s) { return going_on("leaving stretches out", 0.3 + 0.3 * s); }, nullptr);
  if (!contiguous) return std::nullopt;
  return TaskFit{support,    *std::move(to_all), gaps, *std::move(left_out), *std::move(contiguous),
                 stratified, std::move(without)};
}

std::shared_ptr<const TaskModel> MakeTask(const core::FeatureSelection& selection,
                                          std::span<const core::Trajectory> demonstrations,
                                          std::span<const core::Trajectory> measured,
                                          const kernel::WhitenedSupportOptions& options) {
  return WithLambda(std::make_shared<const GuidedRecovery>(selection, measured, options),
                    demonstrations);
}

std::shared_ptr<const TaskModel> MakeTask(const Recorded& recorded, kernel::WhitenedSupport to_all,
                                          const kernel::WhitenedSupportOptions& options) {
  return WithLambda(std::make_shared<const GuidedRecovery>(recorded.features, recorded.measured,
                                                           std::move(to_all), options),
                    recorded.ordered);
}

}  // namespace dfr::safety::internal
