#include "dfr/safety/guard_model.h"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>

#include "dfr/control/certified/certifier.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/absolute_actions.h"
#include "dfr/core/archive.h"
#include "dfr/core/build_info.h"
#include "dfr/core/contract.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/format.h"
#include "dfr/kernel/cover_radius.h"
#include "dfr/kernel/model_selection.h"
#include "fit_task.h"

namespace dfr::safety {
namespace {

constexpr std::string_view kGuardKind = "guard";
constexpr int kGuardVersion = 1;

constexpr std::array kStrategies = {Strategy::kGuided,  Strategy::kDfr,  Strategy::kEarlyStopping,
                                    Strategy::kMonitor, Strategy::kSoft, Strategy::kCertified};

// A guard gives up after so many actions a policy's action at the most.
constexpr int kActionsPerStep = 12;
// The largest entry of an applied action against that of a demonstrated one.
constexpr double kActionReach = 2.0;
// What files hold.
constexpr int kMost = 1 << 30;
constexpr int kLongestHorizon = kMost / kActionsPerStep;

void Check(const GuardSettings& settings) {
  DFR_THROW_UNLESS(settings.horizon > 0 && settings.horizon <= kMost,
                   "horizon must lie in [1, " << kMost << "], not be " << settings.horizon);
  DFR_THROW_UNLESS(settings.max_actions > 0 && settings.max_actions <= kMost,
                   "max_actions must lie in [1, " << kMost << "], not be " << settings.max_actions);
  DFR_THROW_UNLESS(settings.action_limit > 0.0 && std::isfinite(settings.action_limit),
                   "action_limit must be positive and finite, not " << settings.action_limit);
  DFR_THROW_UNLESS(std::isfinite(settings.alarm_level),
                   "alarm_level must be finite, not " << settings.alarm_level);
  DFR_THROW_UNLESS(
      settings.direction_error >= 0.0 && std::isfinite(settings.direction_error),
      "direction_error must not be negative, and finite: " << settings.direction_error);
}

void Check(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations) {
  DFR_THROW_UNLESS(demonstrations.size() >= 3,
                   "a guard needs at least 3 demonstrations, not " << demonstrations.size());
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const core::Trajectory& demonstration = demonstrations[d];
    DFR_THROW_UNLESS(demonstration.states.cols() == layout.state_dim(),
                     "demonstration " << d << " has states of " << demonstration.states.cols()
                                      << " entries, the layout " << layout.state_dim());
    DFR_THROW_UNLESS(demonstration.controls.rows() >= 1 &&
                         demonstration.states.rows() == demonstration.controls.rows() + 1,
                     "demonstration " << d << " has " << demonstration.states.rows()
                                      << " states and " << demonstration.controls.rows()
                                      << " actions; one state more than actions is needed. Append "
                                         "the state after the last action, or drop that action");
    DFR_THROW_UNLESS(demonstration.controls.cols() == demonstrations[0].controls.cols(),
                     "demonstration " << d << " has actions of " << demonstration.controls.cols()
                                      << " entries, demonstration 0 of "
                                      << demonstrations[0].controls.cols());
    for (const auto& [what, rows] : {std::pair("state", &demonstration.states),
                                     std::pair("action", &demonstration.controls)}) {
      for (Eigen::Index t = 0; t < rows->rows(); ++t) {
        DFR_THROW_UNLESS(rows->row(t).allFinite(), "demonstration "
                                                       << d << " has a non-finite entry in " << what
                                                       << ' ' << t);
      }
    }
  }
}

// Wilcoxon's signed-rank test, by its normal approximation: how likely it is that `higher` is above
// `lower` as much as it is, or more, if differences are as likely to be negative as positive.
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

// The alarm level, and what is promised of it.
struct AlarmLevel {
  double level = 0.0;
  double false_alarms = 0.0;
  double confidence = 0.0;
};

AlarmLevel AlarmLevelOf(const std::vector<double>& worst, const GuardOptions& options) {
  const double promised =
      kernel::ConformalThreshold(worst, options.false_alarms, options.confidence);
  if (std::isfinite(promised)) return {promised, options.false_alarms, options.confidence};
  // With few demonstrations none of them promises so little; their worst is what there is.
  return {*std::max_element(worst.begin(), worst.end()),
          1.0 / static_cast<double>(worst.size() + 1), 0.0};
}

void Write(core::ArchiveWriter& archive, const control::EstimatedConstant& constant) {
  archive.Number(constant.value);
  archive.Number(constant.confidence);
  archive.Number(constant.coverage);
  archive.Integer(constant.demonstrations);
}

control::EstimatedConstant ReadConstant(core::ArchiveReader& archive) {
  control::EstimatedConstant constant;
  constant.value = archive.Number();
  constant.confidence = archive.Number();
  constant.coverage = archive.Number();
  constant.demonstrations = archive.IntegerIn(0, 1 << 30);
  return constant;
}

}  // namespace

