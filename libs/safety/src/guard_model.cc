#include "dfr/safety/guard_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>

#include "dfr/control/phase_tracker.h"
#include "dfr/core/archive.h"
#include "dfr/core/build_info.h"
#include "dfr/core/contract.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/format.h"
#include "dfr/kernel/model_selection.h"

namespace dfr::safety {
namespace {

constexpr std::string_view kKind = "guard";
constexpr int kVersion = 3;

constexpr std::array kStrategies = {Strategy::kGuided, Strategy::kDfr, Strategy::kEarlyStopping,
                                    Strategy::kMonitor};

// A guard gives up after so many actions a policy's action at the most.
constexpr int kActionsPerStep = 12;
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
                                      << " actions; one state more than actions is needed");
    DFR_THROW_UNLESS(demonstration.controls.cols() == demonstrations[0].controls.cols(),
                     "demonstration " << d << " has actions of " << demonstration.controls.cols()
                                      << " entries, demonstration 0 of "
                                      << demonstrations[0].controls.cols());
    DFR_THROW_UNLESS(demonstration.states.allFinite() && demonstration.controls.allFinite(),
                     "demonstration " << d << " has a non-finite entry");
  }
}

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

// What supports make of demonstrations that they have not seen.
struct HeldOut {
  std::vector<double> worst;  // -l at the worst state of each demonstration
  double acceptance = 0.0;
  double inside_throughout = 0.0;
};

std::optional<HeldOut> LeaveOut(const core::FeatureTransform& features,
                                std::span<const core::Trajectory> demonstrations,
                                const GuardOptions& options) {
  const std::size_t folds = std::clamp<std::size_t>(demonstrations.size() / 2, 2,
                                                    static_cast<std::size_t>(options.folds));
  std::vector<core::Matrix> points;
  for (const core::Trajectory& demonstration : demonstrations) {
    points.push_back(features.Apply(demonstration.states));
  }
  HeldOut held_out;
  double inside = 0.0;
  double states = 0.0;
  for (std::size_t fold = 0; fold < folds; ++fold) {
    if (options.progress &&
        !options.progress("leaving demonstrations out",
                          0.6 * static_cast<double>(fold) / static_cast<double>(folds))) {
      return std::nullopt;
    }
    std::vector<core::Matrix> others;
    for (std::size_t d = 0; d < points.size(); ++d) {
      if (d % folds != fold) others.push_back(points[d]);
    }
    if (others.size() < 2) continue;
    const auto support = kernel::WhitenedSupport::Fit(others, options.support);
    for (std::size_t d = fold; d < points.size(); d += folds) {
      const std::vector<double> levels = Follow(support, points[d], nullptr);
      const double lowest = *std::min_element(levels.begin(), levels.end());
      held_out.worst.push_back(-lowest);
      held_out.inside_throughout += lowest >= 0.0 ? 1.0 : 0.0;
      states += static_cast<double>(levels.size());
      inside += static_cast<double>(
          std::count_if(levels.begin(), levels.end(), [](double l) { return l >= 0.0; }));
    }
  }
  held_out.acceptance = inside / states;
  held_out.inside_throughout /= static_cast<double>(held_out.worst.size());
  return held_out;
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
  }
  return "unknown";
}

