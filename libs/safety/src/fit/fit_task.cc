#include "fit/fit_task.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "dfr/control/phase_tracker.h"
#include "dfr/control/published/lambda.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/feature_decision.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/safety/constants.h"
#include "fit/left_out.h"

namespace dfr::safety::internal {
namespace {

std::vector<core::Trajectory> Ordered(std::span<const core::Trajectory> demonstrations,
                                      std::span<const std::size_t> order) {
  std::vector<core::Trajectory> ordered;
  ordered.reserve(order.size());
  for (const std::size_t d : order) ordered.push_back(demonstrations[d]);
  return ordered;
}

core::FeatureTransform Whitened(const core::FeatureSelection& selection,
                                std::span<const core::Trajectory> ordered,
                                const core::WhiteningOptions& options) {
  std::vector<core::Matrix> states;
  states.reserve(ordered.size());
  for (const core::Trajectory& demonstration : ordered) states.push_back(demonstration.states);
  return core::FeatureTransform::Whitening(selection, states, options);
}

// Returns the number of folds. Each has at least two demonstrations if there are four or more.
int NumFolds(std::size_t demonstrations, int most) {
  return std::min(most, std::max(2, static_cast<int>(demonstrations / 2)));
}

// Callback for fits of supports. Remembers a stop, because later fits must not begin.
class Stoppable {
 public:
  explicit Stoppable(const kernel::WhitenedSupportOptions& options)
      : progress_(options.svm.progress) {}

  // Borrows this object.
  [[nodiscard]] kernel::WhitenedSupportOptions Options(kernel::WhitenedSupportOptions options) {
    if (!progress_) return options;
    options.svm.progress = [this](const kernel::FitProgress& progress) {
      stopped_ = stopped_ || !progress_(progress);
      return !stopped_;
    };
    return options;
  }
  [[nodiscard]] bool stopped() const noexcept { return stopped_; }

 private:
  std::function<bool(const kernel::FitProgress&)> progress_;
  bool stopped_ = false;
};

// Fits supports and counts the fits.
class SupportFits {
 public:
  explicit SupportFits(const Recorded& recorded) : points_(recorded.seen.points) {}

  kernel::WhitenedSupport ToAll(const kernel::WhitenedSupportOptions& options) {
    return Fit(points_, options);
  }

  // Evaluates the demonstrations of each fold with a support fitted without them. The results keep
  // the order of the demonstrations. Returns nothing if `going_on` returns false. With three
  // demonstrations one fold has no support. `without`, if given, receives the supports.
  std::optional<HeldOut> LeaveOut(const core::Folds& folds,
                                  const kernel::WhitenedSupportOptions& options,
                                  const std::function<bool(double share)>& going_on,
                                  std::vector<std::optional<kernel::WhitenedSupport>>* without) {
    const auto goes_on = [&](double fold) {
      return going_on(fold / static_cast<double>(folds.size()));
    };
    if (without != nullptr) without->assign(folds.size(), std::nullopt);
    std::vector<HeldOut> each(points_.size());
    for (std::size_t fold = 0; fold < folds.size(); ++fold) {
      const auto begun = static_cast<double>(fold);
      if (!goes_on(begun)) return std::nullopt;
      const std::vector<core::Matrix> others = core::WithoutFold(points_, folds, fold);
      if (others.size() < 2) continue;
      kernel::WhitenedSupport support = Fit(others, options);
      if (!goes_on(begun + 0.9)) return std::nullopt;
      for (const std::size_t d : folds[fold]) each[d].Add(support, points_[d]);
      if (without != nullptr) (*without)[fold] = std::move(support);
    }
    HeldOut all;
    for (const HeldOut& one : each) {
      all.each.insert(all.each.end(), one.each.begin(), one.each.end());
      all.worst.insert(all.worst.end(), one.worst.begin(), one.worst.end());
      all.inside_throughout += one.inside_throughout;
    }
    return all;
  }