const char* Name(Strategy strategy) noexcept {
  switch (strategy) {
    case Strategy::kGuided:
      return "guided";
    case Strategy::kDfr:
      return "dfr";
    case Strategy::kEarlyStopping:
      return "early-stopping";
    case Strategy::kMonitor:
      return "monitor";
    case Strategy::kSoft:
      return "soft";
    case Strategy::kCertified:
      return "certified";
  }
  return "unknown";
}

Strategy ParseStrategy(std::string_view name) {
  for (const Strategy strategy : kStrategies) {
    if (name == Name(strategy)) return strategy;
  }
  throw std::invalid_argument(
      "there is no strategy '" + std::string(name) +
      "'; there are: guided, dfr, early-stopping, monitor, soft, certified");
}

std::shared_ptr<const GuardModel> GuardModel::Fit(const core::StateLayout& layout,
                                                  std::span<const core::Trajectory> demonstrations,
                                                  const GuardOptions& options) {
  Check(layout, demonstrations);
  DFR_THROW_UNLESS(
      options.horizon >= 0 && options.horizon <= kLongestHorizon,
      "horizon must lie in [0, " << kLongestHorizon << "], not be " << options.horizon);
  DFR_THROW_UNLESS(options.folds >= 2, "folds must be at least 2: " << options.folds);
  DFR_THROW_UNLESS(options.action_limit >= 0.0,
                   "action_limit must not be negative: " << options.action_limit);
  DFR_THROW_UNLESS(options.false_alarms > 0.0 && options.false_alarms < 1.0,
                   "false_alarms must lie in (0, 1), not be " << options.false_alarms);
  DFR_THROW_UNLESS(options.hold_out >= 0.0 && options.hold_out <= 0.5,
                   "hold_out must lie in [0, .5], not be " << options.hold_out);
  DFR_THROW_UNLESS(options.error_factor > 0.0 && std::isfinite(options.error_factor),
                   "error_factor must be positive and finite, not " << options.error_factor);
  const auto going_on = [&](std::string_view stage, double share) {
    return !options.progress || options.progress(stage, share);
  };
  const core::FeatureSelection selection = options.features.empty()
                                               ? core::FeatureSelection::All(layout.state_dim())
                                               : core::FeatureSelection(layout, options.features);
  const internal::Recorded recorded(selection, demonstrations);
  const std::span<const core::Trajectory> ordered = recorded.ordered;
  // By their content, which has nothing to do with what they are like: a random sample, so that
  // further demonstrations are exchangeable with those held out.
  const auto num_held_out = static_cast<std::size_t>(
      std::ceil(options.hold_out * static_cast<double>(demonstrations.size())));
  DFR_THROW_UNLESS(demonstrations.size() >= num_held_out + 3,
                   "holding out " << num_held_out << " of " << demonstrations.size()
                                  << " demonstrations leaves fewer than 3 to fit to");
  const std::span<const core::Trajectory> held_out = ordered.first(num_held_out);
  const std::span<const core::Trajectory> fitted = ordered.subspan(num_held_out);

  std::optional<internal::TaskFit> fit =
      internal::FitTask(recorded, options.support, options.folds, going_on);
  if (!fit || !going_on("fitting the support", 0.6)) return nullptr;
  auto task = held_out.empty()
                  ? internal::MakeTask(recorded, std::move(fit->to_all), fit->options)
                  : std::make_shared<const TaskModel>(
                        layout, fitted,
                        TaskOptions{.guided_features = options.features, .guided = fit->options});
  if (!going_on("estimating the alarm level", 0.95)) return nullptr;

  const control::GuidedModel& guided = task->guided().model();
  internal::HeldOut levels = fit->left_out;
  if (!held_out.empty()) {
    levels = {};
    for (const core::Trajectory& demonstration : held_out) {
      levels.Add(guided.support(), guided.features().Apply(demonstration.states));
    }
  }
  const AlarmLevel alarm = AlarmLevelOf(levels.worst, options);
  DFR_THROW_UNLESS(std::isfinite(alarm.level),
                   "no alarm level can be found: a demonstration is infinitely far from the others "
                   "in the features "
                       << (options.features.empty() ? "of the whole state" : options.features));

  GuardSettings settings;
  settings.strategy = options.strategy;
  Eigen::Index longest = 0;
  Eigen::Index transitions = 0;
  double largest = 0.0;
  for (const core::Trajectory& demonstration : demonstrations) {
    longest = std::max(longest, demonstration.controls.rows());
    transitions += demonstration.controls.rows();
    largest = std::max(largest, demonstration.controls.cwiseAbs().maxCoeff());
  }
  settings.horizon = options.horizon > 0
                         ? options.horizon
                         : static_cast<int>(std::min<Eigen::Index>(2 * longest, kLongestHorizon));
  settings.max_actions = kActionsPerStep * settings.horizon;
  settings.action_limit =
      options.action_limit > 0.0 ? options.action_limit : kActionReach * largest;
  settings.alarm_level = alarm.level;

  std::shared_ptr<GuardModel> model(new GuardModel);
  model->summary_ = {
      .source = options.source,
      .version = core::BuildVersion(),
      .demonstrations = static_cast<int>(demonstrations.size()),
      .transitions = static_cast<int>(transitions),
      .nu = fit->options.svm.nu,
      .gamma = fit->options.svm.gamma,
      .acceptance = levels.inside / levels.states,
      .inside_throughout = levels.inside_throughout / static_cast<double>(levels.worst.size()),
      .gaps = fit->gaps,
      .false_alarms = alarm.false_alarms,
      .confidence = alarm.confidence,
      .held_out = static_cast<int>(held_out.size()),
      .drift_level = AlarmLevelOf(fit->contiguous.worst, options).level,
      .drift_chance = ChanceOfBeingHigher(fit->contiguous.worst, fit->left_out.worst),
      .direction_error = held_out.empty()
                             ? control::EstimateDirectionError(guided.features(), fitted)
                             : control::EstimateDirectionError(guided, held_out),
      .gain = control::EstimateGain(guided.features(), held_out.empty() ? fitted : held_out)};
  settings.direction_error = options.error_factor * model->summary_.direction_error.value;
  model->Complete(layout, std::move(task), settings);
  if (!going_on("done", 1.0)) return nullptr;
  return model;
}

