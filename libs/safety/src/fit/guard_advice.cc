#include "dfr/safety/guard_advice.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "dfr/control/response/few_values.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/text/format.h"
#include "dfr/kernel/cover_radius.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/safety/constants.h"
#include "fit/choose_features.h"
#include "fit/fit_task.h"
#include "fit/left_out.h"
#include "fit/recording_advice.h"
#include "fit/sensor_groups.h"

namespace dfr::safety {

namespace {

// Returns true if the alarm level of a fit is the largest of the levels of `count` demonstrations.
bool IsWorst(int count, const GuardSummary& summary) {
  if (count < 1 || !(summary.false_alarms > 0.0 && summary.false_alarms < 1.0)) return false;
  std::vector<double> ranks(static_cast<std::size_t>(count));
  std::iota(ranks.begin(), ranks.end(), 1.0);
  return kernel::ConformalThreshold(ranks, summary.false_alarms, summary.confidence) >= count;
}

}  // namespace

std::vector<std::string> Warnings(const GuardModel& model) {
  const GuardSummary& summary = model.summary();
  const GuardSettings& settings = model.settings();
  std::vector<std::string> warnings;
  if (summary.demonstrations < fit::kFewestDemonstrations) {
    warnings.push_back(core::Format(
        "%d demonstrations cannot show whether the task has several modes: record %d or more",
        summary.demonstrations, fit::kFewestDemonstrations));
  }
  if (summary.acceptance < fit::kLeastAcceptance) {
    warnings.push_back(core::Format(
        "only %.0f %% of the states of left-out demonstrations are inside, and even a good policy "
        "will be corrected: record more demonstrations, use features relative to objects and "
        "goals, leave out entries that the task does not need, or use every k-th state if "
        "demonstrations are long or differ in pace",
        100.0 * summary.acceptance));
  }
  if (summary.changed > fit::kMostChanged || summary.ends_outside > fit::kMostOutside) {
    warnings.push_back(core::Format(
        "the guard would change %.0f %% of the actions of left-out demonstrations, and predicts "
        "%.0f %% of them to end outside: record more demonstrations, use features relative to "
        "objects and goals, or leave out entries that the task does not need",
        100.0 * summary.changed, 100.0 * summary.ends_outside));
  }
  if (control::LocalFit::Guesses(summary.explained, summary.action_error)) {
    warnings.push_back(core::Format(
        "the features explain only %.0f %% of the variance of left-out demonstrations' actions: "
        "add the other information that the demonstrator had%s.%s",
        100.0 * std::max(0.0, summary.explained),
        model.task().response().prior()->options().measured_changes
            ? ""
            : ", or reduce the sensor noise, which hides the effects of actions",
        settings.demonstrated
            ? ""
            : " The guard does not apply actions of nearby demonstrations: it corrects the "
              "policy's action, or halts"));
  }
  if (internal::TooManyInGaps(summary.gaps)) {
    warnings.push_back(core::Format(
        "demonstrations have several modes, and of %d points halfway between two modes %d are "
        "inside: record more demonstrations of each mode, or set a larger gamma",
        summary.gaps.points, summary.gaps.inside));
  }
  if (settings.alarm_level > fit::kLowestAlarm) {
    const int judged = summary.held_out > 0 ? summary.held_out : summary.demonstrations;
    warnings.push_back(
        core::Format("the alarm is raised only below l = %.3g, far outside: ",
                     -settings.alarm_level) +
        (IsWorst(judged, summary)
             ? core::Format(
                   "practically no alarm will be raised. %d demonstrations are so few that "
                   "the level is that of the worst one. Record more, check",
                   judged)
             : std::string("many failures will raise no alarm. Check")) +
        " for a demonstration that is unlike the others, or allow more false alarms");
  }
  if (summary.drift_chance < fit::kUnlikely &&
      summary.drift_level > settings.alarm_level + fit::kLeastDrift) {
    warnings.push_back(core::Format(
        "recording conditions drift: supports fitted without a contiguous part of the recording "
        "would need an alarm at l < %.3g instead of %.3g. Record in all conditions that the policy "
        "will meet, and mix them",
        -summary.drift_level, -settings.alarm_level));
  }
  if (settings.strategy == Strategy::kCertified && settings.direction_error >= summary.gain.value) {
    warnings.push_back(core::Format(
        "the predicted effects of actions err by up to %.3g per unit of action, and the effects "
        "are "
        "at most %.3g: a certified guard can certify almost no action. Use another strategy, or "
        "features on which actions have a regular effect",
        settings.direction_error, summary.gain.value));
  }
  for (std::size_t i = 0; i < model.actions().entries().size(); ++i) {
    const ActionEntry& entry = model.actions().entries()[i];
    const double limit = settings.action_limit[i];
    if (!entry.steered && limit > 0.0) continue;  // FitWarnings() names it.
    if (limit > fit::kMostOvershoot * entry.largest) {
      warnings.push_back(
          core::Format("entry %zu of an action may reach %.3g, but demonstrations reach only %.3g: "
                       "set an action limit",
                       i, limit, entry.largest));
    } else if (limit < fit::kLeastReach * entry.largest) {
      warnings.push_back(
          core::Format("entry %zu of an action is limited to %.3g, but demonstrations reach %.3g: "
                       "the guard would change them; set a larger action limit",
                       i, limit, entry.largest));
    }
  }
  const int longest = model.num_steps() - 1;
  if (settings.horizon < longest) {
    warnings.push_back(
        core::Format("the guard halts after %d time steps, but several demonstrations have %d: set "
                     "a larger horizon",
                     settings.horizon, longest));
  }
  warnings.insert(warnings.end(), summary.fit_warnings.begin(), summary.fit_warnings.end());
  return warnings;
}

namespace {

// Describes the entries of an action that the guard passes, with their values; "" if there are
// none.
std::string DescribePassed(const GuardModel& model,
                           std::span<const core::Trajectory> demonstrations) {
  std::string passed;
  for (std::size_t i = 0; i < model.actions().entries().size(); ++i) {
    if (model.actions().entries()[i].steered || !(model.settings().action_limit[i] > 0.0)) continue;
    control::FewValues few;
    for (const core::Trajectory& d : demonstrations) {
      for (const double value : d.controls.col(static_cast<Eigen::Index>(i))) few.Add(value);
    }
    std::string list;
    for (const double value : few.values()) {
      list += core::Format("%s%.3g", list.empty() ? "" : ", ", value);
    }
    passed += core::Format("%s%zu (%s)", passed.empty() ? "" : ", ", i, list.c_str());
  }
  if (passed.empty()) return passed;
  return "entries of an action have few demonstrated values, as a gripper that opens or closes: " +
         passed + ". The guard passes the policy's values and steers only by the other entries";
}

// Describes features that are copies or linear functions of others; "" if there are none.
std::string DescribeRepeated(const GuardModel& model,
                             std::span<const core::Trajectory> demonstrations) {
  constexpr double kRedundant = 1e-9;  // Fraction of the variance that remains unexplained.
  constexpr std::size_t kMostNamed = 3;
  const core::FeatureSelection& selection = model.task().features().selection();
  const Eigen::Index n = selection.num_features();
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(n);
  double count = 0.0;
  for (const core::Trajectory& d : demonstrations) {
    mean += selection.Apply(d.states).colwise().sum().transpose();
    count += static_cast<double>(d.states.rows());
  }
  mean /= count;
  Eigen::MatrixXd scatter = Eigen::MatrixXd::Zero(n, n);
  for (const core::Trajectory& d : demonstrations) {
    const Eigen::MatrixXd off = selection.Apply(d.states).rowwise() - mean.transpose();
    scatter.noalias() += off.transpose() * off;
  }
  std::string pairs;
  std::size_t found = 0;
  for (Eigen::Index k = 0; k < n; ++k) {
    for (Eigen::Index i = 0; i < k; ++i) {
      const double product = scatter(k, k) * scatter(i, i);
      if (!(product > 0.0) || product - scatter(k, i) * scatter(k, i) > kRedundant * product) {
        continue;
      }
      const auto name = [&](Eigen::Index feature) {
        return core::EntryName(model.task_layout(),
                               selection.indices()[static_cast<std::size_t>(feature)]);
      };
      if (++found <= kMostNamed) {
        pairs.append(pairs.empty() ? "" : ", ").append(name(k) + " by " + name(i));
      }
      break;
    }
  }
  if (found == 0) return pairs;
  if (found > kMostNamed) pairs += core::Format(" and %zu others", found - kMostNamed);
  return "features are determined by others, as a copy or in another unit: " + pairs +
         ". They count twice: keep one feature of each pair";
}

// Returns the map of features that removes entries with one or two repeated values, such as flags.
// Actions do not move such entries gradually.
Eigen::MatrixXd WithoutFlags(const core::FeatureTransform& features,
                             std::span<const core::Trajectory> demonstrations) {
  constexpr std::size_t kMostValues = 2;
  constexpr Eigen::Index kFewestStates = 10;
  const core::FeatureSelection& selection = features.selection();
  std::vector<std::vector<double>> values(static_cast<std::size_t>(selection.num_features()));
  Eigen::Index states = 0;
  for (const core::Trajectory& d : demonstrations) {
    states += d.states.rows();
    const core::Matrix entries = selection.Apply(d.states);
    for (std::size_t k = 0; k < values.size(); ++k) {
      for (const double x : entries.col(static_cast<Eigen::Index>(k))) {
        if (values[k].size() > kMostValues) break;
        if (std::ranges::find(values[k], x) == values[k].end()) values[k].push_back(x);
      }
    }
  }
  const Eigen::Index n = features.num_features();
  Eigen::VectorXd kept(selection.num_features());
  for (std::size_t k = 0; k < values.size(); ++k) {
    kept[static_cast<Eigen::Index>(k)] = values[k].size() > kMostValues ? 1.0 : 0.0;
  }
  if (kept.minCoeff() > 0.0 || states < kFewestStates) return Eigen::MatrixXd::Identity(n, n);
  const Eigen::MatrixXd scale = features.scale();
  return scale * kept.asDiagonal() * core::PseudoInverse(scale);
}

struct Changes {
  double explained = 1.0;
  double noise = 0.0;
};

// Returns the fraction of the squared changes of features, WithoutFlags(), that the demonstrated
// response and the drift explain, over some hundred demonstrated transitions, and the fraction of
// the rest that is sensor noise. Noise of variance s adds 2 s to the squares, and its return in the
// next step adds -s to the products of consecutive errors.
Changes JudgeChanges(const GuardModel& model, std::span<const core::Trajectory> demonstrations) {
  constexpr std::size_t kSamples = 400;
  const control::Response& response = model.task().response();
  const control::ResponseEstimate estimate(response.prior(), {}, response.has_drift());
  control::LocalFit answer = estimate.MakeFit();
  std::size_t transitions = 0;
  for (const auto& d : demonstrations) transitions += static_cast<std::size_t>(d.controls.rows());
  const std::size_t stride = std::max<std::size_t>(1, transitions / kSamples);
  double squares = 0.0;
  Eigen::VectorXd missed = Eigen::VectorXd::Zero(response.feature_dim());
  Eigen::VectorXd returns = missed;
  std::size_t i = 0;
  Eigen::VectorXd v(model.actions().steered_dim());
  const Eigen::MatrixXd judged = WithoutFlags(model.task().features(), demonstrations);
  const auto error = [&](const core::Trajectory& d, const core::Matrix& points, Eigen::Index t) {
    model.actions().Measure(core::Row(d.controls, t), core::AsSpan(v));
    v /= response.control_unit();
    Eigen::VectorXd expected = points.row(t).transpose();
    estimate.FitAt(static_cast<int>(t), core::Row(points, t), answer);
    answer.AddEffect(v, expected);
    return Eigen::VectorXd(judged * (points.row(t + 1).transpose() - expected));
  };
  for (const auto& d : demonstrations) {
    const core::Matrix points = model.task().features().Apply(d.states);
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t, ++i) {
      if (i % stride != 0) continue;
      squares += (judged * (points.row(t + 1) - points.row(t)).transpose()).squaredNorm();
      const Eigen::VectorXd now = error(d, points, t);
      missed += now.cwiseAbs2();
      if (t + 1 < d.controls.rows()) returns -= now.cwiseProduct(error(d, points, t + 1));
    }
  }
  if (!(squares > 0.0 && missed.sum() > 0.0)) return {};
  return {.explained = 1.0 - missed.sum() / squares,
          .noise = std::min(1.0, 2.0 * returns.cwiseMax(0.0).sum() / missed.sum())};
}

}  // namespace

