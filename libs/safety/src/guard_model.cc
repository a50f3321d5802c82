#include "dfr/safety/guard_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "dfr/control/certified/certificate_constants.h"
#include "dfr/control/certified/certifier.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/build_info.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/text/format.h"
#include "dfr/core/text/suggest.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/safety/constants.h"
#include "dfr/safety/guard_advice.h"
#include "fit/check_demonstrations.h"
#include "fit/choose_features.h"
#include "fit/fit_task.h"
#include "fit/left_out.h"
#include "fit/sensor_groups.h"

namespace dfr::safety {
namespace {

constexpr std::array kStrategies = {Strategy::kGuard,   Strategy::kController,
                                    Strategy::kDfr,     Strategy::kEarlyStopping,
                                    Strategy::kMonitor, Strategy::kCertified};

// Largest values that a file may contain.
constexpr int kMost = 1 << 30;

void CheckLimit(const std::vector<double>& limit) {
  for (std::size_t i = 0; i < limit.size(); ++i) {
    DFR_THROW_UNLESS(
        limit[i] >= 0.0 && std::isfinite(limit[i]),
        "action_limit must be finite and not negative: entry " << i << " is " << limit[i]);
  }
  DFR_THROW_UNLESS(limit.empty() || *std::max_element(limit.begin(), limit.end()) > 0.0,
                   "action_limit is zero in all entries: nothing could move");
}

void Check(const GuardSettings& settings) {
  DFR_THROW_UNLESS(settings.horizon > 0 && settings.horizon <= kMost,
                   "horizon must lie in [1, " << kMost << "], not " << settings.horizon);
  DFR_THROW_UNLESS(settings.max_actions > 0 && settings.max_actions <= kMost,
                   "max_actions must lie in [1, " << kMost << "], not " << settings.max_actions);
  CheckLimit(settings.action_limit);
  DFR_THROW_UNLESS(!settings.action_limit.empty(), "action_limit has no entries");
  DFR_THROW_UNLESS(std::isfinite(settings.alarm_level),
                   "alarm_level must be finite, not " << settings.alarm_level);
  DFR_THROW_UNLESS(settings.direction_error >= 0.0 && std::isfinite(settings.direction_error),
                   "direction_error must be finite and not negative: " << settings.direction_error);
}

void Check(const GuardOptions& options) {
  DFR_THROW_UNLESS(
      options.horizon >= 0 && options.horizon <= GuardOptions::kLongestHorizon,
      "horizon must lie in [0, " << GuardOptions::kLongestHorizon << "], not " << options.horizon);
  DFR_THROW_UNLESS(options.folds >= 2, "folds must be at least 2, not " << options.folds);
  CheckLimit(options.action_limit);
  DFR_THROW_UNLESS(options.false_alarms > 0.0 && options.false_alarms < 1.0,
                   "false_alarms must lie in (0, 1), not " << options.false_alarms);
  DFR_THROW_UNLESS(options.confidence >= 0.0 && options.confidence < 1.0,
                   "confidence must lie in [0, 1), not " << options.confidence);
  DFR_THROW_UNLESS(options.hold_out >= 0.0 && options.hold_out <= 0.5,
                   "hold_out must lie in [0, .5], not " << options.hold_out);
  DFR_THROW_UNLESS(options.error_factor > 0.0 && std::isfinite(options.error_factor),
                   "error_factor must be positive and finite, not " << options.error_factor);
}

// Wilcoxon's signed-rank test by its normal approximation: the probability of differences at least
// this large between `higher` and `lower` if their signs are random.
double ChanceOfBeingHigher(std::span<const double> higher, std::span<const double> lower) {
  std::vector<double> differences;
  for (std::size_t i = 0; i < std::min(higher.size(), lower.size()); ++i) {
    if (higher[i] < lower[i] || higher[i] > lower[i]) differences.push_back(higher[i] - lower[i]);
  }
  std::sort(differences.begin(), differences.end(),
            [](double a, double b) { return std::abs(a) < std::abs(b); });
  const auto n = static_cast<double>(differences.size());
  double ranks = 0.0;
  for (std::size_t i = 0; i < differences.size(); ++i) {
    if (differences[i] > 0.0) ranks += static_cast<double>(i) + 1.0;
  }
  const double spread = std::sqrt(n * (n + 1.0) * (2.0 * n + 1.0) / 24.0);
  if (!(spread > 0.0)) return 1.0;
  return 0.5 * std::erfc((ranks - n * (n + 1.0) / 4.0) / spread / std::sqrt(2.0));
}

// The alarm level and its guarantee.
struct AlarmLevel {
  double level = 0.0;
  double false_alarms = 0.0;
  double confidence = 0.0;
};

AlarmLevel AlarmLevelOf(const std::vector<double>& worst, const GuardOptions& options) {
  const double promised =
      kernel::ConformalThreshold(worst, options.false_alarms, options.confidence);
  if (std::isfinite(promised)) return {promised, options.false_alarms, options.confidence};
  // With few demonstrations no level has this guarantee. Uses the level of the worst demonstration.
  return {*std::max_element(worst.begin(), worst.end()),
          1.0 / static_cast<double>(worst.size() + 1), 0.0};
}

}  // namespace

const char* Name(Strategy strategy) noexcept {
  switch (strategy) {
    case Strategy::kGuard:
      return "guard";
    case Strategy::kController:
      return "controller";
    case Strategy::kDfr:
      return "dfr";
    case Strategy::kEarlyStopping:
      return "early-stopping";
    case Strategy::kMonitor:
      return "monitor";
    case Strategy::kCertified:
      return "certified";
  }
  return "unknown";
}

Strategy ParseStrategy(std::string_view name) {
  for (const Strategy strategy : kStrategies) {
    if (name == Name(strategy)) return strategy;
  }
  throw core::UnknownName("strategy", name,
                          "guard, controller, dfr, early-stopping, monitor, certified");
}

std::shared_ptr<const GuardModel> GuardModel::Fit(const core::StateLayout& layout,
                                                  std::span<const core::Trajectory> demonstrations,
                                                  const GuardOptions& options) {
  internal::CheckDemonstrations(layout, demonstrations);
  Check(options);
  const std::shared_ptr<GuardModel> model =
      reduction::StateReduction::Requests(options.features).empty()
          ? FitStates(layout, demonstrations, options, true)
          : FitReduced(layout, demonstrations, options);
  if (model) {
    model->sensor_groups_ = internal::FitSensorGroups(*model, demonstrations);
    model->periods_ = model->FindPeriods(layout, demonstrations);
  }
  return model;
}

std::shared_ptr<GuardModel> GuardModel::FitStates(const core::StateLayout& layout,
                                                  std::span<const core::Trajectory> demonstrations,
                                                  const GuardOptions& options, bool may_narrow) {
  const auto going_on = [&](std::string_view stage, double share) {
    return !options.progress || options.progress(stage, share);
  };
  const std::span<const core::Trajectory> as_recorded = demonstrations;
  std::vector<core::Trajectory> varying = internal::WithoutConstants(as_recorded);
  const std::vector<std::size_t> sums = core::DeterministicOrder(
      varying.empty() ? as_recorded : std::span<const core::Trajectory>(varying));
  std::vector<core::Trajectory> steady = internal::WithoutJumps(layout, as_recorded);
  varying = internal::WithoutConstants(steady);
  const auto actions =
      std::make_shared<const ActionSpace>(varying.empty() ? steady : varying, sums);
  const auto asked = core::FeatureSelection::Of(layout, options.features);
  const std::vector<int> moved =
      internal::MovedByPassed(asked, *actions, steady, core::DeterministicOrder(as_recorded));
  core::FeatureSelection selection = internal::Continuous(
      moved.empty() ? asked : internal::Without(asked, layout, moved), layout, as_recorded);
  std::vector<core::Trajectory> mapped;
  if (!selection.map().empty()) {
    mapped = internal::Mapped(selection.map(), as_recorded);
    demonstrations = mapped;
  }
  const std::vector<int> constant = internal::ConstantEntries(selection, demonstrations);
  std::optional<core::FeatureSelection> constant_entries;
  if (!constant.empty()) {
    constant_entries = internal::Only(layout, constant).Mapped(selection.map());
    selection =
        internal::Continuous(internal::Without(selection, layout, constant), layout, as_recorded);
  }
  constexpr int kMostFeatures = core::FeatureTransform::kMaxFeatures;
  DFR_THROW_UNLESS(selection.num_features() <= kMostFeatures,
                   "at most " << kMostFeatures << " features are supported, not "
                              << selection.num_features()
                              << ": select fewer, or put pca: before a block of many entries");
  // The order is pseudo-random, from a hash of the content: held-out and further demonstrations are
  // exchangeable.
  varying = internal::WithoutConstants(demonstrations);
  const std::vector<std::size_t> order = core::DeterministicOrder(
      varying.empty() ? demonstrations : std::span<const core::Trajectory>(varying));
  constexpr double kRounding = 1e-9;
  const auto num_held_out = static_cast<std::size_t>(
      std::ceil(options.hold_out * static_cast<double>(demonstrations.size()) - kRounding));
  DFR_THROW_UNLESS(demonstrations.size() >= num_held_out + 3,
                   "holding out " << num_held_out << " of " << demonstrations.size()
                                  << " demonstrations leaves fewer than 3 to fit to");
  if (!going_on("scaling the features", 0.0)) return nullptr;
  internal::Recorded recorded(selection, demonstrations, std::span(order).subspan(num_held_out),
                              actions.get());
  std::optional<core::FeatureTransform> context;
  if (!moved.empty()) {
    context = internal::Context(layout, moved, as_recorded);
    for (const core::Trajectory& d : recorded.ordered) {
      recorded.seen.contexts.push_back(context->Apply(d.states));
    }
  }
  std::optional<internal::GuardFit> fit =
      internal::FitGuard(recorded, options.support, options.folds, going_on, may_narrow);
  if (!fit) return nullptr;
  if (!options.accept_any &&
      !internal::RefuseUnlessInside(layout, recorded, *fit, *actions, options.folds, going_on)) {
    return nullptr;
  }
  std::optional<TaskParts> parts = internal::MakeTask(
      recorded, std::move(fit->support), fit->left_out, fit->options.single_precision,
      [&] { return going_on("fitting the response to actions", 0.8); });
  if (!parts) return nullptr;
  if (!going_on("estimating the alarm level", 0.95)) return nullptr;

  const auto replayed = [&] {
    return internal::ReplayLeftOut(recorded, fit->folds, fit->without, parts->view(),
                                   [&] { return going_on("estimating the alarm level", 0.95); });
  };
  std::optional<internal::Replay> replay = replayed();
  if (!replay) return nullptr;
  // The errors decide which actions the guard changes.
  parts->levels.SetPredictionErrors(replay->level_errors);
  replay = replayed();
  if (!replay) return nullptr;
  auto task = std::make_shared<const TaskModel>(*std::move(parts));
  std::vector<core::Trajectory> held_out;
  for (const std::size_t d : std::span(order).first(num_held_out)) {
    held_out.push_back(demonstrations[d]);
  }
  const control::FeatureTrajectories unseen(task->features(), actions->Measured(held_out));
  internal::HeldOut levels;
  for (const core::Matrix& points : unseen.points) levels.Add(task->feature_support(), points);
  if (held_out.empty()) levels = fit->left_out;
  const AlarmLevel alarm = AlarmLevelOf(levels.worst, options);
  DFR_THROW_UNLESS(std::isfinite(alarm.level),
                   "no alarm level exists: check the demonstrations for outliers. One is "
                   "infinitely far from the others in the features "
                       << (options.features.empty() ? "of the whole state" : options.features));

  if (!going_on("estimating the errors of predictions", 0.97)) return nullptr;
  GuardSettings settings;
  settings.strategy = options.strategy;
  Eigen::Index longest = 0;
  Eigen::Index transitions = 0;
  for (const core::Trajectory& demonstration : demonstrations) {
    longest = std::max(longest, demonstration.controls.rows());
    transitions += demonstration.controls.rows();
  }
  settings.horizon =
      options.horizon > 0
          ? options.horizon
          : static_cast<int>(std::min<Eigen::Index>(2 * longest, GuardOptions::kLongestHorizon));
  settings.max_actions = fit::kActionsPerStep * settings.horizon;
  settings.action_limit =
      options.action_limit.empty() ? actions->Limits(fit::kActionReach) : options.action_limit;
  settings.alarm_level = alarm.level;

  std::shared_ptr<GuardModel> model(new GuardModel);
  model->summary_ = {
      .source = options.source,
      .version = core::BuildVersion(),
      .demonstrations = static_cast<int>(demonstrations.size()),
      .transitions = static_cast<int>(transitions),
      .nu = fit->options.svm.nu,
      .gamma = fit->options.svm.gamma,
      .acceptance = levels.acceptance(),
      .inside_throughout = levels.inside_throughout / static_cast<double>(levels.worst.size()),
      .gaps = fit->gaps,
      .false_alarms = alarm.false_alarms,
      .confidence = alarm.confidence,
      .held_out = static_cast<int>(held_out.size()),
      .support_fits = fit->support_fits,
      .drift_level = AlarmLevelOf(fit->contiguous.worst, options).level,
      .drift_chance = ChanceOfBeingHigher(fit->contiguous.worst, fit->left_out.worst),
      .direction_error = held_out.empty()
                             ? control::EstimateDirectionError(recorded.seen, fit->folds)
                             : control::EstimateDirectionError(task->response(), unseen),
      .gain = control::EstimateGain(held_out.empty() ? recorded.seen : unseen),
      .changed = replay->changed,
      .ends_outside = replay->ends_outside,
      .below_pass = replay->below_pass,
      .explained = replay->explained,
      .action_error = replay->error,
      .entry_error = replay->entry_error};
  settings.demonstrated = !replay->guesses();
  settings.direction_error = options.error_factor * model->summary_.direction_error.value;
  model->Complete(layout, actions, std::move(task), settings);
  model->context_ = std::move(context);
  model->summary_.fit_warnings = FitWarnings(*model, as_recorded);
  if (constant_entries) {
    model->constants_.resize(constant.size());
    constant_entries->Apply(core::Row(as_recorded[order[0]].states, 0), model->constants_);
    model->constant_entries_ = std::move(constant_entries);
  }
  if (!moved.empty()) {
    model->summary_.fit_warnings.push_back(
        internal::Names(layout, moved) +
        ": moved by entries of an action that the guard passes and not by those that it steers. "
        "They are not in the support: the policy alone is responsible for them");
  }
  const double drift =
      std::max(control::LargestChangeAtRest(recorded.seen), control::LargestChangeAtRest(unseen));
  if (options.strategy == Strategy::kCertified && drift > control::Certifier::kFeatureRounding) {
    model->summary_.fit_warnings.push_back(core::Format(
        "features change by up to %.2g in steps with a zero action: assumption 3 of a certificate "
        "does not hold, and a certified guard halts there. Remove the cause, such as sensor "
        "noise, or use another strategy",
        drift));
  }
  if (alarm.confidence < options.confidence) {
    model->summary_.fit_warnings.push_back(core::Format(
        "%zu demonstrations cannot keep the share of false alarms at %g with confidence %g. The "
        "alarm level gives %.3g on average over fits: use more demonstrations, or a lower "
        "confidence",
        levels.worst.size(), options.false_alarms, options.confidence, alarm.false_alarms));
  }
  if (!going_on("done", 1.0)) return nullptr;
  return model;
}

void GuardModel::Complete(core::StateLayout layout, std::shared_ptr<const ActionSpace> actions,
                          std::shared_ptr<const TaskModel> task, GuardSettings settings) {
  Check(settings);
  const auto dim = static_cast<std::size_t>(actions->dim());
  if (settings.action_limit.size() == 1)
    settings.action_limit.resize(dim, settings.action_limit[0]);
  DFR_THROW_UNLESS(
      settings.action_limit.size() == dim,
      "action_limit has " << settings.action_limit.size() << " entries, but actions have " << dim);
  actions_ = std::move(actions);
  layout_ = std::move(layout);
  task_ = std::move(task);
  settings_ = std::move(settings);
  if (settings_.strategy == Strategy::kCertified) static_cast<void>(certificate());
}

control::Certificate GuardModel::certificate() const {
  DFR_THROW_UNLESS(
      settings_.direction_error > 0.0,
      "a certificate needs a positive direction_error: fit the guard again, or set it");
  DFR_THROW_UNLESS(
      !task_->single_precision(),
      "a certificate needs double precision: fit the guard again without single precision");
  return {.direction_error = settings_.direction_error, .level = settings_.alarm_level};
}

Certification GuardModel::Certify(int t, std::span<const double> state,
                                  std::span<const double> action) const {
  const Eigen::VectorXd z = Features(state);
  DFR_THROW_UNLESS(static_cast<int>(action.size()) == action_dim(),
                   "the action has " << action.size() << " entries, but the guard's actions have "
                                     << action_dim());
  t = std::clamp(t, 0, num_steps() - 1);
  const control::Certificate certificate = this->certificate();
  const control::TaskView task = task_->view();
  const int n = task.features().num_features();
  // The certificate assumes that there is no drift.
  const control::LocalFit answer =
      control::ResponseEstimate(task.response().prior(), {}, /*drift=*/false)
          .FitAt(t, core::AsSpan(z));
  Eigen::VectorXd v(actions_->steered_dim());
  actions_->Measure(action, core::AsSpan(v));
  v /= task.response().control_unit();
  Certification found;
  found.effect = answer.jacobian() * v;
  found.ball_radius = -1.0;
  found.radius = -1.0;
  Eigen::VectorXd shift(n);
  for (int q = std::max(0, t - control::PhaseTracker::kWindow);
       q <= t + control::PhaseTracker::kWindow; ++q) {
    const control::SafeBall ball = control::ComputeSafeBall(task.support(), q, core::AsSpan(z),
                                                            core::AsSpan(shift), certificate.level);
    if (ball.radius < 0.0 || ball.worst_radius() <= found.radius) continue;
    found.radius = ball.worst_radius();
    found.ball_radius = ball.radius;
    found.shift = shift;
  }
  control::Certifier certifier(certificate, n, actions_->steered_dim(),
                               task.response().control_unit());
  const control::LocalModel local{task.support(), answer};
  const control::Certifier::RequiredLevel need = certifier.Predict(local, t, v);
  found.passes = need.met();
  found.step = need.phase;
  found.margin = -need.missing;
  return found;
}

std::shared_ptr<const GuardModel> GuardModel::With(const GuardSettings& settings) const {
  std::shared_ptr<GuardModel> model(new GuardModel);
  model->Complete(layout_, actions_, task_, settings);
  model->reduction_ = reduction_;
  model->summary_ = summary_;
  model->constant_entries_ = constant_entries_;
  model->constants_ = constants_;
  model->context_ = context_;
  model->sensor_groups_ = sensor_groups_;
  model->periods_ = periods_;
  return model;
}

double SensorGroup::limit() const noexcept {
  return fit::kStandstillFactor * longest + fit::kStandstillMargin;
}

}  // namespace dfr::safety