void GuardModel::Complete(core::StateLayout layout, std::shared_ptr<const TaskModel> task,
                          const GuardSettings& settings) {
  Check(settings);
  layout_ = std::move(layout);
  task_ = std::move(task);
  settings_ = settings;
  if (settings.strategy == Strategy::kCertified) static_cast<void>(certificate());
}

control::Certificate GuardModel::certificate() const {
  DFR_THROW_UNLESS(settings_.direction_error > 0.0,
                   "a certificate needs to know how wrong J is: fit the guard again, or set "
                   "direction_error");
  DFR_THROW_UNLESS(!recovery().single_precision(),
                   "a certificate is to hold to the last digit: fit the guard in double precision");
  return {.direction_error = settings_.direction_error,
          .level = std::max(0.0, settings_.alarm_level)};
}

Certification GuardModel::Certify(int t, std::span<const double> state,
                                  std::span<const double> action) const {
  DFR_THROW_UNLESS(
      static_cast<int>(state.size()) == state_dim(),
      "the state has " << state.size() << " entries, the guard's have " << state_dim());
  DFR_THROW_UNLESS(
      static_cast<int>(action.size()) == action_dim(),
      "the action has " << action.size() << " entries, the guard's have " << action_dim());
  const control::Certificate certificate = this->certificate();
  const control::GuidedModel& model = recovery().model();
  const int n = model.features().num_features();
  Eigen::VectorXd z(n);
  model.features().Apply(state, core::AsSpan(z));
  // What a certificate assumes.
  control::JacobianEstimate answer(model.prior(), {}, /*own_motion=*/false);
  answer.Compute(t, core::AsSpan(z));
  const Eigen::VectorXd v = core::AsVector(action) / model.control_unit();
  Certification found;
  found.effect = answer.jacobian() * v;
  found.ball_radius = -1.0;
  found.radius = -1.0;
  Eigen::VectorXd shift(n);
  for (int q = std::max(0, t - control::PhaseTracker::kWindow);
       q <= t + control::PhaseTracker::kWindow; ++q) {
    const control::SafeBall ball = control::ComputeSafeBall(model.support(), q, core::AsSpan(z),
                                                            core::AsSpan(shift), certificate.level);
    if (ball.radius < 0.0 || ball.worst_radius() <= found.radius) continue;
    found.radius = ball.worst_radius();
    found.ball_radius = ball.radius;
    found.shift = shift;
  }
  control::Certifier certifier(certificate, n, action_dim(), model.control_unit());
  const control::LocalModel local{model.support(), answer, core::AsSpan(z)};
  const control::Certifier::Need need = certifier.Predict(local, t, v);
  found.passes = need.met();
  found.step = need.phase;
  found.margin = -need.missing;
  return found;
}