std::vector<std::string> FitWarnings(const GuardModel& model,
                                     std::span<const core::Trajectory> demonstrations) {
  std::vector<std::string> warnings;
  // Samples of the transitions do not depend on the order of the demonstrations.
  const std::vector<core::Trajectory> ordered = core::InDeterministicOrder(demonstrations);
  for (const core::Rotation& rotation : internal::Rotations(model.task().features().selection(),
                                                            model.task_layout(), demonstrations)) {
    // Rotation matrices are continuous.
    if ((rotation.mapped() && !rotation.guessed) || rotation.kind == core::Rotation::Kind::kMatrix)
      continue;
    warnings.push_back(core::Describe(rotation, model.task_layout()));
  }
  const std::vector<core::Trajectory> steady =
      internal::WithoutJumps(model.task_layout(), demonstrations);
  std::string clocks;
  std::vector<int> uniform;
  std::vector<int> entries = model.task().features().selection().indices();
  entries.erase(std::unique(entries.begin(), entries.end()), entries.end());
  for (const int entry : entries) {
    if (internal::FollowsClock(steady, entry)) {
      clocks.append(clocks.empty() ? "" : ", ").append(core::EntryName(model.task_layout(), entry));
    } else if (internal::AdvancesUniformly(steady, entry)) {
      uniform.push_back(entry);
    }
  }
  if (!clocks.empty()) {
    warnings.push_back(
        clocks +
        ": the same in all demonstrations at the same time step, like a clock. A slower robot "
        "would be outside: leave such entries out of the features");
  }
  if (!uniform.empty()) {
    warnings.push_back(
        internal::Names(model.task_layout(), uniform) +
        ": advances uniformly for any actions, like a clock or a phase. A slower robot would be "
        "outside: leave such entries out of the features, except objects that move by themselves");
  }
  for (std::string fault :
       {DescribePassed(model, demonstrations), internal::DescribeCopies(demonstrations),
        DescribeRepeated(model, demonstrations), internal::DescribeDelay(model, ordered),
        internal::DescribeRest(model, steady), internal::DescribeJumps(model, demonstrations),
        internal::DescribeLargest(demonstrations), internal::DescribeGoals(model, steady),
        internal::DescribeOpposites(model, ordered)}) {
    if (!fault.empty()) warnings.push_back(std::move(fault));
  }
  const Changes changes = JudgeChanges(model, ordered);
  if (changes.explained < fit::kLeastResponse) {
    constexpr double kMostlyNoise = 0.5;
    std::string warning = core::Format("actions explain only %.0f %% of the change of features",
                                       100.0 * std::max(0.0, changes.explained));
    warning += changes.noise > kMostlyNoise
                   ? core::Format(
                         ", and %.0f %% of the rest is sensor noise: smooth the states "
                         "without delay, or use every k-th state",
                         100.0 * changes.noise)
                   : ": use features that the robot moves, and run guard check to compare actions "
                     "with their states";
    warnings.push_back(std::move(warning));
  }
  return warnings;
}