Strategy ParseStrategy(std::string_view name) {
  for (const Strategy strategy : kStrategies) {
    if (name == Name(strategy)) return strategy;
  }
  throw std::invalid_argument("there is no strategy '" + std::string(name) +
                              "'; there are: guided, dfr, early-stopping, monitor");
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
  const auto going_on = [&](std::string_view stage, double share) {
    return !options.progress || options.progress(stage, share);
  };
  const core::FeatureSelection selection = options.features.empty()
                                               ? core::FeatureSelection::All(layout.state_dim())
                                               : core::FeatureSelection(layout, options.features);
  std::vector<core::Matrix> states;
  for (const core::Trajectory& demonstration : demonstrations) {
    states.push_back(demonstration.states);
  }
  const auto held_out =
      LeaveOut(core::FeatureTransform::Whitening(selection, states), demonstrations, options);
  if (!held_out || !going_on("fitting the support", 0.6)) return nullptr;
  auto task = std::make_shared<const TaskModel>(
      layout, demonstrations,
      TaskOptions{.guided_features = options.features, .guided = options.support});
  if (!going_on("estimating the alarm level", 0.95)) return nullptr;

  GuardSettings settings;
  settings.strategy = options.strategy;
  Eigen::Index longest = 0;
  Eigen::Index transitions = 0;
  double largest = 1.0;
  for (const core::Trajectory& demonstration : demonstrations) {
    longest = std::max(longest, demonstration.controls.rows());
    transitions += demonstration.controls.rows();
    largest = std::max(largest, demonstration.controls.cwiseAbs().maxCoeff());
  }
  settings.horizon = options.horizon > 0
                         ? options.horizon
                         : static_cast<int>(std::min<Eigen::Index>(2 * longest, kLongestHorizon));
  settings.max_actions = kActionsPerStep * settings.horizon;
  settings.action_limit = options.action_limit > 0.0 ? options.action_limit : largest;
  // With few demonstrations none of them promises so little; their worst is what there is.
  const double promised = kernel::ConformalThreshold(held_out->worst, options.false_alarms);
  const double worst = *std::max_element(held_out->worst.begin(), held_out->worst.end());
  settings.alarm_level = std::isfinite(promised) ? promised : worst;
  DFR_THROW_UNLESS(std::isfinite(settings.alarm_level),
                   "no alarm level can be found: a demonstration is infinitely far from the others "
                   "in the features "
                       << (options.features.empty() ? "of the whole state" : options.features));

  std::shared_ptr<GuardModel> model(new GuardModel);
  model->Complete(layout, std::move(task), settings);
  model->summary_ = {.source = options.source,
                     .version = core::BuildVersion(),
                     .demonstrations = static_cast<int>(demonstrations.size()),
                     .transitions = static_cast<int>(transitions),
                     .nu = options.support.svm.nu,
                     .gamma = options.support.svm.gamma,
                     .acceptance = held_out->acceptance,
                     .inside_throughout = held_out->inside_throughout,
                     .false_alarms = std::isfinite(promised)
                                         ? options.false_alarms
                                         : 1.0 / static_cast<double>(held_out->worst.size() + 1)};
  if (!going_on("done", 1.0)) return nullptr;
  return model;
}

void GuardModel::Complete(core::StateLayout layout, std::shared_ptr<const TaskModel> task,
                          const GuardSettings& settings) {
  Check(settings);
  layout_ = std::move(layout);
  task_ = std::move(task);
  settings_ = settings;
}

std::shared_ptr<const GuardModel> GuardModel::With(const GuardSettings& settings) const {
  std::shared_ptr<GuardModel> model(new GuardModel);
  model->Complete(layout_, task_, settings);
  model->summary_ = summary_;
  return model;
}

void GuardModel::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter archive(kKind, kVersion);
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
  archive.Text(summary_.source);
  archive.Text(summary_.version);
  archive.Integer(summary_.demonstrations);
  archive.Integer(summary_.transitions);
  for (const double value : {summary_.nu, summary_.gamma, summary_.acceptance,
                             summary_.inside_throughout, summary_.false_alarms}) {
    archive.Number(value);
  }
  archive.Numbers(lambda());
  recovery().Save(archive);
  archive.Save(path);
}

std::shared_ptr<const GuardModel> GuardModel::Load(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, kKind, kVersion);
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
  return Follow(support(), states, steps);
}

std::vector<std::string> Findings(const GuardModel& model) {
  constexpr int kFewest = 10;
  constexpr double kLeastAcceptance = 0.7;
  constexpr double kLowestAlarm = 3.0;
  constexpr double kMostOvershoot = 5.0;
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
  if (settings.alarm_level > kLowestAlarm) {
    findings.push_back(core::Format(
        "the alarm is raised below l = %.3g only, far outside: look for a demonstration that is "
        "unlike the others, or allow more --false-alarms",
        -settings.alarm_level));
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