std::shared_ptr<const GuardModel> GuardModel::With(const GuardSettings& settings) const {
  std::shared_ptr<GuardModel> model(new GuardModel);
  model->Complete(layout_, task_, settings);
  model->summary_ = summary_;
  return model;
}

void GuardModel::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter archive(kGuardKind, kGuardVersion);
  archive.Integer(static_cast<std::int64_t>(layout_.blocks.size()));
  for (const auto& block : layout_.blocks) {
    archive.Text(block.name);
    archive.Integer(block.size);
  }
  archive.Text(recovery().features().selection().spec());
  archive.Text(Name(settings_.strategy));
  archive.Integer(settings_.horizon);
  archive.Integer(settings_.max_actions);
  archive.Number(settings_.action_limit);
  archive.Number(settings_.alarm_level);
  archive.Number(settings_.direction_error);
  archive.Text(summary_.source);
  archive.Text(summary_.version);
  archive.Integer(summary_.demonstrations);
  archive.Integer(summary_.transitions);
  for (const double value : {summary_.nu, summary_.gamma, summary_.acceptance,
                             summary_.inside_throughout, summary_.false_alarms}) {
    archive.Number(value);
  }
  archive.Number(summary_.confidence);
  archive.Integer(summary_.held_out);
  archive.Number(summary_.drift_level);
  archive.Number(summary_.drift_chance);
  for (const int count : {summary_.gaps.steps, summary_.gaps.points, summary_.gaps.inside}) {
    archive.Integer(count);
  }
  Write(archive, summary_.direction_error);
  Write(archive, summary_.gain);
  archive.Numbers(lambda());
  recovery().Save(archive);
  archive.Save(path);
}