  [[nodiscard]] int count() const noexcept { return count_; }

 private:
  kernel::WhitenedSupport Fit(std::span<const core::Matrix> points,
                              const kernel::WhitenedSupportOptions& options) {
    ++count_;
    return kernel::WhitenedSupport::Fit(points, options);
  }

  const std::vector<core::Matrix>& points_;
  int count_ = 0;
};

// Supports at a few time steps, which are faster to fit than supports at all time steps.
class CoarseSupports {
 public:
  CoarseSupports(const Recorded& recorded, const kernel::WhitenedSupportOptions& options, int folds)
      : points_(recorded.seen.points), folds_(recorded.Stratified(folds)), options_(options) {
    Eigen::Index longest = 0;
    for (const core::Matrix& points : points_) longest = std::max(longest, points.rows());
    options_.every = static_cast<int>((longest + fit::kCoarseSteps - 1) / fit::kCoarseSteps);
    for (const core::Matrix& points : points_) {
      coarse_.emplace_back(points(Eigen::seq(0, Eigen::last, options_.every), Eigen::all));
    }
  }

  // Returns true if twice the gamma of the options covers more left-out states per volume; nothing
  // if `going_on`, which is called before each fit, returns false.
  [[nodiscard]] std::optional<bool> PreferNarrow(const std::function<bool()>& going_on) const {
    const std::optional<Fitted> wide = Fit(options_.svm.gamma, going_on);
    if (!wide) return std::nullopt;
    const std::optional<Fitted> narrow = Fit(2.0 * options_.svm.gamma, going_on);
    if (!narrow || !going_on()) return std::nullopt;
    const double gain = -kernel::LogVolumeRatio(wide->support, wide->level, narrow->support,
                                                narrow->level, coarse_);
    return gain > std::log(wide->acceptance / narrow->acceptance);
  }

 private:
  struct Fitted {
    kernel::WhitenedSupport support;
    double level;  // A fraction fit::kLeftOutside of left-out states is below it.
    double acceptance;
  };

  [[nodiscard]] std::optional<Fitted> Fit(double gamma,
                                          const std::function<bool()>& going_on) const {
    kernel::WhitenedSupportOptions options = options_;
    options.svm.gamma = gamma;
    HeldOut held_out;
    for (std::size_t fold = 0; fold < folds_.size(); ++fold) {
      const std::vector<core::Matrix> others = core::WithoutFold(points_, folds_, fold);
      if (others.size() < 2) continue;
      if (!going_on()) return std::nullopt;
      const auto support = kernel::WhitenedSupport::Fit(others, options);
      if (!going_on()) return std::nullopt;
      for (const std::size_t d : folds_[fold]) held_out.Add(support, coarse_[d]);
    }
    if (!going_on()) return std::nullopt;
    return Fitted{kernel::WhitenedSupport::Fit(points_, options),
                  core::Quantile(held_out.levels(), fit::kLeftOutside), held_out.acceptance()};
  }