std::string DescribeGuarantee(const GuardSummary& summary) {
  const std::string whom =
      summary.confidence > 0.0
          ? core::Format("with %.3g %% confidence for this fit", 100.0 * summary.confidence)
          : std::string("on average over fits");
  return summary.held_out > 0
             ? whom + core::Format(", by %d held-out demonstrations", summary.held_out)
             : whom + ", approximately, by cross-validation";
}

std::vector<Clearance> Clearances(const GuardModel& model) {
  const core::FeatureTransform& features = model.task().features();
  const kernel::WhitenedSupport& support = model.task().feature_support();
  const std::vector<int>& entries = features.selection().indices();
  const double level = std::max(0.0, model.settings().alarm_level);
  std::vector<Clearance> clearances;
  std::vector<std::vector<double>> lengths;
  std::vector<std::vector<Eigen::Index>> columns;
  for (const auto& block : model.task_layout().blocks) {
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
    // y = M x. With |y - y_i| <= radius, the inverse of M bounds each block of x - x_i by its rows.
    const Eigen::MatrixXd map = support.map(t) * features.scale();
    const Eigen::MatrixXd inverse = core::PseudoInverse(map);
    for (std::size_t b = 0; b < clearances.size(); ++b) {
      const double length = radius * core::OperatorNorm(inverse(columns[b], Eigen::all));
      lengths[b].push_back(length);
      if (length > clearances[b].largest) {
        clearances[b].largest = length;
        clearances[b].step = t;
      }
    }
  }
  for (std::size_t b = 0; b < clearances.size(); ++b) {
    clearances[b].median = core::Median(lengths[b]);
  }
  return clearances;
}

}  // namespace dfr::safety