std::shared_ptr<const GuardModel> GuardModel::Load(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, kGuardKind, kGuardVersion);
  try {
    core::StateLayout layout;
    const int blocks = archive.IntegerIn(1, 1 << 16);
    for (int i = 0; i < blocks; ++i) {
      std::string name = archive.Text();
      layout.Add(std::move(name), archive.IntegerIn(1, 1 << 20));
    }
    const std::string spec = archive.Text();
    core::FeatureSelection selection = spec.empty()
                                           ? core::FeatureSelection::All(layout.state_dim())
                                           : core::FeatureSelection(layout, spec);
    GuardSettings settings;
    settings.strategy = ParseStrategy(archive.Text());
    settings.horizon = archive.IntegerIn(1, kMost);
    settings.max_actions = archive.IntegerIn(1, kMost);
    settings.action_limit = archive.Number();
    settings.alarm_level = archive.Number();
    settings.direction_error = archive.Number();
    GuardSummary summary;
    summary.source = archive.Text();
    summary.version = archive.Text();
    summary.demonstrations = archive.IntegerIn(0, kMost);
    summary.transitions = archive.IntegerIn(0, kMost);
    summary.nu = archive.Number();
    summary.gamma = archive.Number();
    summary.acceptance = archive.Number();
    summary.inside_throughout = archive.Number();
    summary.false_alarms = archive.Number();
    summary.confidence = archive.Number();
    summary.held_out = archive.IntegerIn(0, kMost);
    summary.drift_level = archive.Number();
    summary.drift_chance = archive.Number();
    summary.gaps.steps = archive.IntegerIn(0, kMost);
    summary.gaps.points = archive.IntegerIn(0, kMost);
    summary.gaps.inside = archive.IntegerIn(0, kMost);
    summary.direction_error = ReadConstant(archive);
    summary.gain = ReadConstant(archive);
    std::vector<double> lambda = archive.Numbers();
    auto recovery = GuidedRecovery::Load(archive, std::move(selection));
    archive.End();
    std::shared_ptr<GuardModel> model(new GuardModel);
    model->Complete(std::move(layout),
                    std::make_shared<const TaskModel>(std::move(recovery), std::move(lambda)),
                    settings);
    model->summary_ = std::move(summary);
    return model;
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

std::vector<double> GuardModel::Levels(const core::Matrix& states, std::vector<int>* steps) const {
  DFR_THROW_UNLESS(states.cols() == state_dim(),
                   "states have " << states.cols() << " entries, the guard's have " << state_dim());
  return internal::Follow(support(), states, steps);
}

core::Matrix GuardModel::Shortfall(const core::Matrix& states) const {
  constexpr int kSteps = 64;
  std::vector<int> steps;
  const std::vector<double> levels = Levels(states, &steps);
  const core::FeatureTransform& features = recovery().features();
  const std::vector<int>& entries = features.selection().indices();
  const kernel::WhitenedSupport& support = recovery().support();
  const Eigen::MatrixXd scale = features.scale();
  const Eigen::PartialPivLU<Eigen::MatrixXd> inverse(scale);
  Eigen::VectorXd z(features.num_features());
  Eigen::VectorXd slope(z.size());
  Eigen::VectorXd before(z.size());
  core::Matrix shortfall = core::Matrix::Zero(states.rows(), states.cols());
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    const double missing = -levels[static_cast<std::size_t>(i)];
    if (!(missing > 0.0 && std::isfinite(missing))) continue;
    const int t = steps[static_cast<std::size_t>(i)];
    features.Apply(core::Row(states, i), core::AsSpan(z));
    double l = support.LogDecision(t, core::AsSpan(z), core::AsSpan(before));
    Eigen::VectorXd share = Eigen::VectorXd::Zero(z.size());
    for (int step = 0; step < kSteps && l < 0.0; ++step) {
      const double steepness = before.squaredNorm();
      if (!(steepness > 0.0)) break;  // A place from which no way leads up.
      // Each step makes up for the same part of what is missing.
      const Eigen::VectorXd way = (-l / (kSteps - step) / steepness) * before;
      z += way;
      l = support.LogDecision(t, core::AsSpan(z), core::AsSpan(slope));
      const Eigen::VectorXd along = inverse.solve(way);
      share += (0.5 * scale.transpose() * (before + slope)).cwiseProduct(along);
      before = slope;
    }
    // The trapezoids sum to the rise but for their error.
    if (share.sum() > 0.0) share *= missing / share.sum();
    for (std::size_t k = 0; k < entries.size(); ++k) {
      shortfall(i, entries[k]) += share[static_cast<Eigen::Index>(k)];
    }
  }
  return shortfall;
}