  const std::vector<core::Matrix>& points_;
  core::Folds folds_;
  kernel::WhitenedSupportOptions options_;
  std::vector<core::Matrix> coarse_;  // Every options_.every-th state.
};

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

bool TooManyInGaps(const kernel::ModeSeparationTest& gaps) {
  return gaps.inside > fit::kMostInGaps * std::max(gaps.steps, gaps.points);
}

Recorded::Recorded(const core::FeatureSelection& selection,
                   std::span<const core::Trajectory> demonstrations,
                   std::span<const std::size_t> chosen, const ActionSpace* actions,
                   const core::WhiteningOptions& whitening)
    : order(chosen.begin(), chosen.end()),
      ordered(Ordered(demonstrations, chosen)),
      features(Whitened(selection, ordered, whitening)),
      seen(features, actions != nullptr ? actions->Measured(ordered) : ordered) {}

Recorded::Recorded(core::FeatureTransform transform,
                   std::span<const core::Trajectory> demonstrations,
                   std::span<const std::size_t> chosen)
    : order(chosen.begin(), chosen.end()),
      ordered(Ordered(demonstrations, chosen)),
      features(std::move(transform)),
      seen(features, ordered) {}

core::Folds Recorded::Stratified(int most) const {
  return core::StratifiedFolds(seen.points, NumFolds(order.size(), most));
}

core::Folds Recorded::Contiguous(int most) const {
  std::vector<std::size_t> by_recording(order.size());
  std::iota(by_recording.begin(), by_recording.end(), std::size_t{0});
  std::sort(by_recording.begin(), by_recording.end(),
            [&](std::size_t a, std::size_t b) { return order[a] < order[b]; });
  core::Folds folds = core::ContiguousFolds(order.size(), NumFolds(order.size(), most));
  for (std::vector<std::size_t>& fold : folds) {
    for (std::size_t& d : fold) d = by_recording[d];
  }
  return folds;
}

void HeldOut::Add(const core::LogDecisionFunction& support, const core::Matrix& points) {
  control::HeldOutLevels& one = each.emplace_back();
  one.levels = Follow(support, points, &one.phases);
  const double lowest = *std::min_element(one.levels.begin(), one.levels.end());
  worst.push_back(-lowest);
  inside_throughout += lowest >= 0.0 ? 1 : 0;
}

std::vector<double> HeldOut::levels() const {
  std::vector<double> all;
  for (const control::HeldOutLevels& one : each) {
    all.insert(all.end(), one.levels.begin(), one.levels.end());
  }
  return all;
}

double HeldOut::acceptance() const {
  const std::vector<double> all = levels();
  const auto inside = std::count_if(all.begin(), all.end(), [](double l) { return l >= 0.0; });
  return static_cast<double>(inside) / static_cast<double>(all.size());
}

std::optional<GuardFit> FitGuard(const Recorded& recorded,
                                 const kernel::WhitenedSupportOptions& options, int folds,
                                 const StageCallback& progress, bool may_narrow) {
  Stoppable stoppable(options);
  const auto going_on = [&](std::string_view stage, double share) {
    return !stoppable.stopped() && progress(stage, share);
  };
  SupportFits fits(recorded);
  kernel::WhitenedSupportOptions chosen = stoppable.Options(options);
  std::optional<kernel::WhitenedSupport> support;
  kernel::ModeSeparationTest gaps;
  if (may_narrow) {
    const std::optional<bool> narrow = CoarseSupports(recorded, chosen, folds).PreferNarrow([&] {
      return going_on("comparing kernel widths", 0.0);
    });
    if (!narrow) return std::nullopt;
    if (*narrow) chosen.svm.gamma *= 2.0;
  }
  for (int doubled = 0;; ++doubled) {
    if (!going_on("testing for gaps", 0.0)) return std::nullopt;
    support = fits.ToAll(chosen);
    if (!going_on("testing for gaps", 0.0)) return std::nullopt;
    gaps = kernel::TestModeSeparation(*support, recorded.seen.points);
    if (!TooManyInGaps(gaps) || doubled == fit::kMostDoublings) break;
    chosen.svm.gamma *= 2.0;
  }

  core::Folds stratified = recorded.Stratified(folds);
  std::optional<HeldOut> left_out;
  std::vector<std::optional<kernel::WhitenedSupport>> without;
  for (int widened = 0;; ++widened) {
    left_out = fits.LeaveOut(
        stratified, chosen,
        [&](double s) {
          return going_on("leaving demonstrations out",
                          0.4 * (widened + s) / (1 + fit::kMostWidenings));
        },
        &without);
    if (!left_out) return std::nullopt;
    if (left_out->acceptance() >= fit::kWantedInside || widened == fit::kMostWidenings) break;
    kernel::WhitenedSupportOptions wider = chosen;
    wider.window_share = std::min(1.0, 2.0 * chosen.window_share);
    if (wider.Stride(support->num_steps()) == chosen.Stride(support->num_steps())) break;
    kernel::WhitenedSupport wider_support = fits.ToAll(wider);
    if (stoppable.stopped()) return std::nullopt;
    const kernel::ModeSeparationTest wider_gaps =
        kernel::TestModeSeparation(wider_support, recorded.seen.points);
    if (TooManyInGaps(wider_gaps) && !TooManyInGaps(gaps)) break;
    gaps = wider_gaps;
    chosen = wider;
    support = std::move(wider_support);
  }
  std::optional<HeldOut> contiguous = fits.LeaveOut(
      recorded.Contiguous(folds), chosen,
      [&](double s) { return going_on("leaving stretches out", 0.4 + 0.4 * s); }, nullptr);
  if (!contiguous || stoppable.stopped()) return std::nullopt;
  chosen.svm.progress = options.svm.progress;
  return GuardFit{chosen,
                  *std::move(support),
                  gaps,
                  std::move(stratified),
                  std::move(without),
                  *std::move(left_out),
                  *std::move(contiguous),
                  fits.count()};
}

std::optional<TaskParts> MakeTask(const Recorded& recorded, kernel::WhitenedSupport support,
                                  const HeldOut& left_out, bool single_precision,
                                  const std::function<bool()>& going_on,
                                  std::optional<PublishedSupport> published) {
  bool stopped = false;
  const auto goes_on = [&] {
    stopped = stopped || !going_on();
    return !stopped;
  };
  control::Levels levels(support, recorded.seen.points,
                         {.slack = control::EstimateSlack(left_out.levels())});
  levels.SetHeldOut(left_out.each);
  if (!goes_on()) return std::nullopt;
  TaskParts task{.features = recorded.features,
                 .support = std::move(support),
                 .levels = std::move(levels),
                 .response = control::Response(recorded.seen, {}, goes_on),
                 .published = std::move(published),
                 .single_precision = single_precision};
  if (!goes_on()) return std::nullopt;
  task.lambda = control::EstimateLambda(task.PublishedDecision(), recorded.ordered);
  return task;
}

TaskParts FitTask(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations,
                  const TaskOptions& options) {
  const std::vector<std::size_t> order = core::DeterministicOrder(demonstrations);
  const Recorded recorded =
      options.features ? Recorded(*options.features, demonstrations, order)
                       : Recorded(core::FeatureSelection::Of(layout, options.guided_features),
                                  demonstrations, order, nullptr, options.whitening);
  DFR_THROW_UNLESS(demonstrations.size() >= 3,
                   "leaving demonstrations out needs at least 3, not " << demonstrations.size());
  SupportFits fits(recorded);
  kernel::WhitenedSupport support = fits.ToAll(options.guided);
  const core::Folds folds = recorded.Stratified(fit::kFolds);
  std::vector<std::optional<kernel::WhitenedSupport>> without;
  const std::optional<HeldOut> left_out = fits.LeaveOut(
      folds, options.guided, [](double) { return true; }, &without);
  std::optional<PublishedSupport> published;
  if (options.published) {
    core::FeatureSelection selection =
        core::FeatureSelection::Of(layout, options.published_features);
    std::vector<core::Matrix> states;
    states.reserve(demonstrations.size());
    for (const core::Trajectory& d : demonstrations) states.push_back(selection.Apply(d.states));
    published = PublishedSupport{std::move(selection),
                                 kernel::TimeVaryingSupport::Fit(states, *options.published)};
  }
  std::optional<TaskParts> task = MakeTask(
      recorded, std::move(support), *left_out, options.guided.single_precision, [] { return true; },
      std::move(published));
  task->horizon = options.horizon;
  const std::optional<Replay> replay =
      ReplayLeftOut(recorded, folds, without, task->view(), [] { return true; });
  task->levels.SetPredictionErrors(replay->level_errors);
  return *std::move(task);
}

}  // namespace dfr::safety::internal