std::vector<std::string> Findings(const GuardModel& model) {
  constexpr int kFewest = 10;
  constexpr double kLeastAcceptance = 0.7;
  constexpr double kLowestAlarm = 3.0;
  constexpr double kMostOvershoot = 5.0;
  constexpr double kUnlikely = 0.01;
  constexpr double kLeastDrift = 0.2;
  const GuardSummary& summary = model.summary();
  const GuardSettings& settings = model.settings();
  std::vector<std::string> findings;
  if (summary.demonstrations < kFewest) {
    findings.push_back(core::Format(
        "%d demonstrations cannot tell several ways of doing the task from one: record %d or more",
        summary.demonstrations, kFewest));
  }
  if (summary.acceptance < kLeastAcceptance) {
    findings.push_back(core::Format(
        "only %.0f %% of the states of left-out demonstrations are inside, so that a good policy "
        "will be held up: record more demonstrations, look at fewer features, or at every k-th "
        "state where demonstrations are long or differ in pace",
        100.0 * summary.acceptance));
  }
  if (internal::TooManyInGaps(summary.gaps)) {
    findings.push_back(core::Format(
        "demonstrations take several ways, and of %d points halfway between two of them %d are "
        "inside: record more demonstrations of each way, or give a larger --gamma",
        summary.gaps.points, summary.gaps.inside));
  }
  if (settings.alarm_level > kLowestAlarm) {
    findings.push_back(core::Format(
        "the alarm is raised below l = %.3g only, far outside: look for a demonstration that is "
        "unlike the others, or allow more --false-alarms",
        -settings.alarm_level));
  }
  if (summary.drift_chance < kUnlikely &&
      summary.drift_level > settings.alarm_level + kLeastDrift) {
    findings.push_back(core::Format(
        "conditions of recording drift: supports that have not seen a stretch of the recording "
        "would need an alarm at l < %.3g instead of %.3g. Record in all conditions that the policy "
        "will meet, and mix them",
        -summary.drift_level, -settings.alarm_level));
  }
  const double ordinary = model.recovery().model().control_unit();
  if (settings.action_limit > kMostOvershoot * ordinary) {
    findings.push_back(core::Format(
        "actions may reach %.3g, demonstrated ones have a root mean square of %.3g: give "
        "--action-limit",
        settings.action_limit, ordinary));
  }
  return findings;
}

namespace {

// Whether an entry of the states is the same in all demonstrations at the same time step, but
// differs from step to step: next to none of its variance is left within time steps.
bool FollowsClock(std::span<const core::Trajectory> demonstrations, Eigen::Index entry) {
  constexpr double kMostWithin = 1e-6;
  Eigen::Index longest = 0;
  for (const auto& d : demonstrations) longest = std::max(longest, d.states.rows());
  double count = 0.0;
  double sum = 0.0;
  double squares = 0.0;
  double within = 0.0;
  const double origin = demonstrations[0].states(0, entry);
  for (Eigen::Index t = 0; t < longest; ++t) {
    double here = 0.0;
    double sum_here = 0.0;
    double squares_here = 0.0;
    for (const auto& d : demonstrations) {
      if (t >= d.states.rows()) continue;
      const double x = d.states(t, entry) - origin;
      here += 1.0;
      sum_here += x;
      squares_here += x * x;
    }
    if (here < 2.0) continue;
    count += here;
    sum += sum_here;
    squares += squares_here;
    within += squares_here - sum_here * sum_here / here;
  }
  const double total = count > 0.0 ? squares - sum * sum / count : 0.0;
  return total > 0.0 && within <= kMostWithin * total;
}

// The share of the squared changes of features that the estimate of demonstrated answers and own
// motion explains, in some hundred demonstrated transitions.
double Explained(const GuardModel& model, std::span<const core::Trajectory> demonstrations) {
  constexpr std::size_t kSamples = 400;
  const control::GuidedModel& guided = model.recovery().model();
  control::JacobianEstimate answer(guided.prior(), {}, guided.own_motion());
  std::size_t transitions = 0;
  for (const auto& d : demonstrations) transitions += static_cast<std::size_t>(d.controls.rows());
  const std::size_t stride = std::max<std::size_t>(1, transitions / kSamples);
  double squares = 0.0;
  double missed = 0.0;
  std::size_t i = 0;
  for (const auto& d : demonstrations) {
    const core::Matrix points = guided.features().Apply(d.states);
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t, ++i) {
      if (i % stride != 0) continue;
      const Eigen::VectorXd v = d.controls.row(t).transpose() / guided.control_unit();
      Eigen::VectorXd expected = points.row(t).transpose();
      answer.Compute(static_cast<int>(t), core::Row(points, t));
      answer.AddEffect(v, expected);
      squares += (points.row(t + 1) - points.row(t)).squaredNorm();
      missed += (points.row(t + 1).transpose() - expected).squaredNorm();
    }
  }
  return squares > 0.0 ? 1.0 - missed / squares : 1.0;
}

}  // namespace

std::vector<std::string> Findings(const GuardModel& model,
                                  std::span<const core::Trajectory> demonstrations) {
  // Guided recovery predicts so little then that its corrections are guesses.
  constexpr double kLeastExplained = 0.5;
  std::vector<std::string> findings = Findings(model);
  if (demonstrations.empty()) return findings;
  std::string clocks;
  for (const int entry : model.recovery().features().selection().indices()) {
    if (!FollowsClock(demonstrations, entry)) continue;
    clocks.append(clocks.empty() ? "" : ", ").append(core::EntryName(model.layout(), entry));
  }
  if (!clocks.empty()) {
    findings.push_back(
        clocks +
        ": the same in all demonstrations at the same time step, as a clock is. A "
        "robot that is slower than they were is outside: leave it out of --features");
  }
  const double explained = Explained(model, demonstrations);
  if (explained < kLeastExplained) {
    findings.push_back(core::Format(
        "actions explain only %.0f %% of how features change: look at features that the robot "
        "moves, and let guard check see whether actions belong to the states beside them",
        100.0 * std::max(0.0, explained)));
  }
  return findings;
}

std::string Promise(const GuardSummary& summary) {
  const std::string whom =
      summary.confidence > 0.0
          ? core::Format("with %.3g %% confidence for this fit", 100.0 * summary.confidence)
          : std::string("on average over fits");
  return summary.held_out > 0
             ? whom + core::Format(", by %d demonstrations that nothing was fitted to",
                                   summary.held_out)
             : whom + ", approximately: by fits that left some out";
}

std::vector<Clearance> Clearances(const GuardModel& model) {
  const core::FeatureTransform& features = model.recovery().features();
  const kernel::WhitenedSupport& support = model.recovery().support();
  const std::vector<int>& entries = features.selection().indices();
  const double level = std::max(0.0, model.settings().alarm_level);
  std::vector<Clearance> clearances;
  std::vector<std::vector<double>> lengths;
  std::vector<std::vector<Eigen::Index>> columns;
  for (const auto& block : model.layout().blocks) {
    std::vector<Eigen::Index> own;
    for (std::size_t k = 0; k < entries.size(); ++k) {
      if (entries[k] >= block.offset && entries[k] < block.offset + block.size) {
        own.push_back(static_cast<Eigen::Index>(k));
      }
    }
    if (own.empty()) continue;
    clearances.push_back({.block = block.name});
    columns.push_back(std::move(own));
  }
  lengths.resize(clearances.size());
  for (int t = 0; t < support.num_steps(); ++t) {
    const double radius = kernel::CoverRadius(support.estimate(t), level);
    // y = M x: |y - y_i| <= radius bounds a block of x - x_i by its rows of the inverse of M.
    const Eigen::MatrixXd map = support.map(t) * features.scale();
    const Eigen::MatrixXd inverse = map.completeOrthogonalDecomposition().pseudoInverse();
    for (std::size_t b = 0; b < clearances.size(); ++b) {
      const double length =
          radius * Eigen::MatrixXd(inverse(columns[b], Eigen::all)).operatorNorm();
      lengths[b].push_back(length);
      if (length > clearances[b].largest) {
        clearances[b].largest = length;
        clearances[b].step = t;
      }
    }
  }
  for (std::size_t b = 0; b < clearances.size(); ++b) {
    const auto middle = lengths[b].begin() + std::ssize(lengths[b]) / 2;
    std::nth_element(lengths[b].begin(), middle, lengths[b].end());
    clearances[b].median = *middle;
  }
  return clearances;
}

std::string StripObservationPrefixes(std::string_view features) {
  constexpr std::array<std::string_view, 2> kPrefixes = {"obs/", "observations/"};
  std::string stripped;
  while (!features.empty()) {
    std::string_view item = features.substr(0, features.find(','));
    features.remove_prefix(std::min(features.size(), item.size() + 1));
    for (const std::string_view prefix : kPrefixes) {
      if (item.starts_with(prefix)) item.remove_prefix(prefix.size());
    }
    if (!stripped.empty()) stripped += ',';
    stripped += item;
  }
  return stripped;
}

}  // namespace dfr::safety
